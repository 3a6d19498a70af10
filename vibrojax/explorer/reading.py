"""Texts that a reader of the explorer page begins with: what the dataset holds, the regimes, and the first cell."""

from typing import Any

import numpy as np
import xarray as xr

from vibrojax.io.attributes import table_of
from vibrojax.pictures.axes import certified_text
from vibrojax.pictures.contents import FORM

REGIME_MEANINGS = {
    "undecided": "The motion still grows or decays, or returns too seldom, when the observation ends.",
    "equilibrium": "The bit comes to rest relative to the drive.",
    "impact-free": "The motion repeats after one return, without an impact.",
    "single-impact": "The motion repeats after one return, with one impact: the working cycle of the drill.",
    "multi-impact": "The motion repeats after one return, with two or more impacts.",
    "subharmonic": "The motion repeats only after several returns.",
    "irregular": "The motion does not repeat while it is observed: it is chaotic, quasi-periodic or still settling.",
    "failed": "The state is not finite, or the simulation did not reach the end.",
}
"""One sentence on each regime, which the page shows where its name is pointed at or has the focus."""

BORDER_MEANINGS = {
    "fold": "A stable and an unstable orbit meet and vanish.",
    "period-doubling": "The orbit loses its stability to one that repeats after twice as many returns.",
    "torus": "The orbit loses its stability to a motion with a second frequency.",
    "grazing": "An impact, or another event, appears or vanishes.",
    "stick": "A stick or a backward slip appears or vanishes.",
    "section": "The bit just catches up with the drive: beyond it, returns are counted differently.",
    "hopf": "The amplitude of the orbit shrinks to zero at an equilibrium.",
    "branch-point": "Another family of orbits crosses.",
    "end": "A bound is reached, or the family ends.",
    "basin": "The orbit goes on and is stable, but this start no longer leads to it.",
    "not-settled": "Beyond it, motions from this start had not settled when they were observed.",
}
"""One sentence on what happens at each kind of border, curve and special point."""

SINGLE = "single-impact"


def reading_text(ds: xr.Dataset) -> str:
    """Return how many motions of a sweep repeat, and how many of these are not known to the error tolerance."""
    counts, lanes = table_of(ds, "certified"), int(ds["regime"].size) if "regime" in ds else 0
    if not counts.get("estimated") or not {"within", "error"} <= set(counts):
        return certified_text(ds)
    estimated, beyond = round(counts["estimated"]), round(counts["estimated"] - counts["within"])
    total = f"{lanes:,}" if lanes >= estimated else "the"
    known = f"all but {beyond:,} of these" if beyond else "all of these"
    tolerance = np.format_float_scientific(counts["error"], trim="-", exp_digits=1)
    failed = certified_text(ds).partition(". ")[2]
    text = f"{estimated:,} of {total} motions repeat; {known} are exact to {tolerance}"
    return ". ".join(part for part in (text, failed) if part)


def first_cell(ds: xr.Dataset, variables: list[dict[str, Any]], along: list[str]) -> dict[str, int]:
    """Return the cell shown first: the single impact nearest to the middle, stable if that is known.

    `along`: the axes of the first view, or empty for the longest one. Other axes begin at 0 if that has such a cell.
    The result is empty without regimes or without single impacts. Of attractors it is the most frequent one.
    Of fits it is the form with the lowest AIC.
    """
    if FORM in ds.dims and "aic" in ds:
        aic = ds["aic"].median([dim for dim in ds["aic"].dims if dim != FORM])
        return {FORM: int(aic.argmin(FORM))} if aic.notnull().any() else {}
    if "sign" in ds.dims:
        counts = [x.notnull().sum([d for d in x.dims if d != "sign"]) for x in ds.values() if "sign" in x.dims]
        return {"sign": int(np.argmax(np.sum([x.values for x in counts], axis=0)))}
    if {"share", "lane_attractor"} <= set(ds.variables):
        middle = {str(name): size // 2 for name, size in ds["share"].sizes.items() if name != "attractor"}
        return middle | {"attractor": int(ds["share"].isel(middle).argmax("attractor"))}
    regime = next((one for one in variables if one["name"] == "regime" and one["flags"]), None)
    flag = next((key for key, name in (regime or {"flags": {}})["flags"].items() if name == SINGLE), None)
    if regime is None or flag is None:
        return {}
    names = regime["axes"]
    single = ds["regime"].transpose(*names).values == int(flag)
    if "stable" in ds and set(ds["stable"].dims) == set(names):
        stable = single & (ds["stable"].transpose(*names).values == 1)
        single = stable if stable.any() else single
    if not single.any():
        return {}
    along = along or [max(names, key=lambda name: ds.sizes[name])] if names else []
    cells = np.argwhere(single)
    sizes = np.array([ds.sizes[name] for name in names])
    inside = np.array([name in along for name in names])
    away = np.where(inside, np.abs(cells / np.maximum(sizes - 1, 1) - 0.5), 10.0 * (cells > 0))
    return {name: int(k) for name, k in zip(names, cells[np.argmin((away**2).sum(axis=1))], strict=True)}

"""Texts that a reader of the explorer page begins with: what the dataset holds, the regimes, and the first cell."""

from typing import Any

import numpy as np
import xarray as xr

from vibrojax.io.attributes import table_of
from vibrojax.plot.axes import certified_text

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

SINGLE = "single-impact"


def reading_text(ds: xr.Dataset) -> str:
    """Return how many motions of a sweep repeat, and how many of these are not known to the error tolerance."""
    counts, lanes = table_of(ds, "certified"), int(ds["regime"].size) if "regime" in ds else 0
    if not counts.get("estimated") or not {"within", "error"} <= set(counts):
        return certified_text(ds)
    estimated, beyond = round(counts["estimated"]), round(counts["estimated"] - counts["within"])
    total = f"{lanes:,}" if lanes >= estimated else "the"
    known = f"all but {beyond:,} of these" if beyond else "all of these"
    failed = certified_text(ds).partition(". ")[2]
    text = f"{estimated:,} of {total} motions repeat; {known} are exact to {counts['error']:g}"
    return ". ".join(part for part in (text, failed) if part)


def first_cell(ds: xr.Dataset, variables: list[dict[str, Any]], along: list[str]) -> dict[str, int]:
    """Return the cell shown first: the single impact nearest to the middle, stable if that is known.

    `along`: the axes of the first view, or empty for the longest one. Other axes begin at 0 if that has such a cell.
    The result is empty without regimes or without single impacts.
    """
    regime = next((one for one in variables if one["name"] == "regime" and one["flags"]), None)
    flag = next((key for key, name in (regime or {"flags": {}})["flags"].items() if name == SINGLE), None)
    if regime is None or flag is None or "attractor" in regime["axes"]:
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

"""The analysis `sweep`: pictures and summary of datasets over a parameter space, and the frequencies of their lanes."""

import tomllib
from collections.abc import Sequence
from math import pi
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from vibrojax.errors import counted
from vibrojax.io.attributes import flag_counts, flags, parameters_of, run_of, table_of
from vibrojax.io.kinds import kind_of
from vibrojax.measures.labels import blow_frequency
from vibrojax.physics.modes import natural_frequencies, uncoupled_frequencies
from vibrojax.physics.parameters import REPLACED, resolved
from vibrojax.physics.rock import ROCKS
from vibrojax.pictures.axes import pretty_unit, scale, value_text
from vibrojax.pictures.contents import Contents
from vibrojax.pictures.lines import rates, regime_lines
from vibrojax.pictures.maps import rate_grid, regime_dots, regime_grid
from vibrojax.pictures.overlays import ON_MAPS, refuse_overlays
from vibrojax.pictures.plots import Picture
from vibrojax.pictures.returns import bifurcation, hysteresis
from vibrojax.pictures.starts import many_starts
from vibrojax.settings.run_settings import RunSettings
from vibrojax.studies.analysis import Analysis, PictureRule, Source, SummaryPart

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Sweeps(Analysis):
    """Run a sweep file: a dataset with the regime of each lane, and a picture of it."""

    kind = "sweep"
    pictures = (
        PictureRule("returns", lambda held: held.carried, hysteresis),
        PictureRule("returns", lambda held: held.returns, bifurcation),
        PictureRule("starts", lambda held: held.regimes and held.many_starts, many_starts),
        PictureRule("rates", lambda held: held.rates and not held.worth_a_map, rates),
        PictureRule("regimes", lambda held: held.regimes and (held.points_over_two or len(held.axes) > 1), regime_grid),
        PictureRule("regimes", lambda held: held.regimes and held.quantities_over_one, regime_lines),
        PictureRule("regimes", lambda held: held.regimes, regime_dots),
        PictureRule("rate map", lambda held: held.rates, rate_grid),
    )

    def run(self, source: Source, progress: bool = True) -> xr.Dataset:
        from vibrojax.maps.run import run_sweep

        return run_sweep(source, progress=progress)

    def summary(self, ds: xr.Dataset) -> list[SummaryPart]:
        """Return the rate of penetration of a sweep with rock, or the reason why there is none, and the frequencies."""
        return [_rates(ds), frequency_part(ds)]

    def plots(self, ds: xr.Dataset, over: Sequence[xr.Dataset] = ()) -> "Picture | Figure":
        """Return the plots of a sweep; `over`: borders or curves on its map, or families on its section crossings."""
        if not over:
            return super().plots(ds)
        held = Contents(ds)
        if any(isinstance(layer, xr.Dataset) and kind_of(layer) in ON_MAPS for layer in over):
            if not held.regimes or held.points or len(held.axes) < 2:
                refuse_overlays(over, "the dataset holds none")
            return regime_grid(ds, over)
        if held.carried:
            return hysteresis(ds, tuple(over))
        return bifurcation(ds, tuple(over)) if held.returns else super().plots(ds, over)


_FAILURES_SHOWN = 3


def lane_parts(ds: xr.Dataset) -> dict[str, SummaryPart]:
    """Return the summary parts of datasets with lanes, by name; a part without content is empty."""
    # The regimes of a trajectory and of attractors are not those of lanes.
    no_lanes = bool({"time", "attractor"} & set(ds.dims))
    regimes = {} if no_lanes else flag_counts(ds, "regime")
    total = max(ds["regime"].size, 1) if "regime" in ds else 1
    regime_lines = [f"{meaning:<14}{count:>9}{100 * count / total:>7.1f} %" for meaning, count in regimes.items()]
    if "hidden_motion" in ds and "start" in ds["hidden_motion"].dims:
        points = int(ds["hidden_motion"].any("start").sum())
        if points:
            regime_lines.append(f"at {counted(points, 'point')} starts end in different motions under one label")
    orbits: dict[str, Any] = {}
    if "orbit_reason" in ds and not no_lanes:
        orbits = {"reason": flag_counts(ds, "orbit_reason"), "stable": flag_counts(ds, "stable")}
    natures, nature_lines = {} if no_lanes else flag_counts(ds, "nature"), list[str]()
    if natures and "regime" in ds:
        irregular = flag_counts(ds[["nature"]].where(_labelled(ds, "irregular")), "nature")
        nature_lines = [f"{x:<14}{count:>9}{irregular.get(x, 0):>9} of them irregular" for x, count in natures.items()]
    reasons = flag_counts(ds, "reason") if "status" in ds else {}  # the reasons of a fit are not failures
    reasons.pop("none", None)
    parts = [
        SummaryPart("regimes", regime_lines, {"regimes": regimes}),
        SummaryPart("orbits", orbit_lines(ds), {"orbits": orbits}),
        SummaryPart("natures", nature_lines, {"natures": natures}),
        SummaryPart("failures", _failure_lines(ds, "regime" in ds and not no_lanes), {"failures": reasons}),
        _accuracy(ds),
    ]
    return {part.name: part for part in parts}


def orbit_lines(ds: xr.Dataset) -> list[str]:
    """Return how many orbits were found and are stable, and why the others were not found; nothing without orbits."""
    if "orbit_reason" not in ds:
        return []
    counts, stable = flag_counts(ds, "orbit_reason"), ds["stable"].values
    repeating = sum(count for meaning, count in counts.items() if meaning not in ("not-repeating", "refused"))
    of = f"{counts.pop('found', 0)} found of {counted(repeating, 'lane that repeats', 'lanes that repeat')}"
    lines = [f"{of}: {(stable == 1).sum()} stable, {(stable == 0).sum()} unstable"]
    lines += [f"{count} {meaning}" for meaning, count in counts.items()]
    cycles, own = ds["orbit_cycles"], ds.get("cycles")
    if own is not None and (sooner := int(((cycles > 0) & (cycles < own)).sum())):
        one = "lane is on its way to an orbit that repeats sooner than it does"
        many = "lanes are on their way to an orbit that repeats sooner than they do"
        lines.append(counted(sooner, one, many))
    limit = table_of(ds, "orbits").get("grazing_limit")
    if limit is not None:
        lines.append(f"multipliers are given from a grazing_margin of {limit:g} on")
    if "nearby_cycles" in ds and "regime" in ds:
        open_lanes = _labelled(ds, "irregular", "undecided").values
        near = int((open_lanes & (ds["nearby_cycles"].values > 0)).sum())
        lines.append(
            f"of {counted(int(open_lanes.sum()), 'lane')} labelled irregular or undecided, "
            + counted(near, "has a stable orbit nearby that it has", "have a stable orbit nearby that they have")
            + " not reached (nearby_cycles); a longer settle leads most of those there"
        )
    return lines


def _labelled(ds: xr.Dataset, *regimes: str) -> xr.DataArray:
    """Return which lanes have one of the `regimes`."""
    return ds["regime"].isin([flag for flag, name in flags(ds["regime"]).items() if name in regimes])


def _rates(ds: xr.Dataset) -> SummaryPart:
    """Return the rate of penetration: how many lanes have one, its range and where it is largest, or why there is none.

    Without a rate, the largest peak contact force is given beside the threshold D of the rock, which the force of the
    rock did not reach.
    """
    if "rate_of_penetration" not in ds:
        return SummaryPart("rates", [], {})
    rate = ds["rate_of_penetration"].broadcast_like(ds["status"]) if "status" in ds else ds["rate_of_penetration"]
    penetrates = rate.where(rate > 0)
    count = int(penetrates.count())
    facts: dict[str, Any] = {"lanes": count, "least": None, "greatest": None}
    if count:
        greatest = penetrates.isel(penetrates.argmax(...))
        where = ", ".join(value_text(ds[name], greatest[name].item()) for name in greatest.coords if name in ds.dims)
        least, most = float(penetrates.min()), float(greatest)
        factor, unit = scale(rate)
        per_hour = f"{3600 * least:.4g} to {3600 * most:.4g} m/h"
        ends = f"{factor * least:.4g} to {factor * most:.4g} {pretty_unit(unit)}"
        lines = [f"{ends} ({per_hour}) in {count} of {counted(rate.size, 'lane')}"]
        lines += [f"largest at {where}"] if where else []
        facts |= {"least": least, "greatest": most}
    else:
        lines = [f"none: the hole does not grow in any of {counted(rate.size, 'lane')}"]
    if count < rate.size:
        lines += _reason_of_no_rate(ds, rate, facts)
    return SummaryPart("rates", lines, {"rates": facts})


def _reason_of_no_rate(ds: xr.Dataset, rate: xr.DataArray, facts: dict[str, Any]) -> list[str]:
    """Return lines that give the peak force of the lanes without a rate in threshold D; add it to `facts`.

    The rock yields where its own force reaches D. A part of the contact force accelerates the bit instead, so the
    contact force may exceed D without a rate.
    """
    pulses = "peak_impact_force" not in ds
    values: dict[str, Any] = {**parameters_of(ds), **{str(name): data for name, data in ds.coords.items()}}
    if "rock" in ds.coords:
        values["threshold"] = ds["rock"].copy(data=[ROCKS[str(name)].threshold for name in ds["rock"].values.flat])
    force, threshold = values.get("force") if pulses else ds["peak_impact_force"], values.get("threshold")
    if force is None or threshold is None:
        return []
    force, ratio = ((x + 0 * rate.fillna(0)).where(~(rate > 0)) for x in (force, force / threshold))
    count = int(force.isnull().sum()) - int((rate > 0).sum())
    name = "force of the pulses" if pulses else "contact force"
    lines = [f"lanes without impacts: {count}"] if count else []
    if not bool(ratio.notnull().any()):
        return lines
    peak, share = float(force.isel(ratio.argmax(...))), float(ratio.max())
    facts["peak_over_threshold"] = share
    harder = "a larger force" if pulses else "harder impacts (greater v; another beta, gamma or delta)"
    return [
        *lines,
        "without a rate, the rock force never reaches the threshold D, at which the rock yields",
        f"the largest {name} there is {peak / 1e3:.4g} kN, {share:.4g} of D; the inertia of the bit takes a part of it",
        f"a softer rock (lower threshold) or {harder} can give a rate",
    ]


def _failure_lines(ds: xr.Dataset, has_lanes: bool) -> list[str]:
    """Return lines that state how many lanes failed and, for each reason, how many and the first few lanes."""
    if not has_lanes and "status" not in ds:
        return []
    mask = _labelled(ds, "failed") if has_lanes else ds["status"] != 0
    lines = [str(int(mask.sum()))]
    has_reasons = "reason" in ds and ds["reason"].dims == mask.dims
    reasons = ds["reason"].values if has_reasons else np.zeros(mask.shape, int)
    meanings = flags(ds["reason"]) if has_reasons else {}
    for reason in np.unique(reasons[mask.values]).tolist():
        indices = np.argwhere(mask.values & (reasons == reason))
        lines += [f"{len(indices)} {meanings[reason]}"] if reason in meanings else []
        for index in indices[:_FAILURES_SHOWN].tolist():
            lane = ds.isel(dict(zip(mask.dims, index, strict=True)))
            values = ((name, lane[name].item()) for name in lane.coords if lane[name].ndim == 0)
            texts = (f"{name}={x:.10g}" if isinstance(x, float) else f"{name}={x}" for name, x in values)
            lines.append("at " + " ".join(texts) + (f": {meanings[reason]}" if reason in meanings else ""))
    return lines


def _accuracy(ds: xr.Dataset) -> SummaryPart:
    """Return the median and the largest error estimate, and the number of lanes within the error tolerance."""
    facts: dict[str, Any] | None = None
    lines: list[str] = []
    if "error_estimate" in ds:
        estimates = ds["error_estimate"]
        errors = estimates.values[~np.isnan(estimates.values)]  # infinite where the two resolutions disagree
        accepted = run_of(ds).get("error")
        facts = {"accepted": accepted, "estimated": errors.size, "within": None, "median": None, "largest": None}
        lines = [] if errors.size else ["no periodic lanes, so no error estimates"]
        if accepted is not None:
            facts["within"] = int((errors <= accepted).sum())
        if errors.size:
            facts |= {"median": float(np.median(errors)), "largest": float(errors.max())}
            lines.append(f"error_estimate median {np.median(errors):.2g}, largest {errors.max():.2g}")
            accepted = RunSettings.error if accepted is None else accepted
            rounded = ds.get("sensitive", xr.zeros_like(estimates, int)).transpose(*estimates.dims) == 1
            within = int(((estimates.values <= accepted) & ~rounded.values).sum())
            share = f"{100 * within / errors.size:.4g} % of {counted(errors.size, 'periodic lane')}"
            lines.append(f"{share} within the accepted {accepted:g}")
            if "cycles" in ds and "drift_estimate" not in ds:
                lines.append("the distance of lanes from where they settle is not included: made before version 0.1.1")
            elif "cycles" in ds and (still := int((ds["drift_estimate"] > accepted).sum())):
                singular = "of them is farther than that from where it settles; a longer settle brings it there"
                plural = "of them are farther than that from where they settle; a longer settle brings them there"
                lines.append(counted(still, singular, plural))
            if count := int(rounded.sum()):
                one = "lane is sensitive: numerical errors decide which attractor it reaches"
                lines.append(
                    counted(count, one, "lanes are sensitive: numerical errors decide which attractor they reach")
                )
    if "regime" in ds and "check_regime" in ds:
        flips = int((ds["regime"].values != ds["check_regime"].values).sum())
        lines.append(f"{flips} of {ds['regime'].size} regimes differ at the check run's coarser resolution")
    return SummaryPart("accuracy", lines, {"accuracy": facts})


_WORDS = {
    "bit_frequency": ("natural frequency of the bit alone", "Hz"),
    "striker_frequency": ("of the striker alone", "Hz"),
    "lower_frequency": ("lower mode", "Hz"),
    "upper_frequency": ("upper mode", "Hz"),
    "blow_frequency": ("blows", "min-1"),
    "rpm": ("rotation", "min-1"),
}
"""For each quantity, its wording in a summary and its unit."""

_DRILL = ("m1", "k1", "beta", "gamma")
_USED = (*_DRILL, *REPLACED, "v")


def frequencies(ds: xr.Dataset) -> dict[str, xr.DataArray]:
    """Return a dict with the frequencies [Hz], blows per minute and rotation speed [1/min] of a sweep or a trajectory.

    - `bit_frequency`, `striker_frequency`: natural frequencies of bit and striker alone, each on its own spring.
    - `lower_frequency`, `upper_frequency`: natural frequencies of the coupled bit and striker, without impact and
      friction (Batako's thesis, eq. 5.16).
    - `blow_frequency`: impacts per minute, for lanes that have a period.
    - `rpm`: rotation speed that corresponds to the drive speed, for sweeps with a bit radius.

    The dict leaves out quantities that the dataset does not determine.

    **Example:**

    >>> motion = vj.simulate("vibro-impact", delta=0.005, start="stuck", progress=False)
    >>> outputs = vj.frequencies(motion)
    >>> f"{float(outputs['striker_frequency']):.3f} Hz, {float(outputs['blow_frequency']):.1f} blows per minute"
    '2.984 Hz, 261.3 blows per minute'
    """
    try:  # the rotation that a sweep file states is not among the parameters of the scene
        table = tomllib.loads(str(ds.attrs.get("sweep", ""))).get("parameters", {})
    except tomllib.TOMLDecodeError:
        table = {}
    known = {name: x for name, x in table.items() if name in ("rpm", "bit_radius") and isinstance(x, (int, float))}
    known |= {**parameters_of(ds), **{str(name): x for name, x in ds.coords.items()}}
    arrays = {name: xr.DataArray(x) for name, x in known.items() if name in _USED}
    given = {name: x.astype(float) for name, x in arrays.items() if x.dtype.kind in "fiu"}
    with np.errstate(all="ignore"):  # a dataset from elsewhere may hold any numbers
        values, found = resolved(given), {}
        if values.keys() >= set(_DRILL):
            found["bit_frequency"], found["striker_frequency"] = uncoupled_frequencies(values)
            columns = xr.broadcast(*(values[name] for name in _DRILL))
            modes = natural_frequencies({name: x.values for name, x in zip(_DRILL, columns, strict=True)}, np)
            for k, name in enumerate(("lower_frequency", "upper_frequency")):
                found[name] = columns[0].copy(data=modes[..., k] / (2 * pi))
        if all(name in ds and ds[name].dtype.kind in "fiu" for name in ("impacts", "period", "cycles")):
            found["blow_frequency"] = blow_frequency(*(ds[name] for name in ("impacts", "cycles", "period")))
        if "bit_radius" in given and ("rpm" in given or "v" in values):
            found["rpm"] = given["rpm"] if "rpm" in given else 60 * values["v"] / (2 * pi * given["bit_radius"])
    about = {name: {"units": unit, "long_name": words} for name, (words, unit) in _WORDS.items()}
    return {name: x.rename(name).assign_attrs(about[name]) for name, x in found.items()}


def frequency_part(ds: xr.Dataset) -> SummaryPart:
    """Return the range of each of the `frequencies` over the lanes; quantities without a finite value are left out."""
    facts, texts = {}, []
    for name, x in frequencies(ds).items():
        finite = x.values[np.isfinite(x.values)]
        if not finite.size:
            continue
        words, unit = _WORDS[name]
        least, most = float(finite.min()), float(finite.max())
        facts[name] = {"least": least, "greatest": most, "units": unit}
        ends = dict.fromkeys((f"{least:.4g}", f"{most:.4g}"))
        texts.append(f"{words} {' to '.join(ends)} {pretty_unit(unit)}")
    masses, others = texts[:4], texts[4:]
    lines = [", ".join(part) for part in (masses, others) if part]
    return SummaryPart("frequency", lines, {"frequencies": facts})

"""What was found along one motion, in words."""

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import xarray

SECTION = "returns to the section (the bit overtakes the drive)"
_STILL = 1e-3
"""The drift from which on it is worth a word."""
_MARGIN = 1.15
"""By how much a duration that is advised is longer than what just suffices."""


def found_lines(dataset: "xarray.Dataset") -> list[str]:
    """Regime, period, blows and rate of penetration of a trajectory; no lines where nothing was measured along it."""
    from vibrojax.io.attributes import run_of

    if not {"settle", "observe"} <= set(run_of(dataset)) or "time" not in dataset.dims:
        return []
    numbers = {str(name): float(one) for name, one in dataset.data_vars.items() if one.ndim == 0}
    lines = _motion(dataset, numbers) if "regime" in numbers else []
    if "rate_of_penetration" in numbers:
        lines += _penetration(dataset, numbers)
    return [*lines, _observed(dataset, numbers)] if lines else []


def regime_of(dataset: "xarray.Dataset") -> str:
    """The name of a motion's regime."""
    return str(dataset["regime"].attrs["flag_meanings"]).split()[int(dataset["regime"])]


def _motion(dataset: "xarray.Dataset", found: dict[str, float]) -> list[str]:
    from vibrojax.measures.labels import FEWEST_RETURNS

    regime, returns, period = regime_of(dataset), int(found["returns"]), found.get("period", math.nan)
    if regime == "equilibrium":
        return ["equilibrium: the bit stands still"]
    if regime == "undecided" and returns < FEWEST_RETURNS:
        advice = f"give duration={_enough(dataset, period):.2g}" if returns > 1 else "give a longer duration"
        few = f"{returns} returns to the section are" if returns > 1 else ("one return is", "no return is")[not returns]
        return [f"undecided: {few} too few to judge by, {FEWEST_RETURNS} are needed; {advice}"]
    if regime == "undecided":
        return ["undecided: the bit's swing steadily grows or decays; a longer duration shows what it ends in"]
    if regime == "failed":
        return ["failed: the motion does not stay finite"]
    cycles = int(found["cycles"])
    if "impacts" not in found:
        repeats = {0: "does not repeat", 1: "repeats"}.get(cycles, f"repeats after {cycles} returns")
        return [f"{regime}: {repeats}, with {period:.5g} s from return to return"]
    blows = found["impacts"]
    how = f", at {found['impact_velocity']:.4g} m/s and {found['impact_energy']:.4g} J" if blows else ""
    mean = ", on average" if blows > 1 or not cycles else ""
    if not cycles:
        often = f"a blow every {period / blows:.4g} s" if blows else "no blow"
        return [f"{regime}: it does not repeat; {often}{mean + how if blows else ''}"]
    each = f"each period of {period:.5g} s" if cycles == 1 else f"each repeat, of {cycles} periods of {period:.5g} s"
    count = {0: "no blow", 1: "one blow"}.get(int(blows), f"{blows:.0f} blows")
    return [f"{regime}: {count} in {each}{mean if blows else ''}{how}"]


def _enough(dataset: "xarray.Dataset", period: float) -> float:
    """A duration [s] of which enough returns are observed."""
    from vibrojax.io.attributes import run_of
    from vibrojax.measures.labels import FEWEST_RETURNS

    run, last = run_of(dataset), float(dataset["time"][-1])
    return _MARGIN * (FEWEST_RETURNS + 1) * period / run["observe"] * last


def _penetration(dataset: "xarray.Dataset", found: dict[str, float]) -> list[str]:
    rate, relief, slip = (found.get(name, math.nan) for name in ("rate_of_penetration", "relief", "slip_per_impact"))
    from vibrojax.io.attributes import parameters_of

    threshold = parameters_of(dataset)["threshold"]
    each = "pulse" if "regime" not in found else "blow"
    force = f"mean force {found['mean_force'] / 1e3:.4g} kN over the {threshold / 1e3:.4g} kN at which the rock yields"
    lines = [f"relief P/D {relief:.4g}: {force}"] if math.isfinite(relief) else []
    if not math.isfinite(rate):
        return [f"no whole {each} was observed, so there is no rate of penetration; give a longer duration", *lines]
    if rate == 0:
        return ["no penetration: the rock does not yield", *lines]
    per = f", {1e3 * slip:.4g} mm for each {each} (slip)" if math.isfinite(slip) else ""
    return [f"rate of penetration {rate:.4g} m/s ({3600 * rate:.4g} m/h){per}", *lines]


def _observed(dataset: "xarray.Dataset", found: dict[str, float]) -> str:
    """What all this was measured over, and whether the motion had settled by then."""
    from vibrojax.io.attributes import run_of

    run = run_of(dataset)
    text = f"measured from {run['settle']:.4g} s to the end at {run['settle'] + run['observe']:.4g} s"
    if "returns" in found:
        text += f": {found['returns']:.0f} {SECTION}"
    drift = found.get("drift_estimate", math.nan)
    if drift > _STILL:
        far = f"by some {100 * drift:.2g} %" if math.isfinite(drift) else "and its returns do not tell how far"
        text += f"; still on its way to where it settles, {far}: a longer duration brings it there"
    return text

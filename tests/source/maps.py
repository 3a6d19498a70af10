"""Quantities derived from several lanes or from a map (a sweep over a grid).

They describe trends, fractions of lanes in the source's region of best performance, and the law of the penetration
rate. "R8" and the like name readings of the source: documented interpretations of ambiguous passages.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float

from source.rules import Here, verdict
from vibrojax.errors import counted
from vibrojax.studies.rop_law import fit_rop

Values = Float[np.ndarray, " values"]

SINGLE_IMPACT = 3
"""Flag value of the regime "single-impact"."""
REGION = {"beta": (0.25, 0.6), "gamma": (0.6, 0.8)}
"""The source's region of best performance: ranges of mass ratio and frequency ratio."""
HALF_STEP = 0.05 + 1e-6
"""Half the source's step of 0.1 in beta and gamma: the uncertainty of the borders of `REGION`."""
LISTED_RATE = 2 * np.pi
"""Ratio of the penetration rate in the source's program listing to the true rate (R8)."""


def rises(values: Values) -> bool:
    """Return whether the values strictly increase."""
    return bool(np.all(np.diff(values) > 0))


def levels_off(values: Values) -> bool:
    """Return whether the second of two increments is positive and below 0.3 times the first.

    In Table 6.7 of the source the increments are 0.15 and 0.04 mm.
    """
    first, second = np.diff(values)
    return bool(0 < second < 0.3 * first)


def straightness(x: Values | xr.DataArray, y: Values | xr.DataArray) -> float:
    """Return R² of a straight line fitted to y over x; 1 if y is constant."""
    x, y = np.asarray(x), np.asarray(y)
    return float(np.corrcoef(x, y)[0, 1] ** 2) if np.ptp(y) > 0 else 1.0


def regime_change(map: xr.Dataset, other: xr.Dataset) -> float:
    """Return the fraction of lanes whose regimes differ between two maps."""
    return float((map.regime != other.regime).mean())


def single_impact_share(map: xr.Dataset) -> float:
    """Return the fraction of a map's lanes with stable single impacts."""
    return float(single_impact(map).mean())


# The source's region of best performance. Flags are boolean arrays over the axes of a map: True for lanes that satisfy
# a criterion.


def single_impact(map: xr.Dataset) -> xr.DataArray:
    """Return flags: the motion has stable single impacts."""
    return map.regime == SINGLE_IMPACT


def clean(map: xr.Dataset) -> xr.DataArray:
    """Return flags: single impacts, with one oscillation of the striker per period."""
    return single_impact(map) & (map.striker_turns < 1.05)


def strong(map: xr.Dataset) -> xr.DataArray:
    """Return flags: clean single impacts whose impact velocity exceeds the driving velocity."""
    return clean(map) & (map.impact_velocity > map.v)


def coexisting(map: xr.Dataset) -> xr.DataArray:
    """Return flags of parameter points with a single impact and, from another initial condition, a worse motion.

    A worse motion has another regime, or an impact velocity below 0.9 times the greatest.
    """
    good = single_impact(map)
    weakest, strongest = map.impact_velocity.fillna(0).min("start"), map.impact_velocity.where(good).max("start")
    return good.any("start") & (~good.all("start") | (weakest < 0.9 * strongest))


def usual_case(flags: xr.DataArray) -> xr.DataArray:
    """Return the flags at the source's gap and driving velocity, for the source's initial condition."""
    return flags.sel(delta=-0.005, v=1.5, start="drive")


def in_region(
    flags: xr.DataArray, beta: Sequence[float] = REGION["beta"], gamma: Sequence[float] = REGION["gamma"]
) -> xr.DataArray:
    """Return the flags inside ranges of the mass ratio and the frequency ratio, borders included."""
    return flags.sel({name: slice(low - 1e-6, high + 1e-6) for name, (low, high) in (("beta", beta), ("gamma", gamma))})


def shares(flags: xr.DataArray) -> Values:
    """Return the fraction of True flags at each value of the first axis."""
    return flags.mean(flags.dims[1:]).values


def failing(flags: xr.DataArray) -> str:
    """Return a remark on the number of False flags, or an empty string if there are none."""
    bad = int((~flags).sum())
    return counted(bad, f"of {flags.size} points is not", f"of {flags.size} points are not") if bad else ""


def whole_region(flags: xr.DataArray) -> Here:
    """Judge whether all flags over beta and gamma are True; along a further axis, the worst case counts.

    The agreement is in trend if at least 80 % are True, and all False flags are within half a step of the border.
    """
    least = float(flags.mean(("beta", "gamma")).min())
    core = flags.sel({name: slice(low + HALF_STEP, high - HALF_STEP) for name, (low, high) in REGION.items()})
    return verdict(least == 1, least >= 0.8 and bool(core.all()))


def share_outside(flags: xr.DataArray) -> float:
    """Return the fraction of True flags among the lanes farther than half a step from `REGION`."""
    beta, gamma = (
        (flags[name] >= low - HALF_STEP) & (flags[name] <= high + HALF_STEP) for name, (low, high) in REGION.items()
    )
    return float(flags.where(~(beta & gamma)).mean())


def extents(flags: xr.DataArray, ratios: Sequence[float]) -> str:
    """Return a string with the range of gamma in which flags are True, for each mass ratio in `ratios`."""
    parts = []
    for beta in ratios:
        gammas = flags.gamma.values[flags.sel(beta=beta, method="nearest").values]
        parts.append(f"beta {beta}: {gammas.min():g} to {gammas.max():g}" if gammas.size else f"beta {beta}: none")
    return "; ".join(parts)


def by_gap(flags: xr.DataArray) -> str:
    """Return a string with each gap and its fraction of True flags. The gap must be the first axis of `flags`."""
    pairs = zip(flags.delta.values, shares(flags), strict=True)
    return ", ".join(f"{1e3 * gap:g} mm {portion:.2f}" for gap, portion in pairs)


# The law of the rate of penetration (eq. 6.4).


def slipping(map: xr.Dataset) -> xr.Dataset:
    """Return the rate and relief of the lanes at a positive rate (the rock slips), along the dimension `lane`."""
    rate = map.rate_of_penetration
    return map[["rate_of_penetration", "relief"]].where(rate > 0).stack(lane=list(rate.dims)).dropna("lane")


def fit_law(map: xr.Dataset, along: str, width: float = 0.004) -> xr.Dataset:
    """Fit eq. 6.4 to a map along the axis `along`, and return the fits; `width` [s] selects the pulse width."""
    if "pulse_width" in map.dims:
        map = map.sel(pulse_width=width, drop=True)
    return fit_rop(map, along=along, progress=False)


def onset_constants(map: xr.Dataset, width: float = 0.004) -> xr.DataArray:
    """Return C [m/s] of formula "onset" over k3 and force, for the rate as the source's listing computes it (R8)."""
    return LISTED_RATE * fit_law(map, "frequency", width).C.sel(form="onset").transpose("k3", "force", ...)


def by_damping(constants: xr.DataArray) -> str:
    """Return a string with the range of C at each damping zeta."""
    ranges = [(zeta, constants.sel(zeta=zeta)) for zeta in constants.zeta.values]
    return "; ".join(f"zeta {zeta}: {float(C.min()):.3g} to {float(C.max()):.3g}" for zeta, C in ranges)


def compare_forms(map: xr.Dataset, along: str) -> dict[str, Any]:
    """Compare the logarithm with the straight line, both fitted to groups of lanes along an axis.

    **Returns:** a dictionary: `better`, the number of groups in which the logarithm has the lower AIC; `groups`, the
    number of groups; `logarithm` and `line`, the R² of both.
    """
    fit = fit_law(map, along)
    better = int((fit.aic.sel(form="onset") < fit.aic.sel(form="line")).sum())
    logarithm, line = fit.r_squared.sel(form="onset"), fit.r_squared.sel(form="line")
    return {"better": better, "groups": logarithm.size, "logarithm": logarithm, "line": line}


def slipping_dampings(map: xr.Dataset) -> Values:
    """Return the values of zeta at which the rock slips at any lane."""
    rates = map.rate_of_penetration
    return map.zeta.values[(rates.max([name for name in rates.dims if name != "zeta"]) > 0).values]


def lightest_slipping(map: xr.Dataset) -> xr.Dataset:
    """Return the part of a map at the lowest zeta at which the rock slips (R24)."""
    return map.sel(zeta=[slipping_dampings(map)[0]])


def excess_over_law(map: xr.Dataset) -> float:
    """Return the relative excess of the simulated rate over the fitted logarithm at the highest frequency and P/D."""
    fit = fit_law(map, "frequency").sel(form="onset")
    constant, onset = float(fit.C.squeeze()), float(fit.eta0.squeeze())
    highest = map.squeeze("zeta").isel(frequency=-1)
    return float(highest.rate_of_penetration) / (constant * np.log(float(highest.relief) / onset)) - 1

"""Regimes of lanes, and quantities of a drill such as impact power and specific energy, from measured features."""

from collections.abc import Mapping
from math import pi
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int8, Shaped

from vibrojax.io.variables import REGIMES as REGIMES
from vibrojax.scenes.capabilities import HasContact, HasRock
from vibrojax.scenes.scene import Scene

UNDECIDED, EQUILIBRIUM, IMPACT_FREE, SINGLE_IMPACT, MULTI_IMPACT, SUBHARMONIC, IRREGULAR, FAILED = range(len(REGIMES))

LABELLED_BY = ("finite", "finished", "at_rest", "bit_amplitude", "returns", "trend", "cycles", "impacts")
"""Features on which the regime of a lane depends."""

UNBOUNDED = (UNDECIDED, IRREGULAR, FAILED)
"""Regimes whose extremes depend on the time of observation."""

EQUILIBRIUM_SWING = 1e-3
"""Amplitude below which a bit counts as being at rest, as a fraction of its static deflection mu(0+) m1 g/k1 [1]."""

LEAST_FRICTION = 0.01
"""Least value of mu(0+) used in the static deflection, for drills without friction [1]."""

SAME_WITHIN = 0.01
"""Greatest relative difference of period, impact velocity and amplitudes between lanes with the same motion [1]."""

COMPARED = ("period", "impact_velocity", "bit_amplitude", "striker_amplitude")
"""Features on which motions in the same regime are compared, if the features exist."""

FEWEST_RETURNS = 9
"""Least number of section crossings needed to classify a motion as periodic or irregular."""

HOLE_RADIUS = 0.036
"""Radius of the hole [m] if no `bit_radius` is given."""

PerStart = Float[np.ndarray, "points starts"]


def label(
    features: Mapping[str, Shaped[np.ndarray, "..."]],
    rest_coefficient: Float[np.ndarray, "..."],
    m1: Float[np.ndarray, "..."],
    g: Float[np.ndarray, "..."],
    k1: Float[np.ndarray, "..."],
) -> Int8[np.ndarray, "..."]:
    """Return the regime of each lane.

    The first of these rules that applies defines the regime. If no rule applies, the lane is irregular:

    1. failed: the state is not finite, or the lane did not reach the end of its observation;
    2. equilibrium: the bit's amplitude is zero within `EQUILIBRIUM_SWING`;
    3. undecided: there are fewer than `FEWEST_RETURNS` section crossings, or the amplitude steadily grows or decays;
    4. impact-free, single-impact, multi-impact: a period is one return interval with no, one or several impacts;
    5. subharmonic: a period is several return intervals.

    **Arguments:**

    - `features`: the features in `LABELLED_BY`, arrays of one shape. `impacts` may be absent (no impacts to count), and
      so may `bit_amplitude` (no bit) and `at_rest` (not measured). Without both, no lane is an equilibrium.
    - `rest_coefficient` [1]: mu(0+); `m1` [kg], `g` [m/s²], `k1` [N/m]: arrays that broadcast to that shape.

    **Returns:** flag values, see `REGIMES`.
    """
    cycles = features["cycles"]
    impacts = features.get("impacts", np.zeros_like(cycles))
    swing = EQUILIBRIUM_SWING * np.maximum(rest_coefficient, LEAST_FRICTION) * m1 * g / k1
    rules = [
        (~(features["finite"] & features["finished"]), FAILED),
        (features.get("at_rest", np.zeros_like(cycles)) == 1, EQUILIBRIUM),
        (features.get("bit_amplitude", np.full_like(swing, np.inf)) < swing, EQUILIBRIUM),
        ((features["returns"] < FEWEST_RETURNS) | (features["trend"] != 0), UNDECIDED),
        ((cycles == 1) & (impacts == 0), IMPACT_FREE),
        ((cycles == 1) & (impacts == 1), SINGLE_IMPACT),
        ((cycles == 1) & (impacts >= 2), MULTI_IMPACT),
        (cycles >= 2, SUBHARMONIC),
    ]
    conditions, flags = zip(*rules, strict=True)
    return np.select(conditions, flags, IRREGULAR).astype(np.int8)


def hides_another(
    features: Mapping[str, Shaped[np.ndarray, " lanes"]], regime: Int8[np.ndarray, " lanes"], starts: int
) -> Int8[np.ndarray, " lanes"]:
    """Return 1 for each lane whose regime label hides another motion at the same grid point, else 0.

    A label hides another motion if another initial condition leads to a different motion in the same regime. Only
    periodic lanes are compared, and differences within their `error_estimate` do not count.

    **Arguments:** `features`: by name; `regime`: flag values; `starts`: number of initial conditions per grid point.
    The lanes of one grid point are adjacent.
    """
    label, repeats = regime.reshape(-1, starts), features["cycles"].reshape(-1, starts) > 0
    error = np.asarray(features["error_estimate"], float).reshape(-1, starts)
    known = [np.asarray(features[name], float).reshape(-1, starts) for name in COMPARED if name in features]
    hidden = np.zeros(label.shape, bool)
    for flag in np.unique(label[repeats]):
        for x in known:
            hidden |= _away(x, error, repeats & (label == flag) & np.isfinite(x) & np.isfinite(error))
    return hidden.ravel().astype(np.int8)


def shares_transient(
    features: Mapping[str, Shaped[np.ndarray, " lanes"]], regime: Int8[np.ndarray, " lanes"], starts: int
) -> Int8[np.ndarray, " lanes"]:
    """Return `sensitive` with 1 also for aperiodic lanes of a grid point at which another lane is sensitive.

    The other lane was on the same chaotic transient, which ends at a time that rounding decides. Arguments are those of
    `hides_another`.
    """
    sensitive = features["sensitive"].reshape(-1, starts) == 1
    aperiodic = (np.isin(regime, (UNDECIDED, IRREGULAR)) & (features["cycles"] == 0)).reshape(-1, starts)
    return (sensitive | (sensitive.any(axis=1, keepdims=True) & aperiodic)).ravel().astype(np.int8)


def _away(x: PerStart, error: PerStart, among: Bool[np.ndarray, "points starts"]) -> Bool[np.ndarray, "points starts"]:
    """Return a mask of the lanes that differ in `x` from another lane of their grid point.

    Only lanes in the mask `among` are compared. The difference must exceed `SAME_WITHIN` plus both errors. For nearly
    all lanes, a comparison with the lanes of least and greatest `x` at the grid point suffices. Of the other lanes,
    only those that would differ from these two if the two had zero error are compared with all. The computing time is
    thus linear in the number of lanes.
    """
    least, greatest = (np.where(among, x, end) for end in (np.inf, -np.inf))
    differing = np.zeros(x.shape, bool)
    for farthest in (least.argmin(axis=1, keepdims=True), greatest.argmax(axis=1, keepdims=True)):
        valid, value, its_error = (np.take_along_axis(of, farthest, 1) for of in (among, x, error))
        differing |= among & valid & _differ(x, error, value, its_error)
    with np.errstate(invalid="ignore"):  # grid points without lanes in `among`
        reach = np.maximum(x - least.min(axis=1)[:, None], greatest.max(axis=1)[:, None] - x)
        undecided = among & ~differing & (reach > (SAME_WITHIN + error) * np.abs(x))
    for point, start in zip(*np.nonzero(undecided), strict=True):
        with_all = _differ(x[point, start], error[point, start], x[point], error[point])
        differing[point, start] = np.any(with_all & among[point])
    return differing


def _differ(x: Any, error: Any, other: Any, other_error: Any) -> Any:
    """Return a mask of the pairs whose relative difference exceeds `SAME_WITHIN` plus both errors.

    The difference is relative to the greater magnitude.
    """
    within = SAME_WITHIN + error + other_error
    with np.errstate(invalid="ignore"):  # motions without impact
        return np.abs(x - other) > within * np.maximum(np.abs(x), np.abs(other))


def derived_names(scene: Scene[Any]) -> tuple[str, ...]:
    """Return the names of the derived quantities of a scene."""
    if not isinstance(scene, HasContact):
        return ()
    return "impact_power", "blow_frequency", *(("specific_energy",) if isinstance(scene, HasRock) else ())


def derived(scene: Scene[Any], features: Mapping[str, Any], bit_radius: Any, xp: Any = np) -> dict[str, Any]:
    """Return the derived quantities of lanes by name; NaN where they are undefined.

    `features`: features of the lanes; `bit_radius` [m]: radius of the hole, one value or (lanes,); `xp`: the module of
    the arrays, numpy or jax.numpy.
    """
    names = derived_names(scene)
    if not names or not {"impacts", "cycles", "period", "impact_energy"} <= features.keys():
        return {}
    impacts, cycles, period = (features[name] for name in ("impacts", "cycles", "period"))
    with np.errstate(all="ignore"):
        power = features["impact_energy"] * impacts / (cycles * period)
        power = xp.where(cycles > 0, xp.where(impacts == 0, 0.0 * period, power), np.nan)
        quantities = {"impact_power": power, "blow_frequency": blow_frequency(impacts, cycles, period, xp)}
        if "specific_energy" in names:
            rate = features["rate_of_penetration"]
            quantities["specific_energy"] = xp.where(rate > 0, power / (pi * bit_radius**2 * rate), np.nan)
    return {name: x.astype(period.dtype) for name, x in quantities.items()}


def blow_frequency(impacts: Any, cycles: Any, period: Any, xp: Any = np) -> Any:
    """Return the impacts per minute; without a repeat, `impacts` counts the impacts of one return."""
    return 60 * impacts / (xp.maximum(cycles, 1) * period)

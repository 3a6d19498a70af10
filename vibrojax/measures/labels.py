"""From features to regimes: one flag per lane, by rules of which the first that holds decides."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int8, Shaped

UNDECIDED, EQUILIBRIUM, IMPACT_FREE, SINGLE_IMPACT, MULTI_IMPACT, SUBHARMONIC, IRREGULAR, FAILED = range(8)

REGIMES = (
    "undecided",
    "equilibrium",
    "impact-free",
    "single-impact",
    "multi-impact",
    "subharmonic",
    "irregular",
    "failed",
)
"""Meaning of each flag, by its number."""

LABELLED_BY = ("finite", "finished", "bit_amplitude", "returns", "trend", "cycles", "impacts")
"""The features that decide a label."""

EQUILIBRIUM_SWING = 1e-3
"""A bit whose half swing is below this part of mu(0+) m1 g/k1, its static deflection, is at rest [1]."""

LEAST_FRICTION = 0.01
"""mu(0+) that the equilibrium's swing is measured by at least, for drills without friction [1]."""

SAME_WITHIN = 0.01
"""Two motions whose period, impact velocity and amplitudes differ by no more than this part are one [1]."""

COMPARED = ("period", "impact_velocity", "bit_amplitude", "striker_amplitude")
"""The features by which motions under one label are compared, where there are any."""

FEWEST_RETURNS = 9
"""Fewest returns to the section that show a repeat."""

PerStart = Float[np.ndarray, "points starts"]


def label(
    features: Mapping[str, Shaped[np.ndarray, "..."]],
    rest_coefficient: Float[np.ndarray, "..."],
    m1: Float[np.ndarray, "..."],
    g: Float[np.ndarray, "..."],
    k1: Float[np.ndarray, "..."],
) -> Int8[np.ndarray, "..."]:
    """The regime of each lane. The first of these rules that holds decides; where none does, it is irregular:

    1. failed: not finite, or not stepped to its end;
    2. equilibrium: the bit's half swing is next to none;
    3. undecided: too few returns, or swings that steadily grow or decay;
    4. impact-free, single-impact, multi-impact: it repeats after one return, with none, one or more impacts;
    5. subharmonic: it repeats after several returns.

    **Arguments:**

    - `features`: from [vibrojax.measures][], those of `LABELLED_BY`; arrays of one shape. `impacts` may be absent (no
      contact), and `bit_amplitude` (no bit, and no equilibrium).
    - `rest_coefficient`: mu(0+) [1]; `m1` [kg], `g` [m/s²], `k1` [N/m]: arrays that broadcast to that shape.

    **Returns:** flags, see `REGIMES`.
    """
    cycles = features["cycles"]
    impacts = features.get("impacts", np.zeros_like(cycles))
    swing = EQUILIBRIUM_SWING * np.maximum(rest_coefficient, LEAST_FRICTION) * m1 * g / k1
    rules = [
        (~(features["finite"] & features["finished"]), FAILED),
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
    """Lanes of whose point another start ends in another motion under the same label: 1, else 0.

    Lanes that repeat are compared, beyond what their `error_estimate` leaves open.

    **Arguments:**

    - `features`: by name; the lanes of a point, `starts` of them, stand one after the other.
    - `regime`: the labels.
    """
    label, repeats = regime.reshape(-1, starts), features["cycles"].reshape(-1, starts) > 0
    error = np.asarray(features["error_estimate"], float).reshape(-1, starts)
    known = [np.asarray(features[name], float).reshape(-1, starts) for name in COMPARED if name in features]
    hidden = np.zeros(label.shape, bool)
    for flag in np.unique(label[repeats]):
        for x in known:
            hidden |= _away(x, error, repeats & (label == flag) & np.isfinite(x) & np.isfinite(error))
    return hidden.ravel().astype(np.int8)


def _away(x: PerStart, error: PerStart, among: Bool[np.ndarray, "points starts"]) -> Bool[np.ndarray, "points starts"]:
    """Lanes `among` those of a point another of which differs in `x` by more than the two errors leave open.

    The lanes of the point's least and greatest value show nearly all of them. Of the others only those are compared
    with all lanes for which the farthest is far enough, were its error nothing: the time goes with the lanes.
    """
    least, greatest = (np.where(among, x, end) for end in (np.inf, -np.inf))
    found = np.zeros(x.shape, bool)
    for farthest in (least.argmin(axis=1), greatest.argmax(axis=1)):
        one = farthest[:, None]
        there = np.take_along_axis(among, one, 1)
        found |= among & there & _differ(x, error, np.take_along_axis(x, one, 1), np.take_along_axis(error, one, 1))
    with np.errstate(invalid="ignore"):  # points without such lanes
        reach = np.maximum(x - least.min(axis=1)[:, None], greatest.max(axis=1)[:, None] - x)
        open_ = among & ~found & (reach > (SAME_WITHIN + error) * np.abs(x))
    for point, start in zip(*np.nonzero(open_), strict=True):
        with_all = _differ(x[point, start], error[point, start], x[point], error[point])
        found[point, start] = np.any(with_all & among[point])
    return found


def _differ(x: Any, error: Any, other: Any, other_error: Any) -> Any:
    """Whether two values differ by more than the part of the greater that errors leave open."""
    within = SAME_WITHIN + error + other_error
    with np.errstate(invalid="ignore"):  # motions without impact
        return np.abs(x - other) > within * np.maximum(np.abs(x), np.abs(other))

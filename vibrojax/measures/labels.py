"""Classification of lanes into regimes by their features: the first rule that holds decides."""

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
"""Features that decide a label."""

EQUILIBRIUM_SWING = 1e-3
"""Half swing of a bit at rest, as a part of its static deflection mu(0+) m1 g/k1 [1]."""

LEAST_FRICTION = 0.01
"""Least mu(0+) in that deflection, for drills without friction [1]."""

SAME_WITHIN = 0.01
"""Greatest relative difference of period, impact velocity and amplitudes of one and the same motion [1]."""

COMPARED = ("period", "impact_velocity", "bit_amplitude", "striker_amplitude")
"""Features by which motions under one label are compared, if they have them."""

FEWEST_RETURNS = 9
"""Least number of returns to the section that show a repeat."""

PerStart = Float[np.ndarray, "points starts"]


def label(
    features: Mapping[str, Shaped[np.ndarray, "..."]],
    rest_coefficient: Float[np.ndarray, "..."],
    m1: Float[np.ndarray, "..."],
    g: Float[np.ndarray, "..."],
    k1: Float[np.ndarray, "..."],
) -> Int8[np.ndarray, "..."]:
    """Return the regime of each lane.

    The first of these rules that holds decides; a lane under none of them is irregular:

    1. failed: not finite, or not stepped to its end;
    2. equilibrium: the bit's half swing is zero within `EQUILIBRIUM_SWING`;
    3. undecided: too few returns, or swings that steadily grow or decay;
    4. impact-free, single-impact, multi-impact: it repeats after one return, with none, one or more impacts;
    5. subharmonic: it repeats after several returns.

    **Arguments:**

    - `features`: the features in `LABELLED_BY`; arrays of one shape. Without a contact `impacts` may be absent, and
      without a bit `bit_amplitude`; there is then no equilibrium.
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
    """Return 1 for each lane if another start at its point ends in another motion under the same label, else 0.

    Only lanes that repeat are compared, and differences within their `error_estimate` do not count.

    **Arguments:** `features` by name, with the `starts` lanes of a point in a row; `regime`: the labels.
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
    """Return a mask of the lanes `among` a point's lanes of which another differs in `x` by more than both errors.

    A comparison with the lanes of the point's least and greatest value decides nearly all. Of the others, only lanes
    that are far enough from these, if their errors were zero, are compared with all: the time is linear in the lanes.
    """
    least, greatest = (np.where(among, x, end) for end in (np.inf, -np.inf))
    differing = np.zeros(x.shape, bool)
    for farthest in (least.argmin(axis=1, keepdims=True), greatest.argmax(axis=1, keepdims=True)):
        valid, value, its_error = (np.take_along_axis(of, farthest, 1) for of in (among, x, error))
        differing |= among & valid & _differ(x, error, value, its_error)
    with np.errstate(invalid="ignore"):  # points without such lanes
        reach = np.maximum(x - least.min(axis=1)[:, None], greatest.max(axis=1)[:, None] - x)
        undecided = among & ~differing & (reach > (SAME_WITHIN + error) * np.abs(x))
    for point, start in zip(*np.nonzero(undecided), strict=True):
        with_all = _differ(x[point, start], error[point, start], x[point], error[point])
        differing[point, start] = np.any(with_all & among[point])
    return differing


def _differ(x: Any, error: Any, other: Any, other_error: Any) -> Any:
    """Return a mask of the values that differ by more than the tolerance and the errors, relative to the greater."""
    within = SAME_WITHIN + error + other_error
    with np.errstate(invalid="ignore"):  # motions without impact
        return np.abs(x - other) > within * np.maximum(np.abs(x), np.abs(other))

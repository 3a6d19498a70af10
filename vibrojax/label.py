"""From features to regimes: one flag per lane, by the rules of the contract, in their order."""

import numpy as np

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
"""Meaning of each flag."""

LABELLED_BY = ("finite", "finished", "bit_amplitude", "returns", "trend", "cycles", "impacts")
"""The features that decide a label."""

EQUILIBRIUM_SWING = 1e-3
LEAST_FRICTION = 0.01
FEWEST_RETURNS = 9


def label(features: dict, rest_coefficient, m1, g, k1) -> np.ndarray:
    """The regime of each lane.

    **Arguments:**

    - `features`: from [vibrojax.measure][]; arrays of one shape. `impacts` may be absent (no contact).
    - `rest_coefficient`: mu(0+) [1]; `m1` [kg], `g` [m/s²], `k1` [N/m]: arrays that broadcast to it.

    **Returns:** int8 array of flags, see `REGIMES`.
    """
    cycles = features["cycles"]
    impacts = features.get("impacts", np.zeros_like(cycles))
    swing = EQUILIBRIUM_SWING * np.maximum(rest_coefficient, LEAST_FRICTION) * m1 * g / k1
    rules = [
        (~(features["finite"] & features["finished"]), FAILED),
        (features["bit_amplitude"] < swing, EQUILIBRIUM),
        ((features["returns"] < FEWEST_RETURNS) | (features["trend"] != 0), UNDECIDED),
        ((cycles == 1) & (impacts == 0), IMPACT_FREE),
        ((cycles == 1) & (impacts == 1), SINGLE_IMPACT),
        ((cycles == 1) & (impacts >= 2), MULTI_IMPACT),
        (cycles >= 2, SUBHARMONIC),
    ]
    conditions, flags = zip(*rules, strict=True)
    return np.select(conditions, flags, IRREGULAR).astype(np.int8)

"""Error estimates of lanes, from a check run with longer steps and from their distance to the limit."""

from collections.abc import Iterator, Sequence
from functools import reduce

import numpy as np
from jaxtyping import Float

from vibrojax.lanes.drift import rock_error
from vibrojax.lanes.inputs import Features, PerLane
from vibrojax.measures.labels import LABELLED_BY
from vibrojax.measures.repeats import state_name

ERROR_FLOOR = 0.03
"""Smallest error estimate, as a fraction of the tolerance. If most steps end at events, the check run takes almost the
same steps, and the difference between the runs underestimates the error."""

DRIFT_MARGIN = 1.25
"""Safety factor on the drift, which assumes a linear return map. One estimate in ten is off by 10 %."""

STATE_SHARE = 0.5
"""Fraction of the difference of amplitudes and section crossings that counts, relative to the scales of states. The
period and the impact velocity of one orbit are single numbers, whose signed errors may be equal in both runs by chance:
of 2,044 lanes of seven systems, 34 had larger errors than their estimates, and 2 with this difference (by 10 %)."""

LOAD_MARGIN = 10.0
"""Multiple of the distance of the states from their limit by which the greatest force of the rock may still change, as
a fraction of the yield force."""


def certified(fine: Features, check: Features, share: float, least: float, states: Sequence[str] = ()) -> Features:
    """Return the features of lanes with `error_estimate` and the features that determine the check run's label.

    `share`, `least`, `states`: see `error_estimate`.
    """
    labelling = {f"check_{name}": check[name] for name in LABELLED_BY if name in check}
    return fine | labelling | {"error_estimate": error_estimate(fine, check, share, least, states)}


def error_estimate(
    fine: Features, coarse: Features, share: float, least: float, states: Sequence[str] = ()
) -> Float[np.ndarray, " lanes"]:
    """Return the estimated relative error of period, impact velocity and rate of penetration, whichever is largest.

    It is the error of the limits that the lane approaches, the sum of four parts: the fraction `share` of the
    difference between the two runs; `least`, in case this difference is small by chance; a multiple of the remaining
    distance from the limit, `drift_estimate`; and the error of a bit that still moves on the rock. It is NaN if a lane
    is not periodic. It is infinite if the number of section crossings or impacts per period differs between the runs,
    or if the drift is unbounded.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        names = [name for name in ("period", "impact_velocity", "rate_of_penetration") if name in fine]
        differences = [
            np.where(coarse[name] == fine[name], 0.0, np.abs(coarse[name] / fine[name] - 1)) for name in names
        ]
        differences += [STATE_SHARE * difference for difference in _state_differences(fine, coarse, states)]
        error = share * reduce(np.fmax, differences) + least + DRIFT_MARGIN * fine["drift_estimate"] + rock_error(fine)
    agree = coarse["cycles"] == fine["cycles"]
    if "impacts" in fine:
        agree &= coarse["impacts"] == fine["impacts"]
    return np.where(fine["cycles"] > 0, np.where(agree, error, np.inf), np.nan)


def _state_differences(fine: Features, coarse: Features, states: Sequence[str]) -> Iterator[PerLane]:
    """Yield the differences of amplitudes and of mean section crossings between two runs, relative to the scales."""
    for name in states:
        pairs = [(fine[f"{name}_amplitude"], coarse[f"{name}_amplitude"])]
        if (key := state_name(name)) in fine:
            last = np.arange(fine[key].shape[1])[::-1] < fine["cycles"][:, None]
            pairs.append(tuple(np.sum(run[key], axis=1, where=last) / fine["cycles"] for run in (fine, coarse)))
        for one, other in pairs:
            yield np.abs(one - other) / fine[f"{name}_scale"]


def error_under_pulses(
    fine: Features, coarse: Features, away: PerLane, share: float, least: float
) -> Float[np.ndarray, " lanes"]:
    """Return the estimated relative error of the rate of penetration, as `error_estimate` does.

    The rate is a mean over the pulses of the observation. Its distance `away` from the limit therefore also contains
    the error of a mean over incomplete periods. A rate of zero has no relative error. It is certified if the force of
    the rock stays below its yield force by a multiple of this distance, else its error is infinite.
    """
    rate, check = fine["rate_of_penetration"], coarse["rate_of_penetration"]
    with np.errstate(invalid="ignore", divide="ignore"):
        error = share * np.where(rate == check, 0.0, np.abs(check / rate - 1)) + least + DRIFT_MARGIN * away
        yields = (fine.get("load", np.nan) + LOAD_MARGIN * away) >= 1
    return np.where((rate == 0) & yields, np.inf, error)

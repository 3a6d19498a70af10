"""Certificates: error estimates, and lanes whose attractor numerical errors determine."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import reduce

import numpy as np
from jaxtyping import Bool, Float, Int

from vibrojax.lanes.drift import PerLaneBool, PerLaneInt, pick, section_crossings
from vibrojax.lanes.engine import Batch, Engine
from vibrojax.lanes.inputs import Features, Index, PerLane
from vibrojax.lanes.settled import repeats_lately
from vibrojax.measures.labels import LABELLED_BY
from vibrojax.measures.ledger import MOST_CYCLES
from vibrojax.measures.repeats import GROWTH, ROCK_STATES, SETTLED_WITHIN, TIME, rock_scale, state_name
from vibrojax.measures.section import Settling
from vibrojax.scenes import Section

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

    It is the error of the limits that the lane approaches. It has four parts, which add up: the fraction `share` of the
    difference between the limits of the two runs; and `least`, in case this difference is small by chance. Further
    parts are a multiple of the remaining distance from the limit, `drift_estimate`, and the error of a bit that still
    moves on the rock. The coarser run has settled, or its features have a `drift_estimate`, too. The error is NaN if a
    lane is not periodic. It is infinite if the number of section crossings or impacts per period differs between the
    runs, or if a drift is unbounded.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        names = [name for name in ("period", "impact_velocity", "rate_of_penetration") if name in fine]
        differences = [
            np.where(coarse[name] == fine[name], 0.0, np.abs(coarse[name] / fine[name] - 1)) for name in names
        ]
        differences += [STATE_SHARE * difference for difference in _state_differences(fine, coarse, states)]
        difference = reduce(np.fmax, differences) + DRIFT_MARGIN * coarse.get("drift_estimate", 0.0)
        error = share * difference + least + DRIFT_MARGIN * fine["drift_estimate"] + rock_error(fine)
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
        for first, other in pairs:
            yield np.abs(first - other) / fine[f"{name}_scale"]


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


ROCK_MARGIN, ROCK_MARGIN_SHORT = 4.0, 100.0
"""Multiple of the changes of the rock's states from period to period that bounds their distance from the limit: in an
observation of many periods, and of one. For a multiplier m, all future changes add up to m/(1 - m) times the last."""


def rock_error(features: Features) -> PerLane:
    """Return the relative error of the rate of penetration that is due to the motion of the bit on the rock.

    A lightly damped bit may still move on the rock, from blow to blow in another way, when the drill has settled. Its
    states at the section are compared over all stored periods. A deviation of the compression by some length may change
    the growth of the hole in a period by this length. Without growth, the error is infinite if a deviation of the
    greatest force might break the rock, else zero. It is zero for a drill without rock.
    """
    cycles = np.nan_to_num(features["cycles"]).astype(int)
    moved = np.zeros(len(cycles))
    if GROWTH not in features:
        return moved
    states = [features[state_name(name)] / features[rock_scale(name)][:, None] for name in ROCK_STATES]
    count = np.sum(np.isfinite(features[TIME]), axis=1)
    for repeat in range(1, MOST_CYCLES + 1):
        lanes = np.flatnonzero(cycles == repeat)
        for state in states if len(lanes) else ():
            for phase in range(repeat):
                same = state[lanes, ::-1][:, phase::repeat]
                ranges = np.fmax.reduce(same, axis=1) - np.fmin.reduce(same, axis=1)
                moved[lanes] = np.fmax(moved[lanes], ranges)
    with np.errstate(invalid="ignore", divide="ignore"):
        growth = features["rate_of_penetration"] * features["period"] * cycles / features[rock_scale(ROCK_STATES[0])]
        away = np.where(count > 2 * cycles, ROCK_MARGIN, ROCK_MARGIN_SHORT) * moved
        return np.where(growth > 0, away / growth, np.where(features["load"] + away < 1, 0.0, np.inf))


def ends_differ(fine: Features, check: Features, section: Section) -> PerLaneBool:
    """Return a mask of aperiodic lanes of which only one run becomes periodic by the end, or each at another time.

    The two runs separate long before the observation, so that the end of a regular transient is the same in both.
    `fine`, `check`: features of main run and check run, including the last section crossings (lanes, returns).
    """
    differ = np.zeros(len(fine["cycles"]), bool)
    lanes = np.flatnonzero((fine["cycles"] == 0) & fine["finished"] & fine["finite"])
    with np.errstate(invalid="ignore"):
        times, others = (_periodic_since(run, lanes, section) for run in (fine, check))
        same = (times == others) | (np.abs(times - others) < SAME_TIME * fine["period"][lanes])
    differ[lanes] = ~(same | (np.isnan(times) & np.isnan(others)))
    return differ


def _periodic_since(features: Features, lanes: PerLaneInt, section: Section) -> PerLane:
    """Return the time of the last section crossing before lanes became periodic, NaN if the last crossings are not.

    It is -inf if all stored crossings are periodic.
    """
    states = section_crossings(features, lanes, np.ones_like(lanes), section).states
    times, since = features[TIME][lanes].T[::-1], np.full(len(lanes), np.nan)
    for repeat in range(ENDS_WITHIN // 2, 0, -1):
        differs = ~(np.max(np.abs(states[:, :-repeat] - states[:, repeat:]), axis=0) < SETTLED_WITHIN)
        number = np.where(differs.any(axis=0), differs.argmax(axis=0) + repeat, len(times))
        time = np.where(number < len(times), pick(times, np.minimum(number, len(times) - 1)), -np.inf)
        since = np.where(number >= ENDS_WITHIN, time, since)
    return since


GROWTH_RETURNS = 40
"""Number of section crossings in the shortest transient in which a step error can grow to the size of the motion. If a
perturbation of 1e-9 m at t = 0 leads to another attractor on the default map, the transient has at least 50."""

CHANGE, ROUNDINGS = 1e-9, 4
"""Relative perturbation of all parameters in the second run, and its minimum in units of machine epsilon."""

FINER = 10.0
"""Ratio of the tolerances of main run and second run of a periodic lane, so that the two differ by the errors of the
main run's steps. Those may exceed the perturbation: of 72 certified lanes of vibro-impact whose attractor depends on
the tolerance or on a perturbation of 1e-9 to 1e-8, the perturbation alone misses 10, and both together none."""

SAME_TIME = 0.05
"""Difference of the settling times of two runs that settle in the same way, in return intervals. Runs that separate in
a chaotic transient also settle within this time of each other, but rarely. In the same motion, settling may take one
return more or less, as a difference passes the tolerance."""

ENDS_WITHIN = 8
"""Number of last section crossings that must repeat in a lane that becomes periodic during its observation."""

SECOND_RUNS, LANE_SECONDS = 8, 25e3
"""Number of second runs of an aperiodic lane, and size of the largest sweep in which they are made [lanes times
simulated seconds]. In such a sweep they take a second. In a large sweep of irregular lanes, they would take five times
as long as everything else."""

BESIDE = 1e-4
"""Distance between section crossings of two runs, relative to the scales of states and the longest return interval, up
to which they count as the same. Labels tell crossings apart from a distance of 1e-3."""

LANES_AT_ONCE = 64
"""Number of lanes up to which second runs are made at once. Beyond it, lanes that are found sensitive are left out of
the next run."""


def sensitive(
    engine: Engine, start: Batch, features: Features, apart: Index, lanes_of_run: int
) -> Int[np.ndarray, " lanes"]:
    """Return 1 for each lane whose attractor numerical errors determine, else 0.

    `start`: the lanes at t = 0; `features`: features of the lanes and of their check run; `apart`: numbers of lanes
    whose two runs become periodic at different times, see `ends_differ`; `lanes_of_run`: see `LANE_SECONDS`.
    """
    period, cycles, settled = (np.asarray(features[name], float) for name in ("period", "cycles", "settling_time"))
    flags = ((cycles == 0) & (features["check_cycles"] > 0)).astype(int)
    flags[apart] = 1
    with np.errstate(invalid="ignore"):
        slow = np.flatnonzero((cycles > 0) & (settled > GROWTH_RETURNS * period))
    if len(slow):
        # Between two crossings, some periods after the lane has settled, compare the time since when the second run has
        # been settled. If that run has not settled yet, this time is later by more than half of its `cycles` intervals.
        second, least = _changed(engine, start.of(slow), 1), engine.run.stepper.least_error(engine.run.requested)
        finer = max(start.accuracy.tolerance / FINER, min(start.accuracy.tolerance, least))
        second = replace(second, accuracy=second.accuracy._replace(tolerance=finer))
        returns = _returns(engine, second, (settled + (2 * cycles + 1.5) * period)[slow])
        times = np.asarray(returns.seen.settled)[cycles[slow].astype(int) - 1, np.arange(len(slow))]
        later = np.abs(times - settled[slow]) / period[slow]
        flags[slow] = ~(np.minimum(later, np.abs(later - 1)) < SAME_TIME)
    # Lanes that have failed are labelled as such; up to their limit of steps they take longer than all others together.
    run, irregular = engine.run, np.flatnonzero((cycles == 0) & features["finished"] & features["finite"])
    end = run.settle + run.observe
    if lanes_of_run * end <= LANE_SECONDS and len(irregular):
        # Left out are lanes that have become periodic by the end of their observation, and those of which the run with
        # the greatest change stays beside the main one: runs with smaller changes then stay there, too.
        lanes = start.of(np.tile(irregular, 2))
        both = _returns(engine, _changed(engine, lanes, np.repeat([0, SECOND_RUNS], len(irregular))), end)
        repeat, other = repeats_lately(both, end).reshape(2, -1)
        flags[irregular[~repeat & other]] = 1
        irregular = irregular[~(repeat | other | _beside(both))]
        changes = 1
        while changes < SECOND_RUNS and len(irregular):
            # Runs of a few lanes are made at once, because they would not fill the vectors of a processor.
            runs = np.arange(changes, min(changes + max(1, LANES_AT_ONCE // len(irregular)), SECOND_RUNS))
            lanes = start.of(np.tile(irregular, len(runs)))
            returns = _returns(engine, _changed(engine, lanes, np.repeat(runs, len(irregular))), end)
            flags[irregular[repeats_lately(returns, end).reshape(len(runs), -1).any(axis=0)]] = 1
            irregular = irregular[flags[irregular] == 0]
            changes = int(runs[-1]) + 1
    return flags


def _changed(engine: Engine, start: Batch, changes: int | Index) -> Batch:
    """Return the lanes at t = 0 with all parameters perturbed by `changes` times the relative perturbation."""
    change = max(CHANGE, ROUNDINGS * float(np.finfo(engine.run.precision).eps))
    factor = np.asarray(1 + changes * change, engine.run.precision)
    parameters = {name: x * factor for name, x in start.given.parameters.items()}
    return engine.begun(replace(start, given=start.given._replace(parameters=parameters)))


def _beside(returns: Settling) -> Bool[np.ndarray, " lanes"]:
    """Return for which lanes two runs have the same last section crossings: the first and the second half of `returns`.

    As long as the runs are so close to each other, their distance is proportional to the change.
    """
    seen, scales = returns.seen, returns.passed.scales
    places = np.concatenate([seen.states[:, : len(scales)], seen.times[:, None]], axis=1)
    main, other = np.split(places, 2, axis=-1)
    scale, _ = np.split(np.stack([*scales, np.fmax.reduce(seen.times[:-1] - seen.times[1:], axis=0)]), 2, axis=-1)
    same = (np.abs(main - other) < BESIDE * scale) | (np.isnan(main) & np.isnan(other))
    return np.asarray(same.all(axis=(0, 1)))


def _returns(engine: Engine, batch: Batch, until: float | PerLane) -> Settling:
    """Step lanes from t = 0 to the times `until` [s] and return their last section crossings."""
    begin = np.broadcast_to(until, batch.begin.shape).astype(batch.begin.dtype)
    [batch] = engine.settle([replace(batch, begin=begin)])
    assert batch.underway is not None
    returns: Settling = batch.underway.carry
    return returns

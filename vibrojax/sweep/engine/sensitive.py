"""Detection of lanes whose attractor is determined by rounding error.

In a chaotic transient, the smallest perturbation grows to the size of the motion. A second run from t = 0, with
parameters perturbed by a relative 1e-9, detects this growth. A periodic lane is sensitive if its second run settles at
another time: the two runs diverged before. An aperiodic lane is sensitive if its check run becomes periodic. In a small
sweep, it is also sensitive if one of several second runs becomes periodic.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Int

from vibrojax.measures.section import Settling
from vibrojax.sweep.engine.batch import Batch, Engine, Features, PerLane
from vibrojax.sweep.engine.underway import repeats_lately

GROWTH_RETURNS = 40
"""Number of section crossings in the shortest transient in which a step error can grow to the size of the motion. If a
perturbation of 1e-9 m at t = 0 leads to another attractor on the default map, the transient has at least 50."""

CHANGE, ROUNDINGS = 1e-9, 4
"""Relative perturbation of all parameters in the second run, and its minimum in units of machine epsilon. The errors of
the default steps have the same size."""

SECOND_RUNS, LANE_SECONDS = 8, 25e3
"""Number of second runs of an aperiodic lane, and size of the largest sweep in which they are made [lanes times
simulated seconds]. In such a sweep they take a second. In a large sweep of irregular lanes, they would take five times
as long as everything else."""


def sensitive(engine: Engine, start: Batch, features: Features) -> Int[np.ndarray, " lanes"]:
    """Return 1 for each lane whose attractor is determined by rounding error, else 0.

    **Arguments:** `start`: the lanes at t = 0. `features`: features of the lanes and of their check run.
    """
    period, cycles, settled = (np.asarray(features[name], float) for name in ("period", "cycles", "settling_time"))
    flags = ((cycles == 0) & (features["check_cycles"] > 0)).astype(int)
    with np.errstate(invalid="ignore"):
        slow = np.flatnonzero((cycles > 0) & (settled > GROWTH_RETURNS * period))
    if len(slow):
        # Two periods after the lane has settled, compare the time since which the second run has been settled.
        returns = _returns(engine, _changed(engine, start.of(slow), 1), (settled + 2 * cycles * period)[slow])
        times = np.asarray(returns.seen.settled)[cycles[slow].astype(int) - 1, np.arange(len(slow))]
        flags[slow] = ~(np.abs(times - settled[slow]) < period[slow] / 2)
    run, irregular = engine.sweep.run, np.flatnonzero(cycles == 0)
    end = run.settle + run.observe
    if engine.sweep.lanes * end <= LANE_SECONDS and len(irregular):
        # Exclude lanes that have become periodic by the end of their observation.
        irregular = irregular[~_repeat(engine, start.of(irregular), end)]
        for changes in range(1, SECOND_RUNS + 1):
            if len(irregular):
                flags[irregular[_repeat(engine, _changed(engine, start.of(irregular), changes), end)]] = 1
                irregular = irregular[flags[irregular] == 0]
    return flags


def _changed(engine: Engine, start: Batch, changes: int) -> Batch:
    """Return the lanes at t = 0 with all parameters perturbed by `changes` times the relative perturbation."""
    change = max(CHANGE, ROUNDINGS * float(np.finfo(engine.sweep.run.precision).eps))
    parameters = {name: (x * (1 + changes * change)).astype(x.dtype) for name, x in start.given.parameters.items()}
    return engine.begun(replace(start, given=start.given._replace(parameters=parameters)))


def _repeat(engine: Engine, batch: Batch, end: float) -> Bool[np.ndarray, " lanes"]:
    """Step lanes from t = 0 and return a mask: True for lanes that are periodic at the time `end` [s]."""
    return repeats_lately(_returns(engine, batch, np.full_like(batch.begin, end)), end)


def _returns(engine: Engine, batch: Batch, until: PerLane) -> Settling:
    """Step lanes to the times `until` [s] and return their last section crossings."""
    [batch] = engine.settle([replace(batch, begin=until.astype(batch.begin.dtype))])
    assert batch.underway is not None
    returns: Settling = batch.underway.carry
    return returns

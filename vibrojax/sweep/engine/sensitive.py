"""Lanes whose attractor is decided by rounding.

In a chaotic transient, the smallest change grows to the size of the motion. A second run from t = 0 with parameters
that differ by 1e-9 shows it. A lane that repeats is sensitive if its second run settles at another time: the two runs
have parted before. A lane that does not repeat is sensitive if its check run repeats; in a small sweep, also if one of
several second runs does.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Int

from vibrojax.measures.section import Settling
from vibrojax.sweep.engine.batch import Batch, Engine, Features, PerLane
from vibrojax.sweep.engine.underway import repeats_lately

GROWTH_RETURNS = 40
"""Returns of the shortest transient in which an error of the steps can grow to the size of the motion. On the default
map, lanes that a change of 1e-9 m at t = 0 sends to another attractor have transients of 50 returns and more."""

CHANGE, ROUNDINGS = 1e-9, 4
"""Relative change of all parameters in the second run, and the least number of roundings that it amounts to. The errors
of the default steps are as large."""

SECOND_RUNS, LANE_SECONDS = 8, 25e3
"""Second runs of a lane that does not repeat, and the largest sweep [lanes times seconds] that has them. There
they take a second; in a large sweep of irregular lanes they would take five times as long as all else."""


def sensitive(engine: Engine, start: Batch, features: Features) -> Int[np.ndarray, " lanes"]:
    """Return 1 for each lane whose attractor is decided by rounding, else 0.

    **Arguments:** `start`: the lanes at t = 0; `features`: of the lanes and of their check run.
    """
    period, cycles, settled = (np.asarray(features[name], float) for name in ("period", "cycles", "settling_time"))
    flags = ((cycles == 0) & (features["check_cycles"] > 0)).astype(int)
    with np.errstate(invalid="ignore"):
        slow = np.flatnonzero((cycles > 0) & (settled > GROWTH_RETURNS * period))
    if len(slow):
        # Two repeats later, the returns of a run that has not settled differ since another time.
        returns = _returns(engine, _changed(engine, start.of(slow), 1), (settled + 2 * cycles * period)[slow])
        times = np.asarray(returns.seen.settled)[cycles[slow].astype(int) - 1, np.arange(len(slow))]
        flags[slow] = ~(np.abs(times - settled[slow]) < period[slow] / 2)
    run, irregular = engine.sweep.run, np.flatnonzero(cycles == 0)
    end = run.settle + run.observe
    if engine.sweep.lanes * end <= LANE_SECONDS and len(irregular):
        # The lane itself may repeat by the end of its observation, because it has settled meanwhile.
        irregular = irregular[~_repeat(engine, start.of(irregular), end)]
        for changes in range(1, SECOND_RUNS + 1):
            if len(irregular):
                flags[irregular[_repeat(engine, _changed(engine, start.of(irregular), changes), end)]] = 1
                irregular = irregular[flags[irregular] == 0]
    return flags


def _changed(engine: Engine, start: Batch, changes: int) -> Batch:
    """Return the lanes at t = 0 with parameters that differ by a number of `changes`."""
    change = max(CHANGE, ROUNDINGS * float(np.finfo(engine.sweep.run.precision).eps))
    parameters = {name: (x * (1 + changes * change)).astype(x.dtype) for name, x in start.given.parameters.items()}
    return engine.begun(replace(start, given=start.given._replace(parameters=parameters)))


def _repeat(engine: Engine, batch: Batch, end: float) -> Bool[np.ndarray, " lanes"]:
    """Return the lanes, stepped from t = 0, that repeat at the time `end` [s]."""
    return repeats_lately(_returns(engine, batch, np.full_like(batch.begin, end)), end)


def _returns(engine: Engine, batch: Batch, until: PerLane) -> Settling:
    """Return the last returns of lanes that are stepped to the times `until` [s]."""
    [batch] = engine.settle([replace(batch, begin=until.astype(batch.begin.dtype))])
    assert batch.underway is not None
    returns: Settling = batch.underway.carry
    return returns

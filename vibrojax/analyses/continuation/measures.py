"""What is measured of the orbits of families, by what measures the lanes of sweeps."""

from dataclasses import replace

import numpy as np

from vibrojax.analyses.continuation.points import Columns, Point
from vibrojax.analyses.continuation.problem import Problem
from vibrojax.periodic.measured import Measuring, begun, joined
from vibrojax.sweep.input.definition import Sweep

STEPS_PER_RETURN = 60.0
"""Roughly, by which lanes are put together that take as long."""

OF_THE_ORBIT = frozenset({"period", "cycles", "impacts", "returns", "settling_time", "trend", "steps"})
"""Features that the orbit itself tells, or that say nothing of one."""


def measured(sweep: Sweep, problem: Problem, points: list[Point], found: Columns) -> dict[str, np.ndarray]:
    """Features of the points by name, each (points,); NaN where an orbit could not be gone round.

    **Arguments:** `sweep`: over the families, one point each, whose parameters are those of the points but for one.
    """
    fixed = {name: x[found.family] for name, x in (sweep.points or {}).items()}
    lanes = replace(
        sweep, points=fixed | {problem.along: found.value}, run=replace(sweep.run, orbits=False, keep_returns=0)
    )
    parts = []
    for cycles in sorted(set(found.cycles.tolist())):
        some = np.flatnonzero(found.cycles == cycles)
        u = np.concatenate([points[k].at.u for k in some])
        times = np.concatenate([points[k].at.times for k in some])
        steps = np.full(len(some), STEPS_PER_RETURN * cycles)
        parts.append(begun(some, problem.states(found.family[some], u), times, steps))
    orbits = joined(parts)
    features, whole = Measuring(lanes)(0, lanes.lanes, orbits)
    measures = {}
    for name, x in features.items():
        if x.ndim == 1 and x.dtype.kind == "f" and name not in OF_THE_ORBIT:
            column = np.full(len(points), np.nan)
            column[orbits.lanes] = np.where(whole, x, np.nan)
            measures[name] = column
    return measures

"""Table of the points of families: order along branches, values, and measured features."""

from collections.abc import Iterable
from dataclasses import replace
from itertools import groupby
from typing import NamedTuple

import numpy as np

from vibrojax.analyses.continuation.branch_segments import Segment
from vibrojax.analyses.continuation.problem import Evaluation, Problem
from vibrojax.io.variables import orbit_name
from vibrojax.periodic.margin import Measuring, begun, joined
from vibrojax.periodic.newton import multipliers
from vibrojax.sweep.input.definition import Sweep

POINT_SPACING = 0.02
"""Scaled distance within which points that are not special are omitted."""

STEPS_PER_RETURN = 60.0
"""Approximate number of steps between two section crossings; lanes with similar numbers of steps are batched."""

ORBIT_FEATURES = frozenset({"period", "cycles", "impacts", "returns", "settling_time", "trend", "steps"})
"""Features that follow from the orbit itself, or that have no meaning for an orbit."""


Table = dict[str, np.ndarray]


class FamilyPoint(NamedTuple):
    """One orbit of a family; `kind` and `note` are empty unless the orbit is a special point."""

    family: int
    branch: int
    orbit: Evaluation
    kind: str = ""
    note: str = ""


def in_order(segments: Iterable[Segment]) -> tuple[list[FamilyPoint], list[FamilyPoint]]:
    """Return the points of all branches, and the special points in the same order.

    Each branch is ordered from one end to the other.
    """
    points: list[FamilyPoint] = []
    special: list[FamilyPoint] = []
    ordered = sorted(segments, key=lambda s: (s.family, s.branch, s.direction * (s.number + 1)))
    for (family, branch), of_branch in groupby(ordered, key=lambda s: (s.family, s.branch)):
        for segment in of_branch:
            along, marks = _thin_out(segment)
            if segment.direction < 0:
                along, marks = along[::-1], marks[::-1]
            # The two segments that meet at the first point of the branch both contain it.
            same = points and (points[-1].family, points[-1].branch) == (family, branch)
            if same and along and _distance(points[-1].orbit, along[0]) < 1e-12:
                along = along[1:]
            points += [FamilyPoint(family, branch, orbit) for orbit in along]
            special += marks
    return points, special


def _thin_out(segment: Segment) -> tuple[list[Evaluation], list[FamilyPoint]]:
    """Return the orbits of a segment at a distance of about `POINT_SPACING`, and the special points.

    The orbits include those of the special points.
    """
    orbits: list[Evaluation] = []
    marks: list[FamilyPoint] = []
    pending = list(segment.marks)
    last = len(segment.orbits.u) - 1
    for k in range(last + 1):
        orbit = segment.orbits.of([k])
        if k in (0, last) or not orbits or _distance(orbits[-1], orbit) >= POINT_SPACING:
            orbits.append(orbit)
        while pending and pending[0].place <= k:
            mark = pending.pop(0)
            marks.append(FamilyPoint(segment.family, segment.branch, mark.orbit, mark.kind, mark.note))
            if _distance(orbits[-1], mark.orbit) > 0:
                orbits.append(mark.orbit)
    return orbits, marks


def _distance(first: Evaluation, second: Evaluation) -> float:
    """Return the scaled distance; infinite between orbits with different numbers of section crossings."""
    if first.u.shape != second.u.shape:
        return np.inf
    return float(np.abs(first.u - second.u).max())


def columns(problem: Problem, points: list[FamilyPoint]) -> Table:
    """Return the values of points by variable name, each (points,) or (points, states)."""
    rows = problem.rows
    values = multipliers(np.array([point.orbit.product[0] for point in points]).reshape(-1, rows, rows))
    family = np.array([point.family for point in points], int)
    cycles = np.array([point.orbit.times.shape[1] for point in points], int)
    states = np.array([point.orbit.u[0, :rows] for point in points]).reshape(-1, rows) * problem.scales[family]
    return {
        "family": family,
        problem.along: np.array([point.orbit.u[0, -1] for point in points], float) * problem.unit[family],
        "branch": np.array([point.branch for point in points], int),
        "stable": np.where(np.isfinite(values).all(axis=1), np.abs(values[:, 0]) < 1, -1),
        "period": np.array([point.orbit.times.sum() for point in points], float) / np.maximum(cycles, 1),
        "cycles": cycles,
        "impacts": np.array([point.orbit.impacts[0] for point in points], float),
        "grazing_margin": np.array([point.orbit.margin[0] for point in points], float),
        **dict(zip(map(orbit_name, problem.scene.return_states), states.T, strict=True)),
        "multiplier_abs": np.abs(values),
        "multiplier_arg": np.abs(np.angle(values)),
    }


def measured(sweep: Sweep, problem: Problem, points: list[FamilyPoint], table: Table) -> Table:
    """Return the measured features of the points by name, each (points,); NaN where the measurement failed.

    **Arguments:** `sweep`: sweep with one point for each family, with all parameters except the continuation parameter.
    """
    fixed = {name: x[table["family"]] for name, x in (sweep.points or {}).items()}
    run = replace(sweep.run, orbits=False, keep_returns=0)
    lanes = replace(sweep, points=fixed | {problem.along: table[problem.along]}, run=run)
    parts = []
    for cycles in sorted(set(table["cycles"].tolist())):
        subset = np.flatnonzero(table["cycles"] == cycles)
        u = np.concatenate([points[k].orbit.u for k in subset])
        times = np.concatenate([points[k].orbit.times for k in subset])
        steps = np.full(len(subset), STEPS_PER_RETURN * cycles)
        parts.append(begun(subset, problem.states(table["family"][subset], u), times, steps))
    orbits = joined(parts)
    features, whole = Measuring(lanes)(0, lanes.lanes, orbits)
    measures: Table = {}
    for name, x in features.items():
        if x.ndim == 1 and x.dtype.kind == "f" and name not in ORBIT_FEATURES:
            measures[name] = np.full(len(points), np.nan)
            measures[name][orbits.lanes] = np.where(whole, x, np.nan)
    return measures

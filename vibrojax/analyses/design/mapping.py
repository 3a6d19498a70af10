"""The coarse map over the varied parameters, and the points of it from which the search begins."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.stats import qmc

from vibrojax.analyses.design.evaluation import Assessment, Simulator, assess
from vibrojax.analyses.design.search import Candidate, evaluate_new
from vibrojax.analyses.design.spec import Constraint, DesignSpec

AXIS_POINTS = {1: 33, 2: 16}
"""Points per axis of the map for one and two varied parameters, which make a grid."""

FIRST_SAMPLE, LARGEST_SAMPLE = 16, 2048
"""Sobol points of the map for more varied parameters: doubled until enough of them are feasible."""

ENOUGH_FEASIBLE = 4
"""Feasible points of the map with which a sample is not doubled."""

SEEDS, TRIED_SEEDS = 3, 12
"""Number of candidates of the search, and number of points compared over their tolerance boxes to choose them."""

APART = 0.12
"""Least distance between two seeds in the unit box (greatest coordinate)."""


class CoarseMap(NamedTuple):
    """The points of the map in the unit box, their assessments without tolerances, and the points' typical spacing."""

    unit: Float[np.ndarray, "points varied"]
    assessments: list[Assessment]
    spacing: float


def coarse_map(simulator: Simulator) -> CoarseMap:
    """Simulate the map from every start."""
    spec = simulator.spec
    count = len(spec.varied)
    if count in AXIS_POINTS:
        axis = np.linspace(0, 1, AXIS_POINTS[count])
        unit = np.stack(np.meshgrid(*[axis] * count, indexing="ij"), axis=-1).reshape(-1, count)
        return CoarseMap(unit, _assessed(simulator, unit), 1 / (AXIS_POINTS[count] - 1))
    sampler = qmc.Sobol(count, seed=0)
    unit = sampler.random(FIRST_SAMPLE)
    assessments = _assessed(simulator, unit)
    while sum(a.feasible for a in assessments) < ENOUGH_FEASIBLE and len(unit) < LARGEST_SAMPLE:
        more = sampler.random(len(unit))
        unit = np.concatenate([unit, more])
        assessments += _assessed(simulator, more)
    return CoarseMap(unit, assessments, len(unit) ** (-1 / count))


def _assessed(simulator: Simulator, unit: Float[np.ndarray, "points varied"]) -> list[Assessment]:
    lanes = simulator(unit, np.zeros((len(unit), len(simulator.spec.tolerances))))
    return [assess(lanes.part(slice(k, k + 1)), simulator.spec, simulator.spec.constraints) for k in range(len(unit))]


def ranked(spec: DesignSpec, coarse: CoarseMap, constraints: Sequence[Constraint]) -> list[int]:
    """Return the points of the map under these constraints, best first."""
    own = constraints is spec.constraints
    ranks = [(a if own else assess(a.lanes, spec, constraints)).rank for a in coarse.assessments]
    return sorted(range(len(ranks)), key=ranks.__getitem__)


def seeds(
    simulator: Simulator, coarse: CoarseMap, offsets: np.ndarray, constraints: Sequence[Constraint], most: int
) -> list[Candidate]:
    """Return candidates at the best points of the map that are apart from one another."""

    def candidate(k: int) -> Candidate:
        return Candidate(coarse.unit[k], offsets, constraints, radius=min(coarse.spacing / 2, 0.25))

    order = ranked(simulator.spec, coarse, constraints)
    if len(offsets) > 1:
        tried = [candidate(k) for k in _apart(coarse, order, min(APART, coarse.spacing), TRIED_SEEDS)]
        evaluate_new(simulator, tried)
        tried.sort(key=lambda c: c.result.rank)
        chosen: list[Candidate] = []
        for c in tried:
            if len(chosen) < most and all(np.abs(c.point - other.point).max() >= APART for other in chosen):
                chosen.append(c)
        return chosen
    return [candidate(k) for k in _apart(coarse, order, APART, most)]


def _apart(coarse: CoarseMap, order: Sequence[int], distance: float, most: int) -> list[int]:
    chosen: list[int] = []
    for k in order:
        if len(chosen) < most and all(np.abs(coarse.unit[k] - coarse.unit[j]).max() >= distance * 0.99 for j in chosen):
            chosen.append(k)
    return chosen

"""Verification of candidates over the tolerance box at corners and random draws, and their repair."""

from collections.abc import Sequence
from itertools import product

import numpy as np
from scipy.stats import qmc

from vibrojax.analyses.design.evaluation import Assessment, Offsets, Simulator, assess
from vibrojax.analyses.design.search import Candidate, evaluate, improve
from vibrojax.analyses.design.spec import DRAWN_BOX, DesignSpec

DRAWS = 256
"""Number of draws in the box at which a finished candidate is simulated again."""

FIRST_DRAWS = 32
"""Number of those draws that are simulated first; if one of them fails, the others are not needed."""

MAX_CORNERS = 8
"""Largest number of corners that the search itself simulates; verification simulates all."""

MAX_REPAIRS = 4
"""Largest number of times that a candidate is repaired."""

ADDED_SAMPLES = 4
"""Largest number of failing samples that a repair adds to the samples of the search."""

REPAIR_RADIUS = 0.02
"""Half-width of the first trust region of a repair, in the unit box."""


def corners(spec: DesignSpec) -> Offsets:
    """Return all corners of the tolerance box, in half-widths; no rows without tolerances."""
    count = len(spec.tolerances)
    return np.array(list(product((-1.0, 1.0), repeat=count))).reshape(-1, count) if count else np.zeros((0, 0))


def search_offsets(spec: DesignSpec) -> Offsets:
    """Return the samples of the search: the centre, and the corners or a balanced part of them."""
    at_corners = corners(spec)
    if len(at_corners) > MAX_CORNERS:
        count = len(spec.tolerances)
        signs = np.sign(qmc.Sobol(count, seed=1).random(MAX_CORNERS) - 0.5)
        at_corners = np.unique(signs, axis=0)
    return np.concatenate([np.zeros((1, len(spec.tolerances))), at_corners])


def box_samples(spec: DesignSpec) -> Offsets:
    """Return the samples of verification: the centre, all corners, and draws in a slightly larger box."""
    count = len(spec.tolerances)
    if not count:
        return np.zeros((1, 0))
    draws = DRAWN_BOX * (2 * qmc.Sobol(count, seed=2).random(DRAWS) - 1)
    return np.concatenate([np.zeros((1, count)), corners(spec), draws])


def verify(simulator: Simulator, candidate: Candidate, samples: Offsets) -> Assessment:
    """Simulate a candidate at all samples, and return the assessment; if some of the first fail, at these alone."""
    if len(samples) == 1 and candidate.assessment is not None:
        return assess(candidate.result.lanes.part(slice(0, 1)), simulator.spec, candidate.constraints)
    unit = np.repeat(candidate.point[None], len(samples), axis=0)
    first = len(samples) - DRAWS + FIRST_DRAWS
    lanes = simulator(unit[:first], samples[:first])
    found = assess(lanes, simulator.spec, candidate.constraints)
    if found.feasible and first < len(samples):
        lanes = lanes.joined(simulator(unit[first:], samples[first:]))
        found = assess(lanes, simulator.spec, candidate.constraints)
    return found


def settle(simulator: Simulator, candidate: Candidate, samples: Offsets) -> Assessment:
    """Verify a candidate and repair it while it fails; return the last assessment over `samples`.

    A repair adds failing samples to those of the search, goes back along the path of the candidate to a point that
    holds there, and continues the search from it.
    """
    found = verify(simulator, candidate, samples)
    for _ in range(MAX_REPAIRS):
        if found.feasible or len(samples) == 1:
            break
        failing = failing_samples(found, simulator.spec, candidate)
        worst = failing[:: max(1, len(failing) // ADDED_SAMPLES)][:ADDED_SAMPLES]
        candidate.offsets = np.concatenate([candidate.offsets, samples[worst]])
        points = [*candidate.path[::-1][:8], candidate.point]
        results = evaluate(simulator, [(candidate, point) for point in points])
        best = min(range(len(points)), key=lambda k: results[k].rank)
        candidate.move(points[best], results[best])
        candidate.radius, candidate.done = REPAIR_RADIUS, False
        improve(simulator, [candidate])
        found = verify(simulator, candidate, samples)
    return found


def failing_samples(found: Assessment, spec: DesignSpec, candidate: Candidate) -> Sequence[int]:
    """Return the samples at which a requirement fails, by index."""
    lanes = found.lanes
    count = lanes.in_regime.shape[0]
    return [k for k in range(count) if assess(lanes.part(slice(k, k + 1)), spec, candidate.constraints).badness > 0]

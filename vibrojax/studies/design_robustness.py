"""Verification of candidates over the tolerance box at corners and random draws, and their repair."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np
from jaxtyping import Float
from scipy.stats import qmc

from vibrojax.studies.design_evaluation import Assessment, Offsets, Simulator, assess
from vibrojax.studies.design_search import Candidate, evaluate, evaluate_new, improve
from vibrojax.studies.design_spec import DRAWN_BOX, Constraint, DesignSpec

DRAWS = 256
"""Number of draws in the box at which a finished candidate is simulated again."""

FIRST_DRAWS = 32
"""Number of those draws that are simulated first; if one of them fails, the others are not needed."""

ZOOM_WIDTHS, ZOOM_DRAWS = (0.25, 0.06), 16
"""Half-widths, relative to the box, of the regions around the samples of least slack, and draws in each."""

MAX_CORNERS = 8
"""Largest number of corners that the search itself simulates; verification simulates all."""

MAX_REPAIRS = 6
"""Largest number of times that a candidate is repaired."""

ADDED_SAMPLES = 4
"""Largest number of failing samples that a repair adds to the samples of the search."""

MAX_TIGHTENING = 0.001
"""Largest amount, relative to its limit, by which a repair tightens a constraint."""

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


def verify(
    simulator: Simulator, candidate: Candidate, samples: Offsets, constraints: Sequence[Constraint]
) -> tuple[Assessment, Float[np.ndarray, "simulated tolerances"]]:
    """Simulate a candidate at `samples`, then near those of least slack; return the assessment and all samples.

    If some of the first samples fail, the others are not simulated.
    """
    if len(samples) == 1:
        return assess(candidate.result.lanes.part(slice(0, 1)), simulator.spec, constraints), samples
    first = len(samples) - DRAWS + FIRST_DRAWS
    size, simulated = float(np.abs(samples).max()), samples[:first]
    lanes = simulator(np.repeat(candidate.point[None], first, axis=0), simulated)
    assessment = assess(lanes, simulator.spec, constraints)
    for width in (None, *ZOOM_WIDTHS):
        if not assessment.feasible:
            break
        near = samples[first:] if width is None else _near_least_slack(assessment, constraints, simulated, width, size)
        if len(near):
            lanes = lanes.joined(simulator(np.repeat(candidate.point[None], len(near), axis=0), near))
            simulated = np.concatenate([simulated, near])
            assessment = assess(lanes, simulator.spec, constraints)
    return assessment, simulated


def _near_least_slack(
    assessment: Assessment, constraints: Sequence[Constraint], simulated: Offsets, width: float, size: float
) -> Float[np.ndarray, "draws tolerances"]:
    """Return draws around the samples of least slack, one for each constraint, in the box of the given size.

    A ridge that crosses the box has its worst sample between the corners, where random draws are too sparse.
    """
    cube = width * size * (2 * qmc.Sobol(simulated.shape[1], seed=3).random(ZOOM_DRAWS) - 1)
    values = assessment.lanes.values
    worst = [np.nan_to_num(c.slack(values[c.variable]).min(axis=1), nan=np.inf) for c in constraints]
    draws = [np.clip(simulated[slack.argmin()] + cube, -size, size) for slack in worst]
    return np.concatenate([simulated[:0], *draws])


def settle(simulator: Simulator, candidate: Candidate, samples: Offsets) -> Assessment:
    """Verify a candidate and repair it while it fails; return its last assessment.

    A repair tightens the constraints by what is missing, and adds the failing samples to the search. Then it
    goes back along the path of the candidate to a point that holds there, and continues the search from it.
    """
    evaluate_new(simulator, [candidate])
    constraints = candidate.constraints
    assessment, simulated = verify(simulator, candidate, samples, constraints)
    for _ in range(MAX_REPAIRS):
        if assessment.feasible or len(samples) == 1:
            break
        failing = failing_samples(assessment, simulator.spec, constraints)
        added = failing[:: max(1, len(failing) // ADDED_SAMPLES)][:ADDED_SAMPLES]
        candidate.offsets = np.concatenate([candidate.offsets, simulated[added]])
        missing = np.maximum(-assessment.slack, 0.0).max(axis=1, initial=0.0)
        candidate.constraints = tuple(
            replace(own, margin=own.margin + x * own.scale)
            for own, x in zip(candidate.constraints, np.minimum(missing, MAX_TIGHTENING), strict=True)
        )
        points = [*candidate.path[::-1][:8], candidate.point]
        assessments = evaluate(simulator, [(candidate, point) for point in points])
        best = min(range(len(points)), key=lambda k: assessments[k].rank)
        candidate.move(points[best], assessments[best])
        candidate.radius, candidate.done = REPAIR_RADIUS, False
        improve(simulator, [candidate])
        assessment, simulated = verify(simulator, candidate, samples, constraints)
    candidate.constraints = constraints
    return assessment


def failing_samples(assessment: Assessment, spec: DesignSpec, constraints: Sequence[Constraint]) -> Sequence[int]:
    """Return the samples at which a requirement fails, by index."""
    lanes = assessment.lanes
    count = lanes.in_regime.shape[0]
    return [k for k in range(count) if assess(lanes.part(slice(k, k + 1)), spec, constraints).badness > 0]

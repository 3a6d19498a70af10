"""Fronts by the epsilon-constraint method: the best objective over the limit of another variable, or over tolerances.

All points of a front are searched in one batch of lanes. Each then continues from its neighbours' solutions where these
are better, until no point changes, and is simulated again over its tolerance box, the tightest limit first.
"""

from collections.abc import Sequence

import numpy as np

from vibrojax.studies.design_dataset import FrontPoint
from vibrojax.studies.design_evaluation import CoarseMap, Simulator, extreme, ranked
from vibrojax.studies.design_orbit_search import advance
from vibrojax.studies.design_robustness import box_samples, search_offsets, settle
from vibrojax.studies.design_search import Candidate, improve
from vibrojax.studies.design_spec import Constraint, DesignSpec

MAX_PASSES = 3
"""Largest number of passes in which points continue from their neighbours' solutions."""

WARM_RADIUS = 0.03
"""Half-width of the first trust region of a point that continues from a neighbour, in the unit box."""

OTHER_BRANCH = 0.03
"""Distance from a neighbour's solution in the unit box from which a point continues from it as well."""

TOLERANCE_SPAN = (0.0, 2.0)
"""Default range of the factor of the tolerances."""


def find_front(simulator: Simulator, coarse: CoarseMap, optima: Sequence[Candidate]) -> list[FrontPoint]:
    """Return the points of the design's front, each verified."""
    spec = simulator.spec
    assert spec.front is not None
    points = [_begin(spec, coarse, limit, optima) for limit in front_limits(spec, coarse, optima)]
    limits = [limit for limit, _ in points]
    candidates = [candidate for _, candidate in points]
    advance(simulator, candidates)
    improve(simulator, candidates)
    passes = 0
    while passes < MAX_PASSES and _pass_on(simulator, candidates):
        passes += 1
    samples = box_samples(spec)
    result: list[FrontPoint] = []
    tightest_last = spec.front.against == "tolerance" or spec.front.end == "least"
    for limit, candidate in sorted(zip(limits, candidates, strict=True), key=lambda x: x[0], reverse=tightest_last):
        factor = limit if spec.front.against == "tolerance" else 1.0
        box = factor * samples if factor else samples[:1]
        point = FrontPoint(limit, candidate, settle(simulator, candidate, box))
        tighter = result[-1] if result else point
        if _exceeds(tighter, point):
            # What holds under a tighter limit holds under this one.
            same = Candidate(tighter.candidate.point, candidate.offsets, candidate.constraints, WARM_RADIUS)
            inherited = FrontPoint(limit, same, settle(simulator, same, box))
            point = inherited if _exceeds(inherited, point) else point
        result.append(point)
    return sorted(result, key=lambda point: limits.index(point.limit))


def _exceeds(point: FrontPoint, other: FrontPoint) -> bool:
    """Return whether a point is feasible and better than another one, which may not be feasible."""
    return point.checked.feasible and not (
        other.checked.feasible and other.checked.objective >= point.checked.objective
    )


def front_limits(spec: DesignSpec, coarse: CoarseMap, optima: Sequence[Candidate]) -> np.ndarray:
    """Return the limits of a front, by default from the least that the map reaches to that of the free optimum."""
    front = spec.front
    assert front is not None
    if front.span is not None:
        return np.linspace(*front.span, front.points)
    if front.against == "tolerance":
        return np.linspace(*TOLERANCE_SPAN, front.points)
    free = without_limit(spec)
    order = ranked(spec, coarse, free)
    values = [extreme(coarse.assessments[k].lanes.values[front.against], front.end) for k in order]
    fit = [
        v for k, v in zip(order, values, strict=True) if coarse.assessments[k].lanes.in_regime.all() and np.isfinite(v)
    ]
    low = min(fit) if front.end == "most" else max(fit)
    optimum = (
        extreme(optima[0].assessment.lanes.values[front.against], front.end) if optima[0].assessment else values[0]
    )
    high = max(values[0], optimum) if front.end == "most" else min(values[0], optimum)
    return np.linspace(low + 0.02 * (high - low), high, front.points)


def without_limit(spec: DesignSpec) -> tuple[Constraint, ...]:
    """Return the constraints without that of the variable against which the front is drawn."""
    front = spec.front
    assert front is not None
    return tuple(c for c in spec.constraints if (c.variable, c.end) != (front.against, front.end))


def _begin(spec: DesignSpec, coarse: CoarseMap, limit: float, optima: Sequence[Candidate]) -> tuple[float, Candidate]:
    """Return the candidate of a point of the front, at the best point of the map under its limit."""
    front = spec.front
    assert front is not None
    offsets, constraints = search_offsets(spec), spec.constraints
    if front.against == "tolerance":
        offsets = limit * offsets if limit else offsets[:1]
    else:
        margin = 2 * spec.template.run.error * abs(limit)
        constraints = (*without_limit(spec), Constraint(front.against, front.end, float(limit), margin))
    best = ranked(spec, coarse, constraints)[0]
    return float(limit), Candidate(coarse.unit[best], offsets, constraints, min(coarse.spacing / 2, 0.25))


def _pass_on(simulator: Simulator, candidates: list[Candidate]) -> bool:
    """Continue each candidate from its neighbours' solutions; keep what is better, and return whether any is."""
    rivals = [
        (i, Candidate(candidates[k].point, c.offsets, c.constraints, WARM_RADIUS))
        for i, c in enumerate(candidates)
        for k in (i - 1, i + 1)
        if 0 <= k < len(candidates) and np.abs(candidates[k].point - c.point).max() > OTHER_BRANCH
    ]
    advance(simulator, [rival for _, rival in rivals])
    improve(simulator, [rival for _, rival in rivals])
    moved = False
    for i, rival in rivals:
        now, new = candidates[i].assessment, rival.assessment
        if now is None or (new is not None and new.better(now, 1e-4)):
            candidates[i], moved = rival, True
    return moved

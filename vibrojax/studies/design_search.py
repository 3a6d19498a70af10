"""The search: proposals are ranked on the orbits' equations, and the best of them simulated over their tolerance boxes.

Orbits are continuous where a stick phase or an impact appears, so a proposal costs no settling there either. What the
orbit does not know is the border of the regime and of the basins of attraction. Simulations find it: a lane that fails
excludes every nominal point whose tolerance box contains it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.stats import qmc

from vibrojax.studies.design_evaluation import Assessment, CoarseMap, Offsets, Simulator, Unit, assess, ranked
from vibrojax.studies.design_orbits import Motion, Request, motions_at, predict
from vibrojax.studies.design_spec import Constraint

MAX_ITERATIONS = 40
LARGEST_RADIUS, LEAST_RADIUS = 0.25, 4e-4
"""Bounds of the search region's half-width in the unit box; the search ends below the lower one."""

PROPOSALS = 64
"""Proposals of an iteration, of which the orbits are computed. A quarter of them lies near the candidate."""

NEAR = 0.25
"""Half-width of the region of the near proposals, relative to that of the others."""

PATTERN_BACK, PATTERN_FACTORS = (1, 2, 4), (0.5, 1.0, 2.0, 4.0)
"""Further proposals continue the last moves: the numbers of moves, and multiples of their sums. They follow ridges."""

SIMULATED = 2
"""Proposals of an iteration that are simulated."""

CRITICAL = 4
"""Samples of the tolerance box, those of least slack, at which a proposal's orbits are computed as well."""

LEAST_GAIN = 1e-4
"""Relative gain of the objective that a proposal must promise."""

SAME_REGION = 0.01
"""Distance in the unit box within which a candidate ends in favour of a better one, at least its region's size."""

LEAST_RELIEF = 1e-2
"""Relative reduction of the violations by which a trial must improve a candidate that is not feasible."""

UNGUIDED = 6
"""Proposals of an iteration, besides two for each varied parameter, where no orbit ranks them."""


SEEDS, TRIED_SEEDS = 3, 12
"""Number of candidates of the search, and number of points compared over their tolerance boxes to choose them."""

APART = 0.12
"""Least distance between two seeds in the unit box (greatest coordinate)."""


@dataclass
class Candidate:
    """A nominal point on its way to an optimum.

    - `offsets` (samples, tolerances): samples of the box at which the constraints must hold; the first is the centre.
    - `radius`: half-width of the region from which proposals come.
    - `motions`: the periodic orbits of the point, one for each motion that the starts lead to; None if not computed,
      empty if a motion has no orbit.
    - `path`: points that were accepted before.
    """

    point: Unit
    offsets: Offsets
    constraints: Sequence[Constraint]
    radius: float
    assessment: Assessment | None = None
    motions: list[Motion] | None = None
    failures: int = 0
    done: bool = False
    path: list[Unit] = field(default_factory=list)

    @property
    def result(self) -> Assessment:
        """The assessment of a candidate that has been simulated."""
        assert self.assessment is not None
        return self.assessment

    def move(self, point: Unit, assessment: Assessment) -> None:
        """Continue from another point."""
        self.path.append(self.point)
        self.point, self.assessment, self.motions = point, assessment, None


def evaluate(simulator: Simulator, trials: Sequence[tuple[Candidate, Unit]]) -> list[Assessment]:
    """Assess points over the samples of their candidates, in one batch of lanes."""
    if not trials:
        return []
    unit = np.concatenate([np.repeat(point[None], len(c.offsets), axis=0) for c, point in trials])
    lanes = simulator(unit, np.concatenate([c.offsets for c, _ in trials]))
    ends = np.cumsum([len(c.offsets) for c, _ in trials])
    parts = [lanes.part(slice(end - len(c.offsets), end)) for (c, _), end in zip(trials, ends, strict=True)]
    return [assess(part, simulator.spec, c.constraints) for (c, _), part in zip(trials, parts, strict=True)]


def evaluate_new(simulator: Simulator, candidates: Sequence[Candidate]) -> None:
    """Assess the candidates that have not been simulated."""
    new = [c for c in candidates if c.assessment is None]
    for c, assessment in zip(new, evaluate(simulator, [(c, c.point) for c in new]), strict=True):
        c.assessment = assessment


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


def improve(simulator: Simulator, candidates: Sequence[Candidate]) -> None:
    """Improve all candidates until none gains any more; they are modified in place."""
    evaluate_new(simulator, candidates)
    for iteration in range(MAX_ITERATIONS):
        active = [c for c in candidates if not c.done]
        if not active:
            break
        for c in active:
            c.motions = motions_at(simulator, c.point, c.result) if c.motions is None else c.motions
        ranked = _ranked_proposals(simulator, active, iteration)
        trials = [(c, point) for c, points in zip(active, ranked, strict=True) for point in points]
        assessments = evaluate(simulator, trials)
        for c in active:
            own = [(point, a) for (other, point), a in zip(trials, assessments, strict=True) if other is c]
            _update(c, own)
        _end_rivals(active)


def _end_rivals(active: Sequence[Candidate]) -> None:
    """End the candidates of the same subject that have come to the region of a better one."""
    for c in active:
        for other in active:
            alike = c.constraints is other.constraints and len(c.offsets) == len(other.offsets)
            near = np.abs(c.point - other.point).max() <= max(SAME_REGION, other.radius)
            c.done |= alike and near and not other.done and other.result.better(c.result)


def _ranked_proposals(simulator: Simulator, active: Sequence[Candidate], iteration: int) -> list[list[Unit]]:
    """Return the proposals to be simulated for each candidate: those that promise most."""
    count = len(active[0].point)
    proposals = []
    for c in active:
        cube = 2 * qmc.Sobol(count, seed=iteration).random(PROPOSALS) - 1
        cube[::4] *= NEAR
        points = np.clip(c.point + c.radius * cube, 0.0, 1.0)
        moves = [c.point - c.path[-back] for back in PATTERN_BACK if back <= len(c.path)]
        pattern = [np.clip(c.point + factor * move, 0.0, 1.0) for move in moves for factor in PATTERN_FACTORS]
        points = np.concatenate([np.array(pattern).reshape(-1, count), points])
        points = points[~_excluded(simulator, c, points)]
        proposals.append(points if c.motions else points[: UNGUIDED + 2 * count])
    guided = [k for k, c in enumerate(active) if c.motions]
    centre = np.zeros((1, len(simulator.spec.tolerances)))
    nominal = predict(simulator, [_request(active[k], proposals[k], centre) for k in guided])
    for k, (objective, slack) in zip(guided, nominal, strict=True):
        c = active[k]
        promising = np.isfinite(objective) & (slack[:, 0] >= min(0.0, -_violation(c))).all(axis=-1)
        if c.result.feasible:
            promising &= objective > c.result.objective + LEAST_GAIN * abs(c.result.objective)
        order = np.flatnonzero(promising)
        proposals[k] = proposals[k][order[np.argsort(-objective[order])]]
    critical = [active[k].offsets[_critical(active[k])] for k in guided]
    boxes = predict(simulator, [_request(active[k], proposals[k], x) for k, x in zip(guided, critical, strict=True)])
    for k, (_, slack) in zip(guided, boxes, strict=True):
        violation = np.maximum(-slack.min(axis=(1, 2), initial=np.inf), 0.0)
        order = np.argsort(violation, kind="stable")
        order = order[violation[order] <= (0.0 if active[k].result.feasible else np.inf)]
        proposals[k] = proposals[k][order[[0, len(order) // 2][:SIMULATED]] if len(order) > 1 else order]
    return [list(points) for points in proposals]


def _request(candidate: Candidate, points: np.ndarray, offsets: Offsets) -> Request:
    return Request(candidate.motions or [], candidate.constraints, points, offsets)


def _violation(candidate: Candidate) -> float:
    """Return the largest violation at the candidate."""
    return float(np.maximum(-candidate.result.slack, 0.0).max(initial=0.0))


def _critical(candidate: Candidate) -> np.ndarray:
    """Return the indices of the samples where the least slack is smallest."""
    values = candidate.result.lanes.values
    slack = [c.slack(values[c.variable]).min(axis=1) for c in candidate.constraints]
    if not slack:
        return np.zeros(0, int)
    return np.argsort(np.nan_to_num(np.min(slack, axis=0), nan=np.inf))[:CRITICAL]


def _excluded(simulator: Simulator, candidate: Candidate, points: np.ndarray) -> np.ndarray:
    """Return which nominal points have a lane that failed in their tolerance boxes."""
    failures, spec = simulator.failures(candidate.constraints), simulator.spec
    size = float(np.abs(candidate.offsets).max(initial=0.0))
    widths = np.array([size * spec.tolerances.get(name, 0.0) for name in spec.varied]) / (spec.high - spec.low)
    return np.array([(np.abs(failures - x) <= widths).all(axis=1).any() for x in points], bool)


def _update(candidate: Candidate, trials: Sequence[tuple[Unit, Assessment]]) -> None:
    """Accept the best of the trials if it is better than the candidate, and adapt the search region."""
    now, radius = candidate.result, candidate.radius
    best = None
    for point, assessment in trials:
        if assessment.better(now if best is None else best[1]):
            best = point, assessment
    if best is not None and (now.feasible or best[1].badness <= (1 - LEAST_RELIEF) * now.badness):
        moved = float(np.abs(best[0] - candidate.point).max())
        candidate.move(*best)
        candidate.radius = min(2 * radius, LARGEST_RADIUS) if moved > radius / 2 else radius
        candidate.failures = 0
        return
    candidate.failures += 1
    if not trials or not now.feasible or candidate.failures > 1:
        candidate.radius, candidate.failures = radius / 2, 0
    candidate.done = candidate.radius < LEAST_RADIUS

"""The search: sequential quadratic programming in trust regions, for several candidates in one batch.

Each trial is simulated from every start at all samples of its tolerance box, and is accepted only if it is better. The
quadratic model knows the derivatives at the orbits, not the borders of regimes and basins. Where these stop the model's
steps, the search polls steps along the linearised constraints with perturbed objectives.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float
from scipy.optimize import linprog, minimize

from vibrojax.analyses.design.evaluation import Assessment, Offsets, Simulator, Unit, assess, distinct_starts
from vibrojax.analyses.design.slopes import Slopes, slopes_at
from vibrojax.analyses.design.spec import Constraint

MAX_ITERATIONS = 40
LARGEST_RADIUS, LEAST_RADIUS = 0.25, 4e-4
"""Bounds of a trust region's half-width in the unit box; the search ends below the lower one."""

LEAST_GAIN = 1e-5
"""Relative gain of the objective that the model must predict; below, the search ends."""

POLLS = 6
"""Number of steps with perturbed objectives, per varied parameter pair and iteration."""

ELASTIC = 1e3
"""Weight of violated linearised constraints in the model, relative to the objective."""

BEND_MARGIN = 1.2
"""Factor of curvatures that trials show, so that the next step keeps the constraints."""

SHORT_STEP = 0.3
"""Length of the second, shorter trial step."""


@dataclass
class Candidate:
    """A nominal point on its way to an optimum.

    - `offsets` (samples, tolerances): samples of the box at which the constraints must hold; the first is the centre.
    - `radius`: half-width of the trust region. `polling`: whether the model's last steps failed.
    - `path`: points that were accepted before.
    - `bend` (1 + constraints,): curvatures by which the model of objective and slacks is lowered (conservative convex
      approximation: Svanberg, SIAM J. Optim. 12, 2002).
    """

    point: Unit
    offsets: Offsets
    constraints: Sequence[Constraint]
    radius: float
    assessment: Assessment | None = None
    slopes: Slopes | None = None
    bend: np.ndarray | None = None
    polling: bool = False
    done: bool = False
    path: list[Unit] = field(default_factory=list)


def evaluate(simulator: Simulator, trials: Sequence[tuple[Candidate, Unit]]) -> list[Assessment]:
    """Assess trial points of candidates, in one batch of lanes."""
    if not trials:
        return []
    unit = np.concatenate([np.repeat(point[None], len(c.offsets), axis=0) for c, point in trials])
    lanes = simulator(unit, np.concatenate([c.offsets for c, _ in trials]))
    ends = np.cumsum([len(c.offsets) for c, _ in trials])
    parts = [lanes.part(slice(end - len(c.offsets), end)) for (c, _), end in zip(trials, ends, strict=True)]
    return [assess(part, simulator.spec, c.constraints) for (c, _), part in zip(trials, parts, strict=True)]


def improve(
    simulator: Simulator, candidates: Sequence[Candidate], report: Callable[[str], None] = lambda line: None
) -> None:
    """Improve all candidates until none gains any more; they are modified in place."""
    rng = np.random.default_rng(0)
    new = [c for c in candidates if c.assessment is None]
    for candidate, found in zip(new, evaluate(simulator, [(c, c.point) for c in new]), strict=True):
        candidate.assessment = found
    for iteration in range(MAX_ITERATIONS):
        active = [c for c in candidates if not c.done]
        if not active:
            break
        _derive(simulator, [c for c in active if c.slopes is None])
        trials = [(c, point) for c in active for point in _trial_points(c, simulator.spec.maximise, rng)]
        results = evaluate(simulator, trials)
        for candidate in active:
            own = [(p, a) for (c, p), a in zip(trials, results, strict=True) if c is candidate]
            _update(candidate, own, simulator.spec.maximise)
        best = max(
            (c.assessment.objective for c in candidates if c.assessment and c.assessment.feasible), default=np.nan
        )
        report(f"iteration {iteration + 1}: {len(active)} candidates, best objective {best:.6g}")


def _derive(simulator: Simulator, candidates: Sequence[Candidate]) -> None:
    if candidates:
        found = [c.assessment for c in candidates if c.assessment is not None]
        for candidate, slopes in zip(
            candidates, slopes_at(simulator, [c.point for c in candidates], found), strict=True
        ):
            candidate.slopes = slopes


@dataclass(frozen=True)
class LinearModel:
    """Objective and slacks near a point: values and derivatives, rows for each distinct motion from the starts."""

    objective: Float[np.ndarray, " motions"]
    objective_slope: Float[np.ndarray, "motions varied"]
    slack: Float[np.ndarray, " rows"]
    slack_slope: Float[np.ndarray, "rows varied"]
    rows: list[tuple[int, int]]


def linear_model(candidate: Candidate, maximise: str) -> LinearModel | None:
    """Return the model with the objective relative to its present magnitude; None where no derivative is known."""
    found, slopes = candidate.assessment, candidate.slopes
    assert found is not None and slopes is not None
    values = found.lanes.values[maximise][0]
    starts = [s for s in distinct_starts(found) if np.isfinite(slopes[maximise][s]).all()]
    if not starts:
        return None
    scale = abs(found.objective) or 1.0
    rows = []
    slack, slope = [], []
    for j, c in enumerate(candidate.constraints):
        for s in starts:
            gradient = c.sign * slopes[c.variable][s] / c.scale
            if np.isfinite(gradient).all() and np.isfinite(found.slack[j, s]):
                rows.append((j, s))
                slack.append(found.slack[j, s])
                slope.append(gradient)
    count = len(candidate.point)
    return LinearModel(
        values[starts] / scale, slopes[maximise][starts] / scale,
        np.array(slack), np.array(slope).reshape(-1, count), rows,
    )  # fmt: skip


def _trial_points(candidate: Candidate, maximise: str, rng: np.random.Generator) -> list[Unit]:
    """Return the trial points of an iteration; without any, the candidate is done."""
    x, r = candidate.point, candidate.radius
    count = len(x)
    low, high = np.maximum(-x, -r), np.minimum(1 - x, r)
    model = linear_model(candidate, maximise)
    steps: list[np.ndarray] = []
    if model is None:
        steps = [r * step for step in rng.uniform(-1, 1, (2 * count + POLLS, count))]
    else:
        full = _model_step(model, candidate, low, high)
        gain = _predicted(model, full)
        if not candidate.polling:
            if gain < LEAST_GAIN and candidate.assessment is not None and candidate.assessment.feasible:
                candidate.done = True
                return []
            steps = [full, SHORT_STEP * full]
        else:
            steps = [_polled(model, low, high, rng) for _ in range(POLLS + count)]
    points: list[Unit] = []
    for step in steps:
        point = np.clip(x + np.clip(step, low, high), 0.0, 1.0)
        if np.abs(point - x).max() > 1e-3 * r and not any(np.abs(point - p).max() < 0.05 * r for p in points):
            points.append(point)
    if not points:
        candidate.polling, candidate.done = True, candidate.polling and r < 10 * LEAST_RADIUS
        candidate.radius = r / 3
    return points


def _predicted(model: LinearModel, step: np.ndarray) -> float:
    """Return the gain that the model predicts: of the objective, or of the slack that is missing."""
    missing = np.maximum(-model.slack, 0).sum() - np.maximum(-model.slack - model.slack_slope @ step, 0).sum()
    return float((model.objective + model.objective_slope @ step).min() - model.objective.min() + ELASTIC * missing)


def _model_step(model: LinearModel, candidate: Candidate, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Return the step that maximises the model of the objective under the model of the constraints."""
    count, motions = len(low), len(model.objective)
    # Unknowns: the step, the worst objective, and one violation that all constraints share.
    linear = np.zeros(count + 2)
    linear[count], linear[count + 1] = -1.0, ELASTIC
    matrix = np.zeros((motions + len(model.slack), count + 2))
    matrix[:, :count] = np.concatenate([model.objective_slope, model.slack_slope])
    matrix[:motions, count], matrix[motions:, count + 1] = -1.0, 1.0
    right = np.concatenate([model.objective - model.objective.min(), model.slack])
    bounds = [*zip(low, high, strict=True), (None, None), (0.0, None)]
    solved = linprog(linear, A_ub=-matrix, b_ub=right, bounds=bounds)
    first = np.asarray(solved.x if solved.status == 0 else np.zeros(count + 2))
    if candidate.bend is None or not candidate.bend.any():
        return np.asarray(first[:count])
    bend = candidate.bend[[0] * motions + [1 + j for j, _ in model.rows]]

    def value(z: np.ndarray) -> np.ndarray:
        return np.asarray(matrix @ z + right - bend * (z[:count] @ z[:count]))

    def slope(z: np.ndarray) -> np.ndarray:
        return matrix - np.outer(bend, np.concatenate([2 * z[:count], [0.0, 0.0]]))

    limits = [{"type": "ineq", "fun": value, "jac": slope}]
    start = np.concatenate([0.1 * first[:count], [0.0, 0.0]])
    result = minimize(
        lambda z: linear @ z, start, jac=lambda z: linear, method="SLSQP", bounds=bounds, constraints=limits
    )
    return np.asarray(result.x[:count] if result.success else first[:count])


def _bend(candidate: Candidate, model: LinearModel, point: Unit, found: Assessment) -> None:
    """Raise or lower the curvatures of the candidate's model to those that a trial at `point` shows."""
    step = point - candidate.point
    square = float(step @ step)
    scale = abs(candidate.assessment.objective) if candidate.assessment is not None else 1.0
    shown = np.zeros(1 + len(candidate.constraints))
    predicted = float((model.objective + model.objective_slope @ step).min())
    shown[0] = (predicted - found.objective / (scale or 1.0)) / square
    for row, (j, start) in enumerate(model.rows):
        actual = found.slack[j, start]
        if np.isfinite(actual):
            shown[1 + j] = max(shown[1 + j], (model.slack[row] + model.slack_slope[row] @ step - actual) / square)
    before = np.zeros_like(shown) if candidate.bend is None else candidate.bend
    candidate.bend = np.maximum(np.maximum(np.nan_to_num(shown), 0.0) * BEND_MARGIN, before / 2)


def _polled(model: LinearModel, low: np.ndarray, high: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return a vertex of the linearised feasible set that maximises a perturbed objective."""
    gradient = model.objective_slope[0]
    size = np.linalg.norm(gradient) or 1.0
    perturbed = gradient / size + rng.normal(size=len(low)) * 1.5 / np.sqrt(len(low))
    keep = model.slack >= 0
    limits = {"A_ub": -model.slack_slope[keep], "b_ub": model.slack[keep]} if keep.any() else {}
    step = linprog(-perturbed, bounds=list(zip(low, high, strict=True)), **limits)
    vertex = step.x if step.status == 0 else np.where(perturbed > 0, high, low)
    return np.asarray(vertex * rng.uniform(0.3, 1.0))


def _update(candidate: Candidate, trials: list[tuple[Unit, Assessment]], maximise: str) -> None:
    """Accept the best of the trials if it is better than the candidate, and adapt the trust region."""
    now, model = candidate.assessment, linear_model(candidate, maximise)
    assert now is not None
    if candidate.done or not trials:
        return
    full, shown = trials[0]
    inside = shown.lost == 0
    if model is not None and inside and not candidate.polling:
        _bend(candidate, model, full, shown)
    point, best = trials[0]
    for p, a in trials[1:]:
        if a.better(best):
            point, best = p, a
    if best.better(now):
        moved = float(np.abs(point - candidate.point).max())
        candidate.path.append(candidate.point)
        candidate.point, candidate.assessment, candidate.slopes = point, best, None
        if point is full:
            candidate.radius = min(max(2 * moved, candidate.radius), LARGEST_RADIUS)
        else:
            candidate.radius = max(moved, candidate.radius / 2)
        candidate.polling = False
    elif not candidate.polling and inside and model is not None:
        candidate.radius /= 2  # the next model knows the curvature
    elif not candidate.polling:
        candidate.polling = True
    else:
        candidate.radius /= 3
        candidate.polling = False
    candidate.done = candidate.radius < LEAST_RADIUS

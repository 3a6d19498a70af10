"""The search: linear models with cutting planes in trust regions, for several candidates in one batch.

Each trial is simulated from every start at all samples of its tolerance box, and is accepted only if it is better. The
model knows the derivatives at the orbits, not the borders of regimes and basins. Where these stop the model's
steps, the search polls steps along the linearised constraints with perturbed objectives.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float
from scipy.optimize import linprog

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

SHORT_STEP = 0.3
"""Length of the second, shorter trial step."""


@dataclass
class Cut:
    """A failed trial, and the derivatives there, which are computed with those of the candidates."""

    point: Unit
    assessment: Assessment
    slopes: Slopes | None = None


@dataclass
class Candidate:
    """A nominal point on its way to an optimum.

    - `offsets` (samples, tolerances): samples of the box at which the constraints must hold; the first is the centre.
    - `radius`: half-width of the trust region. `polling`: whether the model's last steps failed.
    - `path`: points that were accepted before.
    - `cuts`: failed trials, whose linearisations the model includes (Kelley's cutting planes), with their derivatives.
    """

    point: Unit
    offsets: Offsets
    constraints: Sequence[Constraint]
    radius: float
    assessment: Assessment | None = None
    slopes: Slopes | None = None
    cuts: "list[Cut]" = field(default_factory=list)
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
    """Compute the derivatives at the candidates and their cuts that have none."""
    places: list[Candidate | Cut] = [c for c in candidates if c.slopes is None]
    places += [cut for c in candidates for cut in c.cuts if cut.slopes is None]
    known = [(place, place.assessment) for place in places if place.assessment is not None]
    if known:
        found = slopes_at(simulator, [place.point for place, _ in known], [assessment for _, assessment in known])
        for (place, _), slopes in zip(known, found, strict=True):
            place.slopes = slopes


@dataclass(frozen=True)
class LinearModel:
    """Objective and slacks near a point: values and derivatives, rows for each distinct motion and each cut.

    `rows`: the index of the constraint for each row of `slack`.
    """

    objective: Float[np.ndarray, " planes"]
    objective_slope: Float[np.ndarray, "planes varied"]
    slack: Float[np.ndarray, " rows"]
    slack_slope: Float[np.ndarray, "rows varied"]
    rows: list[int]


def linear_model(candidate: Candidate, maximise: str) -> LinearModel | None:
    """Return the model with the objective relative to its present magnitude; None where no derivative is known."""
    assert candidate.assessment is not None and candidate.slopes is not None
    count, scale = len(candidate.point), abs(candidate.assessment.objective) or 1.0
    objective: list[tuple[float, np.ndarray]] = []
    slack: list[tuple[int, float, np.ndarray]] = []
    places: list[Candidate | Cut] = [candidate, *candidate.cuts]
    for place in places:
        found, slopes = place.assessment, place.slopes
        if found is None or slopes is None:
            continue
        values, back = found.lanes.values[maximise][0], candidate.point - place.point
        for s in distinct_starts(found):
            gradient = slopes[maximise][s] / scale
            if np.isfinite(gradient).all():
                # A plane below the present value is none of a concave function, so it is lifted.
                value = values[s] / scale + gradient @ back
                objective.append((value if place is candidate else max(value, objective[0][0]), gradient))
            for j, c in enumerate(candidate.constraints):
                gradient = c.sign * slopes.get(f"{c.variable} {c.end}", slopes[c.variable])[s] / c.scale
                if np.isfinite(gradient).all() and np.isfinite(found.slack[j, s]):
                    value = float(found.slack[j, s] + gradient @ back)
                    least = candidate.assessment.slack[j].min()
                    slack.append((j, value if place is candidate else max(value, least), gradient))
        if not objective:
            return None
    return LinearModel(
        np.array([x for x, _ in objective]), np.array([dx for _, dx in objective]),
        np.array([x for _, x, _ in slack]), np.array([dx for *_, dx in slack]).reshape(-1, count),
        [j for j, *_ in slack],
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
        full = _model_step(model, low, high)
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


def _model_step(model: LinearModel, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Return the step that maximises the model of the objective under the model of the constraints."""
    count, planes = len(low), len(model.objective)
    # Unknowns: the step, the worst objective, and one violation that all constraints share.
    linear = np.zeros(count + 2)
    linear[count], linear[count + 1] = -1.0, ELASTIC
    matrix = np.zeros((planes + len(model.slack), count + 2))
    matrix[:, :count] = np.concatenate([model.objective_slope, model.slack_slope])
    matrix[:planes, count], matrix[planes:, count + 1] = -1.0, 1.0
    right = np.concatenate([model.objective - model.objective.min(), model.slack])
    bounds = [*zip(low, high, strict=True), (None, None), (0.0, None)]
    solved = linprog(linear, A_ub=-matrix, b_ub=right, bounds=bounds)
    return np.asarray(solved.x[:count] if solved.status == 0 else np.zeros(count))


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
    inside = shown.lost == 0 and model is not None
    if inside and not candidate.polling and not shown.better(now):
        candidate.cuts = [*candidate.cuts, Cut(full, shown)][-2 * len(full) :]
    point, best = trials[0]
    for p, a in trials[1:]:
        if a.better(best):
            point, best = p, a
    if best.better(now):
        moved = float(np.abs(point - candidate.point).max())
        candidate.path.append(candidate.point)
        candidate.point, candidate.assessment, candidate.slopes = point, best, None
        candidate.cuts = [cut for cut in candidate.cuts if np.abs(cut.point - point).max() < 2 * candidate.radius]
        if point is full:
            candidate.radius = min(max(2 * moved, candidate.radius), LARGEST_RADIUS)
        else:
            candidate.radius = max(moved, candidate.radius / 2)
        candidate.polling = False
    elif not candidate.polling and inside:
        candidate.radius /= 1.5  # the next model has the trial's linearisation
    elif not candidate.polling:
        candidate.polling = True
    else:
        candidate.radius /= 2
        candidate.polling = False
    candidate.done = candidate.radius < LEAST_RADIUS

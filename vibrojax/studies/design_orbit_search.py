"""Optimisation on the equations of one periodic orbit: SLSQP with derivatives from the implicit function theorem.

No motion has to settle here, so a step costs a few milliseconds. What the orbit does not know, which is the motion from
the other starts and over the tolerances, the points that it proposes are simulated for.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize

from vibrojax.periodic.orbit_derivatives import MODULUS, orbit_features
from vibrojax.studies.design_evaluation import Simulator, Unit, distinct_starts
from vibrojax.studies.design_orbits import is_periodic, orbit_states, scene_parameters
from vibrojax.studies.design_search import Candidate, evaluate, evaluate_new

FIRST_RADIUS, LARGEST_RADIUS, LEAST_RADIUS = 0.05, 0.2, 1e-4
"""Half-widths of the boxes in which SLSQP runs, in the unit box: the first, and bounds of the others."""

ROUND_STEPS, MAX_ROUNDS = 8, 30
"""Largest number of iterations of SLSQP in a box, and of boxes."""

LARGEST_MODULUS = 0.98
"""Largest modulus of a multiplier: nearer to 1, an orbit is about to lose its stability, and settles slowly."""

INSIDE = 1e-6
"""Slack that SLSQP keeps, which covers its own tolerance."""

LEAST_GAIN = 1e-6
"""Relative gain of the objective from which a box is moved."""

LEAST_RELIEF = 1e-2
"""Relative reduction of the violations from which a box is moved."""

MAX_HALVINGS = 3
"""Largest number of points on the way to the orbit's optimum that are simulated."""

FINE_RADIUS = 0.01
"""Half-width of the trust region after an optimum of the orbit that holds from every start."""


class Orbit:
    """The orbit of a candidate's worst start as a function of the point in the unit box."""

    def __init__(self, simulator: Simulator, candidate: Candidate, start: int) -> None:
        assessment = candidate.result
        self._spec, self._constraints = simulator.spec, candidate.constraints
        self._names = list(simulator.names)
        self._of = (*(simulator.features[name] for name in self._names), f"{MODULUS}0")
        parameters, chain = scene_parameters(simulator.spec, candidate.point[None])
        self._by = tuple(chain)
        cycles = int(assessment.lanes.dataset["orbit_cycles"].values[0, start])
        self._guess = orbit_states(simulator.spec, assessment, start, cycles, parameters, 0)[None]
        self._impacts: float | None = None
        nominal = {c.variable: assessment.lanes.values[c.variable][0, start] for c in candidate.constraints}
        slack = [c.slack(nominal[c.variable]) for c in candidate.constraints]
        # The constraints are tightened by what they lose over the samples of the box.
        self._loss = [float(s - assessment.slack[j].min()) for j, s in enumerate(slack)]
        self.scale = abs(assessment.objective) or 1.0
        self.visited: dict[bytes, Visit] = {}
        self.centre = self._solve(candidate.point)

    def rows(self, unit: Unit) -> "Visit":
        """Return objective and slacks at a point, solved from the orbit at the centre.

        Without such an orbit, the centre is extrapolated, and a constraint is violated.
        """
        key = unit.tobytes()
        if key not in self.visited:
            visit, centre = self._solve(unit), self.centre
            if visit is None:
                assert centre is not None
                values = centre.values + centre.slopes @ (unit - centre.unit)
                values[-1] = min(values[-1], -1.0)
                visit = Visit(unit.copy(), values, centre.slopes, self._guess, False)
            self.visited[key] = visit
        return self.visited[key]

    def move(self, centre: "Visit") -> None:
        """Solve further orbits from that of another centre."""
        self.centre, self._guess = centre, centre.states
        self.visited = {centre.unit.tobytes(): centre}

    def _solve(self, unit: Unit) -> "Visit | None":
        """Return the orbit at a point, or None if there is none of the same kind."""
        parameters, chain = scene_parameters(self._spec, unit[None])
        orbit = orbit_features(self._spec.template.system, self._of, self._by, parameters, self._guess, reach=1.0)
        jacobian = np.stack([chain.get(name, np.zeros((1, len(unit)))) for name in self._by], axis=1)
        values, slopes = orbit.values[0], (orbit.derivatives @ jacobian)[0]
        self._impacts = float(orbit.impacts[0]) if self._impacts is None else self._impacts
        sound = np.isfinite(values).all() and np.isfinite(slopes).all() and orbit.impacts[0] == self._impacts
        if not sound:
            return None
        table = dict(zip(self._names, zip(values, slopes, strict=False), strict=False))
        value, slope = table[self._spec.maximise]
        rows = [(value / self.scale, slope / self.scale)]
        for c, loss in zip(self._constraints, self._loss, strict=True):
            x, dx = table[c.variable]
            rows.append((float(c.slack(x)) - loss, c.sign * dx / c.scale))
        rows.append((LARGEST_MODULUS - values[-1], -slopes[-1]))
        rows = [rows[0], *((x - INSIDE, dx) for x, dx in rows[1:])]
        values, slopes = np.array([x for x, _ in rows]), np.array([dx for _, dx in rows])
        return Visit(unit.copy(), values, slopes, orbit.states, True)


class Visit(NamedTuple):
    """An orbit that SLSQP visited: objective and slacks with derivatives, its states, and whether it is valid."""

    unit: Unit
    values: Float[np.ndarray, " rows"]
    slopes: Float[np.ndarray, "rows varied"]
    states: Float[np.ndarray, "1 cycles states"]
    valid: bool

    @property
    def rank(self) -> tuple[float, float]:
        """Key of the order from worst to best: smaller violations, then greater objectives."""
        return (float(np.minimum(self.values[1:] + INSIDE / 2, 0.0).sum()) if self.valid else -np.inf, self.values[0])


def orbit_path(simulator: Simulator, candidate: Candidate) -> list[Unit]:
    """Return points up to the optimum on the orbit of the candidate's worst start; empty if there is no such orbit."""
    assessment = candidate.result
    starts = distinct_starts(assessment)
    if not starts or not is_periodic(assessment, starts[0]) or set(simulator.features) != set(simulator.names):
        return []
    if not np.isfinite(assessment.slack).all():
        return []
    orbit = Orbit(simulator, candidate, starts[0])
    if orbit.centre is None:
        return []
    now = orbit.centre
    radius, path = FIRST_RADIUS, []
    for _ in range(MAX_ROUNDS):
        x = now.unit
        bounds = list(zip(np.maximum(0.0, x - radius), np.minimum(1.0, x + radius), strict=True))
        limits = {"fun": lambda u: orbit.rows(u).values[1:], "jac": lambda u: orbit.rows(u).slopes[1:]}
        minimize(
            lambda u: -orbit.rows(u).values[0], x, jac=lambda u: -orbit.rows(u).slopes[0], method="SLSQP",
            bounds=bounds, constraints=[{"type": "ineq", **limits}], options={"maxiter": ROUND_STEPS, "ftol": 1e-9},
        )  # fmt: skip
        simulator.orbits += len(orbit.visited)
        best = max(orbit.visited.values(), key=lambda visit: visit.rank)
        if best.rank[0] > now.rank[0] * (1 - LEAST_RELIEF) or best.values[0] > now.values[0] + LEAST_GAIN * abs(
            now.values[0]
        ):
            moved = float(np.abs(best.unit - x).max())
            radius = min(2 * radius, LARGEST_RADIUS) if moved > radius / 2 else radius
            now = best
            path.append(best.unit)
        else:
            radius /= 4
        orbit.move(now)
        if radius < LEAST_RADIUS:
            break
    return path


def advance(simulator: Simulator, candidates: Sequence[Candidate]) -> None:
    """Move candidates to the optima of their orbits, or halfway where these fail when simulated; modify them in place.

    Each failure halves the way, so that few points are simulated.
    """
    evaluate_new(simulator, candidates)
    paths = [orbit_path(simulator, c) for c in candidates]
    places = [len(path) - 1 for path in paths]
    for _ in range(MAX_HALVINGS):
        trials = [
            (c, np.clip(path[k], 0.0, 1.0)) for c, path, k in zip(candidates, paths, places, strict=True) if k >= 0
        ]
        assessments = iter(evaluate(simulator, trials))
        for i, (c, path) in enumerate(zip(candidates, paths, strict=True)):
            if places[i] < 0:
                continue
            point, assessment = np.clip(path[places[i]], 0.0, 1.0), next(assessments)
            if assessment.better(c.result):
                whole = places[i] == len(path) - 1
                c.radius = FINE_RADIUS if whole else max(float(np.abs(path[-1] - c.point).max()) / 8, FINE_RADIUS)
                c.move(point, assessment)
                places[i] = -1
            else:
                places[i] = places[i] // 2 if places[i] else -1

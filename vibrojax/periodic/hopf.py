"""Hopf points: a branch ends where the amplitude of its orbits shrinks to zero at an equilibrium.

Orbits with very small amplitudes do not re-arm the section, so the continuation stalls before the Hopf point. The point
itself is located by the linear stability of the equilibrium: there, a pair of eigenvalues crosses the imaginary axis.
The branch leads to that point if the squares of its last amplitudes extrapolate to it (Kuznetsov, *Elements of Applied
Bifurcation Theory*, section 3.4).
"""

import warnings
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.linalg import expm
from scipy.optimize import newton

from vibrojax.compile.xla import precision
from vibrojax.lazy import jax, jnp
from vibrojax.periodic.brackets import LOCATED_WITHIN
from vibrojax.periodic.flow_map import moving_names
from vibrojax.periodic.problem import Points, Problem
from vibrojax.scenes import Scene

EQUILIBRIUM_MAX_ITERATIONS = 20
"""Largest number of Newton iterations for an equilibrium."""

EQUILIBRIUM_STEP = 1e-13
"""Newton step, relative to the largest state or scale, below which an equilibrium has converged."""

SMALLEST_SWING = 3e-3
"""Amplitude, relative to the family's first orbit, at which a branch ends if it shrinks into an equilibrium. Its
distance from the bifurcation is about the square of that. The equilibrium satisfies the orbit's equations, too: without
an end, it would be continued as an orbit without amplitude."""

LEAST_SWING = 3e-4
"""Amplitude below which a point is not accepted as the end of such a branch: it may be the equilibrium itself, and the
tangent is inaccurate, because the multiplier differs from 1 by the square of the amplitude."""

ENCLOSED = 4.0
"""Largest distance of the equilibrium from the section's states, relative to `SMALLEST_SWING`."""

SHRINKING = 1.2
"""Smallest ratio of two amplitudes that are extrapolated to zero."""

EXTRAPOLATION_ERROR = 0.2
"""Largest distance of the Hopf point from the extrapolated one, relative to its distance from the branch's last point
or, if greater, to the distance between the points of the extrapolation, the last of which may be at the Hopf point
within rounding errors. The curvature of the branch contributes a few percent."""

SAME_FREQUENCY = 0.05
"""Largest relative difference between the frequencies of the last orbit and of the eigenvalues at the Hopf point."""


class Equilibrium(NamedTuple):
    """An equilibrium: its states, and the derivatives of the field and of the section's velocity (`normal`).

    Drifting and redundant states are left out.
    """

    states: Float[np.ndarray, " states"]
    jacobian: Float[np.ndarray, "states states"]
    normal: Float[np.ndarray, " states"]

    def pair(self, frequency: float) -> tuple[complex, np.ndarray]:
        """Return the eigenvalue nearest to i `frequency` [1/s], and its eigenvector."""
        values, vectors = np.linalg.eig(self.jacobian)
        nearest = int(np.abs(values - 1j * frequency).argmin())
        return complex(values[nearest]), vectors[:, nearest]

    def nearest_pair(self) -> tuple[complex, np.ndarray] | None:
        """Return the complex eigenvalue next to the imaginary axis, and its eigenvector; None if all are real."""
        values, vectors = np.linalg.eig(self.jacobian)
        turning = np.flatnonzero(values.imag > 0)
        nearest = turning[np.abs(values[turning].real).argmin()] if len(turning) else None
        return None if nearest is None else (complex(values[nearest]), vectors[:, nearest])


def hopf_point(problem: Problem, points: Points) -> Points | None:
    """Return the Hopf point to which the last points of one branch lead, or None if there is none.

    The residual and the margin of the point are zero, and one of its multipliers is 1.
    """
    last, scene = points.of([-1]), problem.scene
    if scene.section is None or last.times.shape[1] > 1 or last.signature.any() or not np.isfinite(last.times).all():
        return None
    family, [along] = last.family, problem.along
    field, rows = _field_near(problem, last)
    value, frequency = float(problem.values(family, last.u)[0, 0]), 2 * np.pi / float(last.times[0, 0])
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of the secant method, for a growth that is constant
        extrapolated = _extrapolated(problem, points, field, rows)
        if extrapolated is None:
            return None
        predicted, base = extrapolated

        def growth(at: float) -> float:
            known = field.equilibrium({along: at})
            return np.nan if known is None else known.pair(frequency)[0].real

        tolerance = LOCATED_WITHIN * problem.unit[family[0], 0]
        # The secant method needs two different values.
        other = predicted if abs(predicted - value) > tolerance else value + 2 * tolerance
        located, report = newton(growth, value, x1=other, tol=tolerance, full_output=True, disp=False)
        known = field.equilibrium({along: located}) if report.converged else None
    if known is None or not problem.first[family[0], 0] <= located <= problem.last[family[0], 0]:
        return None
    eigenvalue, vector = known.pair(frequency)
    near = abs(located - predicted) < EXTRAPOLATION_ERROR * max(abs(located - value), base)
    if not near or abs(eigenvalue.imag / frequency - 1) > SAME_FREQUENCY:
        return None
    period = 2 * np.pi / eigenvalue.imag
    product = section_product(scene, known, eigenvalue, vector, problem.scales[family[0]])
    u = problem.unknowns(family, known.states[rows][None, None], np.array([[located]]))
    zero = np.zeros_like(last.margin)
    times = np.full_like(last.times, period)
    return last._replace(u=u, off=np.zeros_like(last.off), times=times, product=product[None], margin=zero)


def surrounds_equilibrium(problem: Problem, point: Points) -> bool:
    """Return whether an orbit of small amplitude surrounds an equilibrium, into which it may shrink.

    A forced motion has no equilibrium: it may be small, but its amplitude does not vanish along a family.
    """
    if problem.scene.section is None:
        return False
    (field, rows), value = _field_near(problem, point), problem.values(point.family, point.u)[0]
    known = field.equilibrium(dict(zip(problem.along, value.tolist(), strict=True)))
    if known is None:
        return False
    distance = np.abs(known.states[rows] - problem.states(point.family, point.u)[0]) / problem.scales[point.family]
    return bool(distance.max() < ENCLOSED * SMALLEST_SWING)


def _field_near(problem: Problem, point: Points) -> tuple["Field", list[int]]:
    """Return the field in the mode of an orbit, and the places of the return map's states among its states."""
    scene, names = problem.scene, moving_names(problem.scene)
    section = dict(zip(scene.return_states, problem.states(point.family, point.u)[0, 0], strict=True))
    begin = np.array([section.get(name, 0.0) for name in names])
    parameters = {name: x[point.family[0]] for name, x in problem.parameters.items()}
    field = Field(scene, parameters, begin, float(problem.scales[point.family[0]].max()))
    return field, [names.index(name) for name in scene.return_states]


def section_product(
    scene: Scene[Any], known: Equilibrium, eigenvalue: complex, vector: np.ndarray, scale: np.ndarray
) -> Float[np.ndarray, "states states"]:
    """Return the derivative of the return map to the section in the limit of zero amplitude, in scaled states."""
    assert scene.section is not None
    names = moving_names(scene)
    rows, normal = [names.index(name) for name in scene.return_states], known.normal
    away = (vector / (normal @ vector) * 1j).real  # on the section: its velocity is zero
    flow, whole = known.jacobian @ away, expm(known.jacobian * (2 * np.pi / eigenvalue.imag))
    product = whole - np.outer(flow / (normal @ flow), normal @ whole)
    return np.asarray(product[np.ix_(rows, rows)] * scale / scale[:, None])


class Field:
    """Equilibria in the mode of an orbit without events; `begin`: its states without drifting ones.

    `scale`: largest scale of a state. At an equilibrium, all states may be zero.
    """

    def __init__(
        self, scene: Scene[Any], parameters: Mapping[str, Any], begin: Float[np.ndarray, " states"], scale: float
    ) -> None:
        self._begin, self._scale, names = begin, scale, moving_names(scene)
        assert scene.section is not None
        velocity = scene.section.velocity
        beside = () if velocity in names else (velocity,)
        self._normal = None if beside else np.eye(len(names))[names.index(velocity)]

        def whole(states: Any) -> tuple[Any, ...]:
            known = dict(zip(names, states, strict=True))
            return tuple(known.get(name, jnp.zeros_like(states[0])) for name in scene.state_names)

        def field(states: Any, at: Any) -> tuple[Any, Any]:
            c, y = scene.constants(dict(parameters) | at), whole(states)
            mode = scene.mode_at(c, whole(jnp.asarray(self._begin)))
            rates = dict(zip(scene.state_names, scene.field(c, mode, y), strict=True))
            inside = [jnp.ravel(value > 0).all() for value in scene.guard_values(c, mode, y)]
            return jnp.stack([rates[name] for name in (*names, *beside)]), jnp.stack([jnp.asarray(True), *inside]).all()

        self._rates = jax.jit(lambda states, at: (*field(states, at), jax.jacfwd(lambda x: field(x, at)[0])(states)))

    def equilibrium(self, at: Mapping[str, float]) -> Equilibrium | None:
        """Return the equilibrium at parameters `at`, by name; None without one in the mode of the orbit."""
        states, values = self._begin, {name: np.float64(x) for name, x in at.items()}
        for _ in range(EQUILIBRIUM_MAX_ITERATIONS):
            with precision("float64"):
                rates, inside, jacobian = map(np.asarray, self._rates(states, values))
            rates, jacobian, beside = rates[: len(states)], jacobian[: len(states)], jacobian[len(states) :]
            if not np.isfinite(jacobian).all() or np.linalg.matrix_rank(jacobian) < len(states):
                return None
            step = np.linalg.solve(jacobian, -rates)
            states = states + step
            if np.abs(step).max() <= EQUILIBRIUM_STEP * max(np.abs(states).max(), self._scale):
                # The rate of a section's function is its gradient times the field, which is zero here.
                normal = self._normal if self._normal is not None else np.linalg.solve(jacobian.T, beside[0])
                return Equilibrium(states, jacobian, normal) if inside else None
        return None


def _extrapolated(problem: Problem, points: Points, field: Field, rows: list[int]) -> tuple[float, float] | None:
    """Return the parameter value at which the squares of the last amplitudes extrapolate to zero, or None.

    The second result is the distance between the two values from which it is extrapolated.
    """
    squares: list[float] = []
    values, [along] = problem.values(points.family, points.u)[:, 0], problem.along
    for k in range(len(values) - 1, -1, -1):
        known = field.equilibrium({along: float(values[k])})
        if known is None or (points.signature[k] != points.signature[-1]).any():
            return None
        states = problem.states(points.family[[k]], points.u[[k]])[0, 0]
        squares.append(float((((states - known.states[rows]) / problem.scales[points.family[k]]) ** 2).sum()))
        if squares[-1] > SHRINKING**2 * squares[0]:
            change = float(values[-1] - values[k])
            return float(values[-1]) + squares[0] * change / (squares[-1] - squares[0]), abs(change)
    return None

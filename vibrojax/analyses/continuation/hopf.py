"""Hopf points: a branch ends where the amplitude of its orbits shrinks to zero at an equilibrium.

Orbits with very small amplitudes do not re-arm the section, so the continuation stalls before the Hopf point. The point
itself is located by the linear stability of the equilibrium: there, a pair of eigenvalues crosses the imaginary axis.
The branch leads to that point if the squares of its last amplitudes extrapolate to it (Kuznetsov, *Elements of Applied
Bifurcation Theory*, section 3.4).
"""

import warnings
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.linalg import expm
from scipy.optimize import newton

from vibrojax.analyses.continuation.brackets import LOCATED_WITHIN
from vibrojax.analyses.continuation.problem import Points, Problem
from vibrojax.compile.xla import precision

EQUILIBRIUM_MAX_ITERATIONS = 20
"""Largest number of Newton iterations for an equilibrium."""

EQUILIBRIUM_STEP = 1e-13
"""Newton step, relative to the largest state, below which an equilibrium has converged."""

SHRINKING = 1.2
"""Smallest ratio of two amplitudes that are extrapolated to zero."""

EXTRAPOLATION_ERROR = 0.2
"""Largest distance of the Hopf point from the extrapolated one, relative to its distance from the branch's last point.
The curvature of the branch contributes a few percent."""

SAME_FREQUENCY = 0.05
"""Largest relative difference between the frequencies of the last orbit and of the eigenvalues at the Hopf point."""


class Equilibrium(NamedTuple):
    """An equilibrium: its states, and the derivative of the field, without drifting states."""

    states: Float[np.ndarray, " states"]
    jacobian: Float[np.ndarray, "states states"]

    def pair(self, frequency: float) -> tuple[complex, np.ndarray]:
        """Return the eigenvalue nearest to i `frequency` [1/s], and its eigenvector."""
        values, vectors = np.linalg.eig(self.jacobian)
        nearest = int(np.abs(values - 1j * frequency).argmin())
        return complex(values[nearest]), vectors[:, nearest]


def hopf_point(problem: Problem, points: Points) -> Points | None:
    """Return the Hopf point to which the last points of one branch lead, or None if there is none.

    The residual and the margin of the point are zero, and one of its multipliers is 1.
    """
    last, scene = points.of([-1]), problem.scene
    if scene.section is None or last.times.shape[1] > 1 or last.signature.any() or not np.isfinite(last.times).all():
        return None
    family = last.family
    names = [name for name in scene.state_names if name not in scene.drifting]
    rows = [names.index(name) for name in scene.return_states]
    field = _Field(problem, int(family[0]), names, problem.states(family, last.u)[0, 0])
    value, frequency = float(problem.value(family, last.u)[0]), 2 * np.pi / float(last.times[0, 0])
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of the secant method, for a growth that is constant
        predicted = _extrapolated(problem, points, field, rows)
        if predicted is None:
            return None

        def growth(at: float) -> float:
            known = field.equilibrium(at)
            return np.nan if known is None else known.pair(frequency)[0].real

        tolerance = LOCATED_WITHIN * problem.unit[family[0]]
        located, report = newton(growth, value, x1=predicted, tol=tolerance, full_output=True, disp=False)
        known = field.equilibrium(located) if report.converged else None
    if known is None or not problem.first[family[0]] <= located <= problem.last[family[0]]:
        return None
    eigenvalue, vector = known.pair(frequency)
    near = abs(located - predicted) < EXTRAPOLATION_ERROR * abs(located - value)
    if not near or abs(eigenvalue.imag / frequency - 1) > SAME_FREQUENCY:
        return None
    period = 2 * np.pi / eigenvalue.imag
    # The derivative of the return map to zeros of the section's velocity, in the limit of zero amplitude.
    velocity = names.index(scene.section.velocity)
    away = (vector / vector[velocity] * 1j).real  # on the section: its velocity is zero
    flow, whole = known.jacobian @ away, expm(known.jacobian * period)
    product = whole - np.outer(flow / flow[velocity], whole[velocity])
    scale = problem.scales[family[0]]
    product = product[np.ix_(rows, rows)] * scale / scale[:, None]
    u = problem.unknowns(family, known.states[rows][None, None], np.array([located]))
    zero = np.zeros_like(last.margin)
    times = np.full_like(last.times, period)
    return last._replace(u=u, off=np.zeros_like(last.off), times=times, product=product[None], margin=zero)


class _Field:
    """Equilibria of one family in the mode of an orbit without events, by value of the continuation parameter."""

    def __init__(self, problem: Problem, family: int, names: list[str], section: Float[np.ndarray, " rows"]) -> None:
        scene, parameters = problem.scene, {name: x[family] for name, x in problem.parameters.items()}
        self._begin = np.array([dict(zip(scene.return_states, section, strict=True)).get(name, 0.0) for name in names])

        def whole(states: Any) -> tuple[Any, ...]:
            known = dict(zip(names, states, strict=True))
            return tuple(known.get(name, jnp.zeros_like(states[0])) for name in scene.state_names)

        def field(states: Any, at: Any) -> tuple[Any, Any]:
            c, y = scene.constants(parameters | {problem.along: at}), whole(states)
            mode = scene.mode_at(c, whole(jnp.asarray(self._begin)))
            rates = dict(zip(scene.state_names, scene.field(c, mode, y), strict=True))
            inside = [jnp.ravel(value > 0).all() for value in scene.guard_values(c, mode, y)]
            return jnp.stack([rates[name] for name in names]), jnp.stack([jnp.asarray(True), *inside]).all()

        self._rates = jax.jit(lambda states, at: (*field(states, at), jax.jacfwd(lambda x: field(x, at)[0])(states)))

    def equilibrium(self, at: float) -> Equilibrium | None:
        """Return the equilibrium at the parameter value `at`; None without one in the mode of the orbit."""
        states = self._begin
        for _ in range(EQUILIBRIUM_MAX_ITERATIONS):
            with precision("float64"):
                rates, inside, jacobian = map(np.asarray, self._rates(states, np.float64(at)))
            if not np.isfinite(jacobian).all() or np.linalg.matrix_rank(jacobian) < len(states):
                return None
            step = np.linalg.solve(jacobian, -rates)
            states = states + step
            if np.abs(step).max() <= EQUILIBRIUM_STEP * np.abs(states).max():
                return Equilibrium(states, jacobian) if inside else None
        return None


def _extrapolated(problem: Problem, points: Points, field: _Field, rows: list[int]) -> float | None:
    """Return the parameter value at which the squares of the last amplitudes extrapolate to zero, or None."""
    squares: list[float] = []
    values = problem.value(points.family, points.u)
    for k in range(len(values) - 1, -1, -1):
        known = field.equilibrium(float(values[k]))
        if known is None or (points.signature[k] != points.signature[-1]).any():
            return None
        states = problem.states(points.family[[k]], points.u[[k]])[0, 0]
        squares.append(float((((states - known.states[rows]) / problem.scales[points.family[k]]) ** 2).sum()))
        if squares[-1] > SHRINKING**2 * squares[0]:
            return float(values[-1] + squares[0] * (values[-1] - values[k]) / (squares[-1] - squares[0]))
    return None

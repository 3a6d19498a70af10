"""Equilibria of autonomous scenes: the field and its derivative, Newton's method, and pairs of eigenvalues.

An equilibrium is described by the states that move: those that drift or follow from others are left out.
"""

import warnings
from collections.abc import Mapping
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from vibrojax.compile.xla import precision
from vibrojax.lazy import jax, jnp, linalg, optimize
from vibrojax.periodic.flow_map import moving_names
from vibrojax.periodic.newton import PerLane
from vibrojax.scenes import Scene

SOLVED = 1e-9
"""Largest rate of a scaled state, relative to the greatest derivative of the field, at an equilibrium."""

EQUILIBRIUM_LAST_STEPS = 3
"""Newton steps after the search for an equilibrium, which leave nothing but rounding errors."""

IMAGINARY = 1e-9
"""Largest real part of the eigenvalues at a Hopf point, relative to the frequency."""

DISPLACEMENTS = 10.0 ** np.arange(-12, 13)
"""Displacements of a state among which is its scale, if the equilibrium does not show it."""

FEWEST_LANES = 4
"""Smallest number of points that are evaluated together."""


class FieldValues(NamedTuple):
    """The field of a scene at states; the first axis is the lane, unknowns are the states and the varied parameters.

    - `rates`, `jacobian`: of the states, NaN where no equilibrium is isolated, and their derivatives.
    - `normal`: gradient of the section's velocity. `modes`: mode of the motion.
    - `guards`, `guard_slopes`: values of the guards, and their derivatives.
    """

    rates: Float[np.ndarray, "lanes states"]
    jacobian: Float[np.ndarray, "lanes states unknowns"]
    normal: Float[np.ndarray, "lanes unknowns"]
    modes: Float[np.ndarray, "lanes modes"]
    guards: Float[np.ndarray, "lanes guards"]
    guard_slopes: Float[np.ndarray, "lanes guards unknowns"]


class EquilibriumField:
    """The field at many points at once; `along`: varied parameters."""

    def __init__(self, scene: Scene[Any], along: tuple[str, ...]) -> None:
        names = moving_names(scene)
        self._count = len(names)

        def values(x: Any, p: Any) -> tuple[Any, Any]:
            known = dict(zip(names, x[: len(names)], strict=True))
            whole = tuple(known.get(name, jnp.zeros_like(x[0])) for name in scene.state_names)
            c = scene.constants(dict(p) | dict(zip(along, x[len(names) :], strict=True)))
            c = scene.scaled(c, jax.lax.stop_gradient(whole))
            mode = jax.lax.stop_gradient(scene.mode_at(c, whole))
            by_name = dict(zip(scene.state_names, scene.field(c, mode, whole), strict=True))
            none = scene.has_no_field(c, mode, whole)
            rates = [jnp.where(none, jnp.nan, by_name[name]) for name in names]
            velocity = scene.section.velocity if scene.section is not None else names[0]
            # The rate of a section's function is its gradient times the field.
            section = known[velocity] if velocity in known else by_name[velocity]
            every = [*rates, section, *scene.guard_values(c, mode, whole)]
            return jnp.stack([jnp.broadcast_to(x, whole[0].shape) for x in every]), jnp.stack(mode)

        def both(x: Any, p: Any) -> tuple[Any, Any, Any]:
            every, mode = values(x, p)
            return every, jax.jacfwd(lambda x: values(x, p)[0])(x), mode

        self._both = jax.jit(jax.vmap(both))

    def __call__(self, x: Float[np.ndarray, "lanes unknowns"], parameters: Mapping[str, PerLane]) -> FieldValues:
        """Return the field; `x`: states and varied parameters."""
        # Each number of lanes would be compiled: they are padded to a power of two.
        padded = np.resize(np.arange(len(x)), max(FEWEST_LANES, 1 << (len(x) - 1).bit_length()))
        with precision("float64"):
            known = self._both(x[padded], {name: np.asarray(value)[padded] for name, value in parameters.items()})
        (values, slopes, modes), count = (np.asarray(part)[: len(x)] for part in known), self._count
        others = count + 1
        return FieldValues(
            values[:, :count], slopes[:, :count], slopes[:, count], modes, values[:, others:], slopes[:, others:]
        )


field_of = lru_cache(maxsize=64)(EquilibriumField)
"""The field of a scene, which is compiled once in a process."""


class Equilibrium(NamedTuple):
    """An equilibrium: its states, and the derivatives of the field and of the section's velocity (`normal`)."""

    states: Float[np.ndarray, " states"]
    jacobian: Float[np.ndarray, "states states"]
    normal: Float[np.ndarray, " states"]

    def pair(self, frequency: float | None = None) -> tuple[complex, np.ndarray] | None:
        """Return the eigenvalue nearest to i `frequency` [1/s], and its eigenvector.

        Without a frequency, return the complex one next to the imaginary axis, or None if all are real.
        """
        values, vectors = np.linalg.eig(self.jacobian)
        if frequency is None:
            off = np.where(values.imag > 0, np.abs(values.real), np.inf)
        else:
            off = np.abs(values - 1j * frequency)
        nearest = int(off.argmin())
        return (complex(values[nearest]), vectors[:, nearest]) if np.isfinite(off[nearest]) else None


def equilibrium_near(
    scene: Scene[Any], parameters: Mapping[str, float], guess: Float[np.ndarray, " states"], scale: float = 0.0
) -> Equilibrium | None:
    """Return an isolated equilibrium near `guess`, or None; `scale`: of the states, which may be zero there."""
    field, own = field_of(scene, ()), {name: np.array([x]) for name, x in parameters.items()}

    def rates(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        here = field(x[None], own)
        return here.rates[0], here.jacobian[0]

    with np.errstate(all="ignore"):
        states = np.asarray(optimize.root(rates, guess, jac=True, method="hybr", tol=1e-13).x)
        for _ in range(EQUILIBRIUM_LAST_STEPS):
            rate, jacobian = rates(states)
            if not np.isfinite(jacobian).all() or np.linalg.matrix_rank(jacobian) < len(states):
                return None
            states = states - np.linalg.solve(jacobian, rate)
        here = field(states[None], own)
    jacobian, normal = here.jacobian[0], here.normal[0]
    if scene.section is not None and scene.section.velocity not in moving_names(scene):
        normal = np.linalg.solve(jacobian.T, normal)  # the field is zero here
    size = np.abs(jacobian).max() * max(np.abs(states).max(), np.abs(guess).max(), scale, 1e-300)
    return Equilibrium(states, jacobian, normal) if np.abs(here.rates).max() <= SOLVED * size else None


def hopf_near(
    scene: Scene[Any],
    along: str,
    parameters: Mapping[str, float],
    guess: Float[np.ndarray, " states"],
    scale: float,
    frequency: float,
    values: tuple[float, float],
    tolerance: float,
) -> tuple[float, Equilibrium, complex, np.ndarray] | None:
    """Return a Hopf point: value of the parameter `along`, equilibrium, eigenvalue and eigenvector; None without one.

    **Arguments:** `guess`: states near the equilibrium, and their `scale`; `frequency` [1/s]: of the pair of
    eigenvalues; `values`: two different ones of the parameter, with which the secant method begins; `tolerance`: of the
    value.
    """

    def at(value: float) -> Any:
        known = equilibrium_near(scene, {**parameters, along: value}, guess, scale) if np.isfinite(value) else None
        return None if known is None else (known, *known.pair(frequency))  # type: ignore[misc]  # not None here

    def growth(value: float) -> float:
        found = at(value)
        return np.nan if found is None else found[1].real

    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of the secant method, for a growth that is constant
        value = float(optimize.newton(growth, values[0], x1=values[1], tol=tolerance, full_output=True, disp=False)[0])
        found = at(value)
    return None if found is None or abs(found[1].real) > IMAGINARY * frequency else (value, *found)


def section_product(
    scene: Scene[Any], known: Equilibrium, eigenvalue: complex, vector: np.ndarray, scale: np.ndarray
) -> Float[np.ndarray, "states states"]:
    """Return the derivative of the return map to the section in the limit of zero amplitude, in scaled states."""
    names = moving_names(scene)
    rows, normal = [names.index(name) for name in scene.return_states], known.normal
    away = (vector / (normal @ vector) * 1j).real  # on the section: its velocity is zero
    flow, whole = known.jacobian @ away, linalg.expm(known.jacobian * (2 * np.pi / eigenvalue.imag))
    product = whole - np.outer(flow / (normal @ flow), normal @ whole)
    return np.asarray(product[np.ix_(rows, rows)] * scale / scale[:, None])


def scales_at(
    scene: Scene[Any],
    along: str,
    parameters: Mapping[str, float],
    states: Float[np.ndarray, " states"],
    bounds: tuple[float, float],
) -> Float[np.ndarray, " states"]:
    """Return the displacement of each state by which an eigenvalue changes as much as along the parameter's bounds.

    It is 0 if no displacement changes an eigenvalue by that, and by the eigenvalue itself. Eigenvalues do not depend on
    units of the states.
    """
    size = len(states)
    displaced = states + (DISPLACEMENTS[:, None, None] * np.eye(size)).reshape(-1, size)
    values = np.append([parameters[along], *bounds], np.full(len(displaced), parameters[along]))
    unknowns = np.column_stack([np.concatenate([np.tile(states, (3, 1)), displaced]), values])
    known = {name: np.full(len(values), x) for name, x in parameters.items()}
    jacobian = field_of(scene, (along,))(unknowns, known).jacobian[..., :size]
    finite = np.isfinite(jacobian).all(axis=(1, 2))
    every = np.linalg.eigvals(np.where(finite[:, None, None], jacobian, jacobian[0]))
    change = np.abs(every[:, :, None] - every[0]).min(axis=1)
    needed = np.maximum(np.abs(every[0]), change[1:3].max(axis=0))
    enough = ((change[3:] >= needed) & (needed > 0)).any(axis=1).reshape(len(DISPLACEMENTS), size)
    return np.where(enough.any(axis=0), DISPLACEMENTS[enough.argmax(axis=0)], 0.0)

"""Features of orbits as functions of JAX arrays, with gradients by the implicit function theorem: `as_jax`."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from vibrojax.errors import InputError, Place, shown
from vibrojax.maps.read import read_point
from vibrojax.periodic.orbit_derivatives import MARGIN, STABILITY, orbit_variables
from vibrojax.scenes import Scene
from vibrojax.studies.sensitivity_branch import Branch
from vibrojax.studies.sensitivity_run import read_names

OUTSIDE = ("nearest", "nan")

VALID, LOGARITHM = "valid", "margin"
"""Names of the outputs in addition to the features: whether the point has an orbit, and the stability margin."""


def as_jax(
    scene: str | Scene[Any],
    *,
    of: str | Sequence[str],
    by: str | Sequence[str],
    start: str | Sequence[float] | None = None,
    outside: str = "nearest",
    **fixed: Any,
) -> Callable[[Any], dict[str, jax.Array]]:
    """Return a function of JAX arrays that gives features of a periodic orbit, and that JAX can differentiate.

        f = vj.as_jax("vibro-impact", of=["impact_energy"], by=["beta", "gamma"], start="stuck", delta=0.005)
        f(jnp.array([0.4, 0.75]))  # {"impact_energy": ..., "margin": ..., "grazing_margin": ..., "valid": ...}
        jax.grad(lambda x: f(x)["impact_energy"])(jnp.array([0.4, 0.75]))

    At its first use, the function finds the orbit on which the motion from `start` settles. From then on it follows
    this orbit: at other parameters, the orbit is continued from the nearest one known. The gradients are those of
    [vibrojax.sensitivity][]: by the implicit function theorem at the orbit, through all events. `jax.grad`,
    `jax.jacfwd`, `jax.jacrev`, `jax.jit` and `jax.vmap` work, so do optimizers that use them. A batch of `jax.vmap` is
    computed at once. Second derivatives are not available.

    The function is valid as long as the orbit exists, has the same numbers of section crossings and impacts, and is
    stable. Beyond a graze, a fold or a border of the regime there is no such orbit: the result then belongs to the last
    orbit on the straight line from the first one. An orbit that has become unstable is continued, with a
    positive `margin`, so that stability can be a smooth constraint; it is not valid either.

    Orbits are computed in float64, whatever the type of the argument is. Results have the type of the argument, at
    least float32.

    **Arguments:**

    - `scene`, `start`, `fixed` (SI): as in `simulate`.
    - `of`: features of orbits, as in `sensitivity`; `by`: parameters, in the order of the array.
    - `outside`: "nearest" for the values and gradients of the nearest orbit where the function is not valid, or "nan".

    **Returns:** a function of an array (parameters,), which returns a dict of scalars: the features `of`, `margin`,
    `grazing_margin`, and the boolean `valid`. `margin` is the natural logarithm of the largest modulus of the
    multipliers, negative if stable, and `grazing_margin` the distance from a change in the order of events. Features
    are NaN if no motion from `start` is periodic at the first point or near it, or if the orbit does not have them
    (without impacts, an impact velocity).

    **Raises:** `InputError` for an unknown name or a wrong value.

    **Example:**

    >>> import jax, jax.numpy as jnp
    >>> f = vj.as_jax("vibro-impact", of="period", by=["beta", "gamma"], start="stuck", delta=0.005)
    >>> x = jnp.array([0.4, 0.75])
    >>> f"{f(x)['period']:.4f} s, {bool(f(x)['valid'])}"
    '0.2296 s, True'
    >>> " ".join(f"{slope:.3f}" for slope in jax.grad(lambda x: f(x)["period"])(x))
    '-0.027 -0.056'
    """
    place = Place("as_jax")
    if outside not in OUTSIDE:
        raise place.at("outside").error(f"{shown(outside)} is unknown; choose from {', '.join(OUTSIDE)}")
    point = read_point(place, scene, fixed, start)
    if not point.system.driving_part().return_states:
        raise place.at("scene").error(f"{shown(point.scene)} has neither a section nor pulses, so it has no orbits")
    names = read_names(place.at("of"), of, orbit_variables(point.system))
    parameters = read_names(place.at("by"), by, point.system.parameters())
    for name in parameters:
        if name in fixed:
            raise place.at(name).error("is in `by` as well; give it in one of the two")
    branch = Branch(point, names, parameters)
    outputs = {name: branch.of.index(name) for name in names}
    outputs |= {LOGARITHM: branch.of.index(STABILITY), MARGIN: branch.of.index(MARGIN)}
    features = _features(branch, len(parameters), outside)

    def f(x: Any) -> dict[str, jax.Array]:
        x = jnp.asarray(x)
        if x.shape != (len(parameters),):
            expected = f"({len(parameters)},), one number for each of {', '.join(parameters)}"
            raise InputError(f"as_jax: the array has the shape {x.shape}; give {expected}")
        dtype = jnp.result_type(float, x.dtype)
        results = features(x.astype(dtype if dtype.itemsize >= jnp.dtype(jnp.float32).itemsize else jnp.float32))
        values = {name: results[index] for name, index in outputs.items()}
        return values | {VALID: jax.lax.stop_gradient(results[-1]) > 0.5}

    return f


def _features(branch: Branch, size: int, outside: str) -> Callable[[jax.Array], jax.Array]:
    """Return the function from parameters to features (and, as the last number, 1 if valid), with its derivatives."""
    count = len(branch.of) + 1

    def compute(dtype: np.dtype, words: Any) -> tuple[np.ndarray, ...]:
        """Return features (..., features) and derivatives (..., features, by) at the points (..., by)."""
        x = np.ascontiguousarray(words).view(dtype)
        features = branch.evaluate(np.ascontiguousarray(x.reshape(-1, size), float))
        values = np.concatenate([features.values, features.valid[:, None]], axis=1)
        slopes = np.concatenate([features.derivatives, np.zeros((len(values), 1, size))], axis=1)
        if outside == "nan":
            values[~features.valid, :-1] = np.nan
            slopes[~features.valid, :-1] = np.nan
        both = values[..., None], slopes
        return tuple(part.astype(dtype).view(np.uint32).reshape(*x.shape[:-1], -1) for part in both)

    @jax.custom_jvp
    def both(x: jax.Array) -> Any:
        # A loop calls back from another thread. If x64 is enabled in this thread only, jax rounds doubles there; it
        # leaves words of 32 bits unchanged.
        dtype = np.dtype(x.dtype)
        words = dtype.itemsize // 4
        shapes = tuple(jax.ShapeDtypeStruct((number * words,), np.uint32) for number in (count, count * size))
        parts = jax.pure_callback(
            partial(compute, dtype),
            shapes,
            jax.lax.bitcast_convert_type(x, jnp.uint32).reshape(-1),
            vmap_method="broadcast_all",
        )
        shape = (words,) * (words > 1)
        values, slopes = (
            jax.lax.bitcast_convert_type(part.reshape(*outer, *shape), dtype)
            for part, outer in zip(parts, ((count,), (count, size)), strict=True)
        )
        return values, slopes

    @both.defjvp
    def _(primals: Any, tangents: Any) -> Any:
        raise InputError("as_jax: second derivatives are not available; use finite differences of the gradient")

    @jax.custom_jvp
    def features(x: jax.Array) -> jax.Array:
        return jnp.asarray(both(x)[0])

    @features.defjvp
    def _(primals: tuple[jax.Array], tangents: tuple[jax.Array]) -> tuple[jax.Array, jax.Array]:
        values, slopes = both(*primals)
        return values, slopes @ tangents[0]

    return features

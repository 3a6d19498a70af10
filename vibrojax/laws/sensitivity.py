"""Derivatives of the rate of penetration with respect to the parameters, through the located motion."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Float

from vibrojax.arrays import Array
from vibrojax.devices import precision
from vibrojax.engine.compiler import jitted
from vibrojax.errors import Place
from vibrojax.input.point import read_point
from vibrojax.measure import recorder_for
from vibrojax.measure.run import Effort, run_block
from vibrojax.scenes import Scene
from vibrojax.stepping import Accuracy, Located
from vibrojax.store.variables import Variable

WITH_RESPECT_TO = ("force", "threshold", "k3", "zeta")
NEARBY = 1e-4

_VALID = Variable(
    "1", "whether the derivative holds: the order of events does not change nearby", np.int8, ("not-valid", "valid")
)


class _Derivatives(NamedTuple):
    """Rate [m/s], how often the rock yields, derivatives, and how often with each parameter moved up and down."""

    rate: Float[Array, ""]
    yields: Float[Array, ""]
    derivative: Float[Array, " parameters"]
    nearby: Float[Array, "2 parameters"]


def rop_derivatives(
    wrt: Sequence[str] = WITH_RESPECT_TO, settle: float = 1.0, observe: float = 1.0, **parameters: object
) -> xr.Dataset:
    """Rate of penetration under given pulses, and its derivatives.

    The derivatives go through the events: where a switch is located, its time moves with the parameters (the root's
    implicit derivative), so they are those of the exact motion. They hold while the order of events stays as it is. As
    a check, every parameter is moved by one part in ten thousand either way: where the number of times that the rock
    yields changes, or there is no penetration at all, the derivative is not valid.

    **Arguments:**

    - `wrt`: names of parameters of the penetration scene.
    - `settle`, `observe` [s]: as in a sweep; whole pulses are observed.
    - `parameters`: any of the penetration scene's (SI), with `pulse_shape` and `rock`; the rest has its default.

    **Returns:** a dataset: rate_of_penetration [m/s], and along `parameter` the `value`, the `derivative`
    [m/s per unit of the parameter], the `elasticity` (relative change per relative change) and `valid` (0 or 1).

    **Raises:** `InputError` where a name or value is not right.
    """
    place = Place("rop_derivatives")
    if "scene" in parameters:
        raise place.at("scene").error("is always penetration here; leave it out")
    point = read_point(place, "penetration", parameters)
    for name in wrt:
        if name not in point.parameters:
            raise place.at("wrt").error(f"the scene has no {name}; choose from {', '.join(point.parameters)}")
    with precision("float64"):
        at = jnp.asarray([point.parameters[name] for name in wrt])
        fixed = {name: jnp.asarray(value) for name, value in point.parameters.items()}
        spans = {"settle": jnp.asarray(settle), "observe": jnp.asarray(observe)}
        run = _Derivatives(*map(np.asarray, _differentiated(point.system, tuple(wrt), fixed, spans, at)))
    rate, value = float(run.rate), np.asarray(at)
    valid = (run.nearby == run.yields).all(axis=0) & (rate > 0)
    elasticity = run.derivative * value / rate if rate > 0 else np.full(len(wrt), np.nan)
    return xr.Dataset(
        {
            "rate_of_penetration": ((), rate, {"units": "m s-1", "long_name": "rate of penetration"}),
            "value": ("parameter", value, {"long_name": "value of the parameter, in its own unit"}),
            "derivative": ("parameter", run.derivative, {"long_name": "derivative of the rate of penetration"}),
            "elasticity": ("parameter", elasticity, {"units": "1", "long_name": "relative sensitivity"}),
            "valid": ("parameter", valid.astype(np.int8), _VALID.attributes()),
        },
        {"parameter": list(wrt)},
    )


@jitted(static=("scene", "wrt"))
def _differentiated(
    scene: Scene,
    wrt: tuple[str, ...],
    fixed: Mapping[str, Float[Array, ""]],
    spans: Mapping[str, Array],
    at: Float[Array, " parameters"],
) -> _Derivatives:
    run = partial(_rate, scene, wrt, fixed, spans)
    rate, tangents = jax.vmap(lambda t: jax.jvp(run, (at,), (t,)), out_axes=(None, 0))(jnp.eye(len(wrt)))
    moved = at[None, None] * (1 + NEARBY * jnp.stack([jnp.eye(len(wrt)), -jnp.eye(len(wrt))]))
    nearby = jax.vmap(jax.vmap(run))(moved)[..., 1]
    return _Derivatives(rate[0], rate[1], tangents[:, 0], nearby)


def _rate(
    scene: Scene,
    wrt: tuple[str, ...],
    fixed: Mapping[str, Float[Array, ""]],
    spans: Mapping[str, Array],
    values: Float[Array, " parameters"],
) -> Float[Array, " 2"]:
    """Rate of penetration [m/s] and how often the rock yields, of one lane."""
    p = {name: value[None] for name, value in fixed.items()}
    p |= {name: values[index : index + 1] for index, name in enumerate(wrt)}
    c = scene.constants(p)
    effort = Effort(Accuracy(tolerance=1e-12, stride=1.0, step=jnp.inf), 1e7)
    state = scene.start(c, None, (1,))
    features = run_block(scene, Located(), recorder_for(scene), c, state, effort, **spans)
    return jnp.concatenate([features["rate_of_penetration"], features["yields"]])

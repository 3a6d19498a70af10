"""Derivatives of the rate of penetration with respect to the parameters, through the located motion."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr

from vibrojax.devices import precision
from vibrojax.errors import Place
from vibrojax.measure import recorder_for
from vibrojax.measure.run import run_block
from vibrojax.stepping import Located
from vibrojax.sweep import read_point

WITH_RESPECT_TO = ("force", "threshold", "k3", "zeta")
NEARBY = 1e-4


def rop_derivatives(
    wrt: tuple[str, ...] = WITH_RESPECT_TO, settle: float = 1.0, observe: float = 1.0, **parameters
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
    point = read_point(place, "penetration", parameters)
    for name in wrt:
        if name not in point.parameters:
            raise place.at("wrt").error(f"the scene has no {name}; choose from {', '.join(point.parameters)}")
    with precision("float64"):
        at = jnp.asarray([point.parameters[name] for name in wrt])
        fixed = {name: jnp.asarray(value) for name, value in point.parameters.items()}
        spans = {"settle": jnp.asarray(settle), "observe": jnp.asarray(observe)}
        rate, yields, derivative, nearby = (
            np.asarray(x) for x in _differentiated(point.machine, tuple(wrt), fixed, spans, at)
        )
    rate, at = float(rate), np.asarray(at)
    valid = (nearby == yields).all(axis=0) & (rate > 0)
    elasticity = derivative * at / rate if rate > 0 else np.full(len(wrt), np.nan)
    about = {"units": "1", "long_name": "whether the derivative holds: the order of events does not change nearby"}
    flags = {"flag_values": np.array([0, 1], np.int8), "flag_meanings": "not-valid valid"}
    return xr.Dataset(
        {
            "rate_of_penetration": ((), rate, {"units": "m s-1", "long_name": "rate of penetration"}),
            "value": ("parameter", at, {"long_name": "value of the parameter, in its own unit"}),
            "derivative": ("parameter", derivative, {"long_name": "derivative of the rate of penetration"}),
            "elasticity": ("parameter", elasticity, {"units": "1", "long_name": "relative sensitivity"}),
            "valid": ("parameter", valid.astype(np.int8), about | flags),
        },
        {"parameter": list(wrt)},
    )


@partial(jax.jit, static_argnames=("scene", "wrt"))
def _differentiated(scene, wrt, fixed, spans, at):
    """Rate, number of yields, derivative (parameters,), and yields with each parameter moved up and down."""
    run = partial(_rate, scene, wrt, fixed, spans)
    rate, tangents = jax.vmap(lambda t: jax.jvp(run, (at,), (t,)), out_axes=(None, 0))(jnp.eye(len(wrt)))
    moved = at[None, None] * (1 + NEARBY * jnp.stack([jnp.eye(len(wrt)), -jnp.eye(len(wrt))]))
    nearby = jax.vmap(jax.vmap(run))(moved)[..., 1]
    return rate[0], rate[1], tangents[:, 0], nearby


def _rate(scene, wrt, fixed, spans, values):
    """Rate of penetration [m/s] and number of yields, of one lane, as an array (2,)."""
    p = {name: value[None] for name, value in fixed.items()}
    p |= {name: values[index : index + 1] for index, name in enumerate(wrt)}
    p = dict(scene.constants(p))
    settings = {"stride": 1.0, "tolerance": 1e-12, "step": jnp.inf, "most_steps": 1e7} | spans
    found = run_block(scene, Located(), recorder_for(scene), p, scene.start(p, None, (1,)), settings)
    return jnp.concatenate([found["rate_of_penetration"], found["yields"]])

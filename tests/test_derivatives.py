"""Derivatives through the events, against central differences of the same converged, located motion.

Finite differences of a fixed-step motion would not do: it loses the derivative of the impact time, and so agree with a
wrong derivative. Here an event's time is located, so that what is differenced is the exact motion to 1e-11.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from vibrojax.errors import InputError
from vibrojax.laws.sensitivity import rop_derivatives
from vibrojax.measure import recorder_for
from vibrojax.measure.run import Effort, run_block
from vibrojax.scenes import SCENES
from vibrojax.stepping import Accuracy, Located

EXACT = Effort(Accuracy(tolerance=1e-12, stride=1.0, step=1e9), 1e6)


def features(scene, wrt, names, settle, observe):
    """A function of the parameters `wrt` that gives the features called `names` of one lane."""
    defaults = {name: parameter.default for name, parameter in scene.parameters().items()}

    def found(values):
        p = {name: jnp.full(1, value) for name, value in defaults.items()}
        p |= {name: values[index : index + 1] for index, name in enumerate(wrt)}
        p = scene.constants(p)
        start = scene.start(p, "drive", (1,))
        read = run_block(scene, Located(), recorder_for(scene), p, start, EXACT, settle, observe)
        return jnp.concatenate([read[name] for name in names])

    return found, jnp.asarray([defaults[name] for name in wrt])


def central(function, at, share=1e-5):
    """Central differences, (outputs, inputs)."""
    steps = share * jnp.diag(at)
    columns = [
        (function(at + step) - function(at - step)) / (2 * share * value) for step, value in zip(steps, at, strict=True)
    ]
    return jnp.stack(columns, axis=1)


def test_period_and_impact_velocity_of_the_drill():
    # 70 stick-slip cycles with as many impacts, at the defaults: a stable single impact.
    run, at = features(
        SCENES["vibro-impact"](), ("beta", "gamma", "v", "mu"), ("period", "impact_velocity"), settle=14.0, observe=2.0
    )
    run = jax.jit(run)
    found = jax.jit(jax.jacfwd(run))(at)
    np.testing.assert_allclose(found, central(run, at), rtol=1e-6)


SHORT = {"settle": 0.3, "observe": 0.2, "zeta": 0.6}


def test_rate_of_penetration():
    given = SHORT | {"force": 250e3}
    found = rop_derivatives(**given)
    assert found.valid.values.tolist() == [1, 1, 1, 1]
    for name in found.parameter.values:
        value, derivative = float(found.value.sel(parameter=name)), float(found.derivative.sel(parameter=name))
        step = 1e-5 * value
        up, down = (
            float(rop_derivatives(**given | {str(name): value + sign * step}).rate_of_penetration) for sign in (1, -1)
        )
        assert derivative == pytest.approx((up - down) / (2 * step), rel=1e-5), name


def test_derivatives_say_where_they_do_not_hold():
    # Far below the threshold nothing yields; at the force whose peak just reaches D the count of yields changes.
    assert not rop_derivatives(force=50e3, **SHORT).valid.any()
    low, high = 50e3, 250e3
    for _ in range(30):
        middle = (low + high) / 2
        yields = float(rop_derivatives(force=middle, **SHORT).rate_of_penetration) > 0
        low, high = (low, middle) if yields else (middle, high)
    assert not rop_derivatives(force=high, **SHORT).valid.any()


def test_an_unknown_parameter_is_refused():
    with pytest.raises(InputError, match="the scene has no beta"):
        rop_derivatives(wrt=("beta",))

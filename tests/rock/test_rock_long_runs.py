"""Test that the hundred-thousandth blow is as exact as the first, also in float32: no state holds the depth."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from rock_motion import FINE, constants

import vibrojax as vj
from vibrojax.compile.native import Kernel
from vibrojax.compile.xla import precision
from vibrojax.scenes.penetration import Penetration
from vibrojax.stepping import Accuracy, Goal, Located, lane_at

SCENE, STEPPER = Penetration(), Located()
FAST = {"threshold": 150e3, "k3": 20e9, "pulse_width": 3e-4, "zeta": 0.9}
"""A thousand blows per second on a very stiff rock, each a few tens of steps long."""


def run_steps(p, lane, settings, end):
    """Run a thousand steps. Return the lane, and of each step dt, the states after it, and whether a pulse begins."""

    def take_step(lane, _):
        new, step = STEPPER.step(SCENE, p, lane, settings, Goal(end, lane.clock.until(end) > 0))
        return new, (step.dt, jnp.stack(step.after), SCENE.pulse_begins(p, step.mode, step.hits))

    return jax.lax.scan(take_step, lane, length=1000)


def run_default_lane(name, began):
    """Return the steps of the default lane from `began` [s], in float64 or float32, as numpy arrays."""
    with precision(name):
        p = constants(SCENE, zeta=0.6)
        assert p.rock.k3.dtype == name
        tolerance = 1e-9 if name == "float64" else 3e-6
        settings = Accuracy(*(jnp.asarray(value, name) for value in FINE._replace(tolerance=tolerance)))
        lane = lane_at(SCENE, p, SCENE.start(p, None, (1,)))
        lane = lane._replace(clock=lane.clock._replace(high=jnp.full(1, began, name)))
        arguments = p, lane, settings, jnp.asarray(began + 1000.0, name)
        lane, steps = Kernel(run_steps, *arguments)(*arguments)
        clock = np.float64(lane.clock.high[0]) + np.float64(lane.clock.low[0])
        return *(values[..., 0] for values in steps), clock


@pytest.mark.parametrize("name", ["float64", "float32"])
def test_blows_repeat_exactly(name):
    """From the third blow on, each blow takes the same steps as the one before, to the last bit.

    In float32 the slip agrees with float64 to 1e-6.
    """
    _, after, begins, _ = run_default_lane(name, 0.0)
    starts = np.flatnonzero(begins) + 1
    blows = [after[a:b] for a, b in zip(starts[:-1], starts[1:], strict=True)][2:]  # noqa: RUF007
    assert len(blows) >= 2
    for blow in blows:
        np.testing.assert_array_equal(blow, blows[0])
    exact = run_default_lane("float64", 0.0)
    exact_starts = np.flatnonzero(exact[2]) + 1
    slip = exact[1][exact_starts[1] : exact_starts[2], 2].max()
    assert blows[0][:, 2].max() == pytest.approx(slip, rel=1e-14 if name == "float64" else 2e-6)


def sweep(name, settle, observe):
    run = {"settle": settle, "observe": observe, "precision": name}
    grid = {"force": [200e3, 300e3], "frequency": [1000.0]}
    return vj.run_sweep({"scene": "penetration", "parameters": FAST, "grid": grid, "run": run}, progress=False)


@pytest.mark.parametrize(("name", "blows", "rtol"), [("float64", 4_000, 1e-12), ("float32", 20_000, 1e-6)])
def test_thousands_of_blows(name, blows, rtol):
    """The slip of forty blows after many blows agrees with that of blows 201 to 240."""
    early, late = sweep(name, 0.2, 0.0405), sweep(name, blows / 1000, 0.0405)
    assert np.all(early.slip_per_impact > 1e-7)
    np.testing.assert_allclose(late.slip_per_impact, early.slip_per_impact, rtol=rtol)

"""The hundred-thousandth blow is as exact as the first: the hole's depth is no part of the state, in float32 too."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from rock_motion import FINE, constants

import vibrojax as vj
from vibrojax.compile.kernels import Kernel
from vibrojax.compile.xla import precision
from vibrojax.models.scenes.penetration import Penetration
from vibrojax.stepping import Accuracy, Goal, Located, lane_at

SCENE, STEPPER = Penetration(), Located()
BLOWS = 100_000
FAST = {"threshold": 150e3, "k3": 20e9, "pulse_width": 3e-4, "zeta": 0.9}
"""A thousand blows a second on a very stiff rock, each over in a few tens of steps."""


def _walk(p, lane, settings, end):
    """A thousand steps: (dt, states after each, pulse begins), and the lane after them."""

    def one(lane, _):
        new, step = STEPPER.step(SCENE, p, lane, settings, Goal(end, lane.clock.until(end) > 0))
        return new, (step.dt, jnp.stack(step.after), SCENE.pulse_begins(p, step.mode, step.hits))

    return jax.lax.scan(one, lane, length=1000)


def walk(name, began):
    """Steps of the default lane from `began` [s] on, in float64 or float32; numpy arrays."""
    with precision(name):
        p = constants(SCENE, zeta=0.6)
        assert p.rock.k3.dtype == name
        tolerance = 1e-9 if name == "float64" else 3e-6
        settings = Accuracy(*(jnp.asarray(value, name) for value in FINE._replace(tolerance=tolerance)))
        lane = lane_at(SCENE, p, SCENE.start(p, None, (1,)))
        lane = lane._replace(clock=lane.clock._replace(high=jnp.full(1, began, name)))
        arguments = p, lane, settings, jnp.asarray(began + 1000.0, name)
        lane, steps = Kernel(_walk, *arguments)(*arguments)
        clock = np.float64(lane.clock.high[0]) + np.float64(lane.clock.low[0])
        return *(one[..., 0] for one in steps), clock


@pytest.mark.parametrize("name", ["float64", "float32"])
def test_steps_do_not_depend_on_when(name):
    """Begun at t = 0 or at the hundred-thousandth blow (5000 s), a train of blows takes bit for bit the same steps: the
    state counts from the last pulse, and time enters by the clock alone, which loses nothing either."""
    first = walk(name, 0.0)
    late = walk(name, BLOWS / 20.0)
    assert first[2].sum() >= 5
    for one, other in zip(first[:3], late[:3], strict=True):
        np.testing.assert_array_equal(one, other)
    total = np.sum(first[0], dtype=np.float64)
    assert first[3] == pytest.approx(total, rel=1e-12 if name == "float64" else 1e-6)
    assert late[3] - BLOWS / 20.0 == pytest.approx(total, rel=1e-12 if name == "float64" else 1e-6)


@pytest.mark.parametrize("name", ["float64", "float32"])
def test_blows_repeat_bit_for_bit(name):
    """From the third blow on, each takes the same steps as the one before, to the last bit: with the test above, all
    that follow do. In float32 the slip is that of float64 to 1e-6."""
    _, after, begins, _ = walk(name, 0.0)
    starts = np.flatnonzero(begins) + 1
    blows = [after[a:b] for a, b in zip(starts[:-1], starts[1:], strict=True)][2:]  # noqa: RUF007
    assert len(blows) >= 2
    for blow in blows:
        np.testing.assert_array_equal(blow, blows[0])
    exact = walk("float64", 0.0)
    exact_starts = np.flatnonzero(exact[2]) + 1
    slip = exact[1][exact_starts[1] : exact_starts[2], 2].max()
    assert blows[0][:, 2].max() == pytest.approx(slip, rel=1e-14 if name == "float64" else 2e-6)


def sweep(name, settle, observe):
    run = {"settle": settle, "observe": observe, "precision": name}
    grid = {"force": [200e3, 300e3], "frequency": [1000.0]}
    return vj.run_sweep({"scene": "penetration", "parameters": FAST, "grid": grid, "run": run}, progress=False)


@pytest.mark.parametrize(("name", "blows", "rtol"), [("float64", 4_000, 1e-12), ("float32", 20_000, 1e-6)])
def test_thousands_of_blows(name, blows, rtol):
    """The slip of the forty blows after so many is that of blows 201 to 240."""
    early, late = sweep(name, 0.2, 0.0405), sweep(name, blows / 1000, 0.0405)
    assert np.all(early.slip_per_impact > 1e-7)
    np.testing.assert_allclose(late.slip_per_impact, early.slip_per_impact, rtol=rtol)


def test_means_over_many_blows_in_float32():
    """ROP, P and slip over 5,000 blows: a float32's few roundings, however many blows they are over."""
    dataset, exact = sweep("float32", 0.2, 5.0), sweep("float64", 0.2, 0.2)
    for name in ("slip_per_impact", "mean_force", "rate_of_penetration"):
        np.testing.assert_allclose(dataset[name], exact[name], rtol=1e-5)

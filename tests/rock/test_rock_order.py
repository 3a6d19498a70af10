"""Test the order of convergence of the located stepper on rock."""

import numpy as np
import pytest
from rock_motion import Motion

BLOW = {"zeta": 0.6, "force": 250e3, "frequency": 40.0}
"""Two pulses of 4 ms with every switch: the rock yields and stops yielding (x3' = 0), the pulse ends, the bit leaves
the rock, and the next pulse brings it back.
"""
UNTIL = 0.045
STRIDES = np.array([0.4, 0.28, 0.2, 0.14])


def end_state(order, stride, shape):
    """Return (x3 - x4, x3', x4) after the blows, with an infinite tolerance so that the series alone sets the error."""
    from vibrojax.stepping import Located

    settings = {"tolerance": 1e30, "stride": stride}
    motion = Motion(UNTIL, shape, method=Located(order), settings=settings, **BLOW)
    return np.array([motion.after("compression")[-1], motion.after("v3")[-1], motion.x4[-1]]), motion


def fitted_order(steps, errors):
    return np.polyfit(np.log(steps), np.log(errors), 1)[0]


@pytest.fixture(scope="module", params=["rectangular", "half-sine"])
def exact(request):
    state, motion = end_state(8, 0.1, request.param)
    return request.param, state, motion


def test_blows_contain_every_switch(exact):
    _, state, motion = exact
    yields, touches, pulse, turn = motion.steps.hits.T
    assert set(motion.rock) == {-1, 0, 1}
    assert yields.sum() >= 2
    assert touches.sum() >= 2
    assert pulse.sum() == 3
    assert turn.any()
    assert state[2] > 1e-4


@pytest.mark.parametrize("order", [3, 4, 5])
def test_order_of_located_steps(exact, order):
    """|y(h) - y| = C h^order through all switches, for the hole as for the motion."""
    shape, state, _ = exact
    errors = np.array([np.abs(end_state(order, stride, shape)[0] - state) for stride in STRIDES])
    depth = errors[:, 2] / state[2]
    motion = np.max(errors[:, :2] / [1e-4, 0.1], axis=1)
    assert fitted_order(STRIDES, depth) > order - 0.4, depth
    assert fitted_order(STRIDES, motion) > order - 0.4, motion

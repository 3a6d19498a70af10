"""The order of the located stepper on the rock, and that it is lost where the kinks of N are not located."""

import numpy as np
import pytest
from rock_motion import Motion

BLOW = {"zeta": 0.6, "force": 250e3, "frequency": 40.0}
"""Two pulses of 4 ms: the rock yields, stops yielding (x3' = 0), the pulse ends, the bit leaves the rock, the next
pulse brings it back: every switch there is."""
UNTIL = 0.045
STRIDES = np.array([0.4, 0.28, 0.2, 0.14])


def end(order, stride, shape):
    """(x3 - x4, x3', x4) at the end of the blows, the series alone setting the error (tolerance infinite)."""
    from vibrojax.stepping import Located

    settings = {"tolerance": 1e30, "stride": stride}
    motion = Motion(UNTIL, shape, method=Located(order), settings=settings, **BLOW)
    return np.array([motion.after("compression")[-1], motion.after("v3")[-1], motion.x4[-1]]), motion


def plain(steps, shape, p):
    """The same by Runge and Kutta's fourth order at a fixed step, with eqs. 6.2 and 6.3 as they stand.

    N = clip(k3 (x3 - x4), 0, D); x4 the running maximum of x3 - D/k3 at the ends of steps."""
    h = UNTIL / steps

    def pulse(t):
        since = t % (1 / p["frequency"])
        height = np.sin(np.pi * since / p["pulse_width"]) if shape == "half-sine" else 1.0
        return p["force"] * height if since < p["pulse_width"] else 0.0

    def rates(t, x3, v3, x4):
        resistance = np.clip(p["k3"] * (x3 - x4), 0, p["threshold"])
        return v3, (pulse(t) - p["c3"] * v3 - resistance) / p["m1"]

    x3 = v3 = x4 = 0.0
    for i in range(steps):
        t = i * h
        a = rates(t, x3, v3, x4)
        b = rates(t + h / 2, x3 + h / 2 * a[0], v3 + h / 2 * a[1], x4)
        c = rates(t + h / 2, x3 + h / 2 * b[0], v3 + h / 2 * b[1], x4)
        d = rates(t + h, x3 + h * c[0], v3 + h * c[1], x4)
        x3 += h / 6 * (a[0] + 2 * b[0] + 2 * c[0] + d[0])
        v3 += h / 6 * (a[1] + 2 * b[1] + 2 * c[1] + d[1])
        x4 = max(x4, x3 - p["threshold"] / p["k3"])
    return np.array([x3 - x4, v3, x4])


def fitted(steps, errors):
    return np.polyfit(np.log(steps), np.log(errors), 1)[0]


@pytest.fixture(scope="module", params=["rectangular", "half-sine"])
def exact(request):
    state, motion = end(8, 0.1, request.param)
    return request.param, state, motion


def test_the_blows_have_every_switch(exact):
    _, state, motion = exact
    yields, touches, pulse, turn = motion.steps.hits.T
    assert set(motion.rock) == {-1, 0, 1}
    assert yields.sum() >= 2
    assert touches.sum() >= 2
    assert pulse.sum() == 3
    assert turn.any()
    assert state[2] > 1e-4


@pytest.mark.parametrize("order", [3, 4, 5])
def test_order_of_the_located_steps(exact, order):
    """|y(h) - y| = C h^order through all switches, for the hole and the motion alike."""
    shape, state, _ = exact
    errors = np.array([np.abs(end(order, stride, shape)[0] - state) for stride in STRIDES])
    depth = errors[:, 2] / state[2]
    motion = np.max(errors[:, :2] / [1e-4, 0.1], axis=1)
    assert fitted(STRIDES, depth) > order - 0.4, depth
    assert fitted(STRIDES, motion) > order - 0.4, motion


def test_order_is_lost_without_location(exact):
    """Runge-Kutta 4 that steps over the kinks keeps second order at best, though its own is four; same answer.

    Where the kinks fall in a step is chance, so errors are the greatest of seven runs of nearly one step."""
    shape, state, motion = exact

    def error(n):
        runs = [plain(n + 7 * k, shape, motion.p)[2] for k in range(7)]
        return np.max(np.abs(runs - state[2])) / state[2]

    steps = np.array([450, 900, 1800])
    errors = np.array([error(n) for n in steps])
    assert 0.5 < -fitted(steps, errors) < 2.5, errors
    assert errors[-1] < 1e-2

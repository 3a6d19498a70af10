"""The smoothed stepper: classical Runge-Kutta steps of one length, friction's switch spread over a stated width.

The friction switch sgn u becomes u/sqrt(u² + width²); nothing sticks, a bit at rest creeps. The contact is sharp: steps
land on its beginning and end, as on the section, found on the cubic Hermite interpolant of the step.
"""

from dataclasses import dataclass

import jax.numpy as jnp
from jax import lax

from vibrojax.stepping._landing import land
from vibrojax.stepping._step import Lane, Step, taken, trial_step
from vibrojax.stepping.series import known

STICK_WIDTHS = 3.0
"""Sliding speeds below this many widths are counted as stick: friction has 95 % of its sharp value there."""


def runge_kutta(rates, state, h):
    """State a time `h` [s] later by the classical fourth-order Runge-Kutta method, and the rates where it starts."""

    def moved(k, share):
        return tuple(y + share * h * dy for y, dy in zip(state, k, strict=True))

    k1 = rates(state)
    k2 = rates(moved(k1, 0.5))
    k3 = rates(moved(k2, 0.5))
    k4 = rates(moved(k3, 1.0))
    mean = tuple((a + 2 * b + 2 * c + d) / 6 for a, b, c, d in zip(k1, k2, k3, k4, strict=True))
    return moved(mean, 1.0), k1


def hermite(start, end, rate, end_rate):
    """Coefficients in tau of the cubic through two values with two rates per step."""
    change = end - start
    return [start, rate, 3 * change - 2 * rate - end_rate, rate + end_rate - 2 * change]


@dataclass(frozen=True)
class Smoothed:
    """The smoothed stepper; it has no static settings."""

    def step(self, scene, p, lane: Lane, settings, end, moving, marked=True) -> tuple[Lane, Step]:
        """One step of every lane.

        **Arguments:**

        - `settings`: `step` [s], `smoothing` [m/s], and `stride`, the longest step in units of 1/rate of the mode.
          Arrays or floats: changing them compiles nothing.
        - `end`: time [s] at which lanes stop.
        - `moving`: booleans (lanes,); the others stand still.
        - `marked`: whether it also ends on markers (static).

        **Returns:** the lane after it, and the step.
        """
        width = settings["smoothing"]
        mode = scene.smoothed_mode(p, lane.mode, lane.state, STICK_WIDTHS * width)
        lane = lane._replace(mode=mode)
        # A stiff contact asks for shorter steps than the user's.
        h = trial_step(lane, settings["stride"] / scene.rate(p, mode), settings["step"], end, moving)

        def rates_at(state):
            return scene.smoothed_field(p, mode, state, width)

        after, rates = runge_kutta(rates_at, lane.state, h)
        ends = zip(lane.state, after, rates, rates_at(after), strict=True)
        polynomials = tuple(hermite(y, z, h * dy, h * dz) for y, z, dy, dz in ends)

        def functions_at(state):
            return (*scene.smoothed_surfaces(p, mode, state), *(scene.markers(p, state) if marked else ()))

        series = functions_at(tuple(known(one) for one in polynomials))
        functions = [[f.array(k, h) for k in range(4)] for f in series]
        reach = jnp.ones_like(h)
        landing = land(functions_at, scene, p, lane.mode, polynomials, functions, h, reach, moving)
        return taken(scene, p, lane, polynomials, h, landing)


def smoothed_trajectory(scene, p, state, h, steps: int, width):
    """States of a smoothed motion at h, 2 h, ..., in plain fixed steps: differentiable in all its arguments.

    The contact acts where the striker is beyond the gap at each stage, and is not landed on, so that the steps stay
    where they are; an impact costs some of the order (and the derivative of its time: see the tests).

    **Arguments:**

    - `p`: the scene's constants; `state`: tuple of arrays of one shape; `h` [s]; `width` [m/s]: of the friction switch.
    - `steps`: number of steps (static).

    **Returns:** tuple of arrays (steps, *shape), one per state.
    """

    def rates(y):
        return scene.smoothed_field(p, scene.mode_at(p, y), y, width)

    def one(y, _):
        after, _ = runge_kutta(rates, y, h)
        return after, after

    return lax.scan(one, state, length=steps)[1]

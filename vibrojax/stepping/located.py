"""The located stepper: Taylor steps within a mode that end on the guard that is reached, found on their polynomial.

Each lane has its own clock and step. The solution of a mode's equations is expanded in a Taylor series
([vibrojax.stepping.series][]); the first guard that the polynomial crosses ends the step exactly there, the state is
put on the guard and the mode changes. Steps are fixed fractions of the mode's own time scale, shortened where the last
coefficients say that the series has not converged (Jorba and Zou 2005, section 3).
"""

from dataclasses import dataclass
from functools import reduce
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax

from vibrojax.models.arrays import Array, Lanes, Real, keep
from vibrojax.models.scenes.scene import Scene
from vibrojax.stepping.event import Event, Trial, locate
from vibrojax.stepping.lane import Lane, Step
from vibrojax.stepping.polynomial import rough_root
from vibrojax.stepping.series import Series, expand
from vibrojax.stepping.stepper import Accuracy, Goal, Stepper, Wanted, taken, trial_length

COARSEST = 1e-6
"""Tolerance beyond which little is gained, because most steps end at events, and from which on the difference from a
coarser run tells of the error."""

COARSEST_DRIVEN = 1e-8
"""The same where pulses drive: nearly all steps end with them, and are the same at any tolerance above."""

LOCATED_STRIDE = 2.0
"""Longest step in units of 1/rate: in it no guard is touched and left twice."""


@dataclass(frozen=True)
class Located(Stepper):
    """The located stepper; `order` of the Taylor series. It takes `stride`, `tolerance` and the longest `step`.

    **Example:**

    >>> method = vj.Located(order=14)
    >>> motion = vj.simulate("vibro-impact", method=method, gamma=0.75, delta=0.005, start="stuck", progress=False)
    >>> round(float(motion.period), 4)
    0.2296
    """

    order: int = 10

    name = "located"
    coarser_by = 10.0
    # Order 10/9 in the tolerance would leave 10^(-10/9) = 0.08; large enough for 95 % of periodic lanes to be within.
    error_share = 0.4
    rests = True

    @property
    def degree(self) -> int:
        return self.order

    def accuracy(self, wanted: Wanted, scene: Scene[Any]) -> Accuracy:
        rounding = 1e-12 if wanted.precision == "float64" else 3e-6
        # Errors of period and impact velocity are below the tolerance, but a hundred times it on hard lanes.
        tolerance = max(min(1e-3 * wanted.error, COARSEST if scene.autonomous else COARSEST_DRIVEN), rounding)
        return Accuracy(tolerance, LOCATED_STRIDE, wanted.step if wanted.step is not None else float("inf"))

    def coarser(self, accuracy: Accuracy) -> Accuracy:
        return accuracy._replace(tolerance=accuracy.tolerance * self.coarser_by)

    def step(
        self, scene: Scene[Any], constants: Any, lane: Lane, accuracy: Accuracy, goal: Goal, marked: bool = True
    ) -> tuple[Lane, Step]:
        h = trial_length(lane, accuracy.stride / scene.rate(constants, lane.mode), accuracy.step, goal)
        series = expand(lambda y: scene.field(constants, lane.mode, y), lane.state, h, self.order)
        polynomials = tuple(_coefficients(one, self.order, h) for one in series)
        event = Event(scene, constants, lane.mode, marked)
        functions = [_coefficients(one, self.order, h) for one in event.functions(series)]
        velocities = [polynomials[i] for i in scene.velocities]
        speed = scene.speed_scale(constants)
        rest = keep(_at_rest(velocities, speed)) if scene.autonomous else jnp.zeros_like(goal.moving)
        reach = jnp.where(rest, 1.0, _converged(velocities, speed, accuracy.tolerance))
        validity = scene.validity(constants, lane.mode, polynomials)
        reach = keep(lax.stop_gradient(reach if validity is None else jnp.minimum(reach, validity)))
        trial = Trial(polynomials, functions, h, reach, goal.moving & ~rest)
        landing = locate(event, trial)
        h = jnp.where(goal.moving & rest, lane.clock.until(goal.end), h)
        return taken(event, lane, trial, h, landing)


def _coefficients(series: Series, order: int, like: Lanes) -> list[Array]:
    return [series.array(k, like) for k in range(order + 1)]


def _converged(velocities: list[list[Array]], scale: Array, tolerance: Real) -> jax.Array:
    """The part of the step, at most 1, over which the last two terms of the series stay under tolerance scale."""
    order = len(velocities[0]) - 1
    last = reduce(jnp.maximum, [jnp.abs(c) for series in velocities for c in series[-2:]])
    return jnp.minimum(rough_root(tolerance * scale / last, order - 1), 1.0)


def _at_rest(velocities: list[list[Array]], scale: Array) -> jax.Array:
    """Where nothing moves but by rounding: the rest of the run is one step, however stiff the contact it rests on."""
    noise = 512 * jnp.finfo(scale.dtype).eps
    return reduce(jnp.maximum, [jnp.abs(c) for series in velocities for c in series]) <= noise * scale

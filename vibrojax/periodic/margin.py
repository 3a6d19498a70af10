"""Grazing margin: a dimensionless distance of an orbit from a change in its order of events, zero at a graze.

Guards are functions that are positive within a mode. Where a guard reaches zero, its slope counts, relative to a
typical slope. Where a guard has a minimum above zero within a step, that minimum counts, relative to a typical value.
At a switch, the values with which the new mode begins count too: they vanish where a stick phase appears or vanishes.
The section's velocity counts as a guard while its next zero is a return.
"""

from dataclasses import dataclass
from functools import reduce
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax

from vibrojax.models.arrays import Array, Flags, Lanes
from vibrojax.models.scenes.declared import Section
from vibrojax.models.scenes.scene import ROUNDINGS, Scene
from vibrojax.stepping import Lane, Step
from vibrojax.stepping.polynomial import Coefficients, slope, value
from vibrojax.stepping.series import known

HOW = (
    "the least over the orbit of: |rate of a guard| where it is reached, over (its typical value times the rate of the "
    "free motion); a guard's least value within a mode where it is not, over its typical value; what a switch begins a "
    "mode with, over its typical value; the same of the section's velocity"
)
"""Definition of the margin for dataset attributes."""

GRAZING = 1e-5
"""Margin below which no multipliers are given. Near a graze the map has a square-root singularity, so its derivative
holds over a distance of about the margin squared: here the accepted residual, 1e-10."""


@dataclass(frozen=True)
class Margin:
    """The margin of a motion of `scene` with the constants `c`, accumulated step by step."""

    scene: Scene[Any]
    section: Section | None
    c: Any

    def after(self, least: Lanes, armed: Flags, lane: Lane, step: Step) -> Lanes:
        """Return the minimum of `least` and of the margins within `step`, which led to `lane`; without derivatives."""
        lane, step = lax.stop_gradient((lane, step))
        states = tuple(known(polynomial) for polynomial in step.polynomials)
        functions = self.scene.guard_values(self.c, step.mode, states)
        scales = _typical(self.scene.resolutions(self.c, step.mode, marked=False))
        # The fastest rate of the free motion [1/s].
        pace = self.scene.rate(self.c, tuple(jnp.full_like(step.dt, mode.calmest) for mode in self.scene.modes))
        margins = [least]
        for name, function, scale in zip(self.scene.guard_names, functions, scales, strict=True):
            f = [function.array(k, step.dt) for k in range(len(step.polynomials[0]))]
            margins += [_at_hit(f, step, step.hits[name], scale * pace), _near_miss(f, step, scale)]
        return reduce(jnp.minimum, [*margins, *self._of_section(armed, step, pace), *self._at_switches(lane, step)])

    def _of_section(self, armed: Flags, step: Step, pace: Lanes) -> list[Array]:
        section = self.section
        if section is None:
            return []
        velocity = step.polynomials[self.scene.place(section.velocity)]
        speed = self.scene.speed_scale(self.c)
        hit = step.hits[self.scene.marker_of(section.velocity)]
        away = [-coefficient for coefficient in velocity] if section.rising else velocity
        near = jnp.where(armed, _near_miss(away, step, speed), jnp.inf)
        return [_at_hit(velocity, step, hit & armed, speed * pace), near]

    def _at_switches(self, lane: Lane, step: Step) -> list[Array]:
        """Return the non-zero guard values with which switches begin a mode, relative to typical values."""
        values = self.scene.guard_values(self.c, lane.mode, lane.state)
        small = self.scene.resolutions(self.c, lane.mode, marked=False)
        return [
            jnp.where(step.hits[guard.name] & (g > zero), g / scale, jnp.inf)
            for guard, g, zero, scale in zip(self.scene.guards(), values, small, _typical(small), strict=True)
            if guard.is_switch
        ]


def _typical(resolutions: tuple[Any, ...]) -> list[Array]:
    """Return typical values of functions, from the values below which these count as zero."""
    return [resolution / (ROUNDINGS * jnp.finfo(resolution.dtype).eps) for resolution in resolutions]


def _at_hit(f: Coefficients, step: Step, hit: Flags, rate: Array) -> jax.Array:
    """Return the slope at the end of a step that ends on the guard, relative to a typical `rate`."""
    return jnp.where(hit, jnp.abs(slope(f, step.tau)) / (step.h * rate), jnp.inf)


def _near_miss(f: Coefficients, step: Step, scale: Array) -> jax.Array:
    """Return the positive minimum of a function within the step over its `scale`; infinite without one."""
    rate = [k * coefficient for k, coefficient in enumerate(f)][1:]
    start, end = rate[0], value(rate, step.tau)
    turns = (start < 0) & (end > 0)
    place = jnp.where(turns, step.tau * start / jnp.where(turns, start - end, 1), 0)
    for _ in range(2):
        better = place - value(rate, place) / slope(rate, place)
        place = jnp.where(turns & (better > 0) & (better < step.tau), better, place)
    least = value(f, place)
    return jnp.where(turns & (least > 0), least / scale, jnp.inf)

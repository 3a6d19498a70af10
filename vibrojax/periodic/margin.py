"""Grazing margin: a dimensionless distance of an orbit from a change in its order of events, zero at grazing.

Guards are functions that are positive within a mode. The margin is the smallest of these quantities over the orbit:

- where a guard reaches zero: its slope, relative to a typical slope;
- where a guard has a positive minimum within a step: that minimum, relative to a typical value;
- at a switch: the guard values with which the new mode begins, relative to typical values. These values vanish where a
  stick phase appears or vanishes.

The section's velocity also counts as a guard while its next zero is a section crossing.
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
"""Definition of the margin, for dataset attributes."""

GRAZING = 1e-5
"""Margin below which no multipliers are reported. Near grazing the map has a square-root singularity, so its derivative
is valid over a distance of about the squared margin. At this limit that distance is 1e-10, the accepted residual."""


@dataclass(frozen=True)
class Margin:
    """Grazing margin of a motion of `scene` with the constants `c`, accumulated step by step."""

    scene: Scene[Any]
    section: Section | None
    c: Any

    def after(self, least: Lanes, armed: Flags, lane: Lane, step: Step) -> Lanes:
        """Return the minimum of `least` and of the margins within `step`, without derivatives.

        **Arguments:** `armed`: mask of lanes whose next zero of the section's velocity is a crossing; `lane`: the state
        after the step.
        """
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
        """Return the non-zero guard values with which a mode begins after a switch, relative to typical values."""
        values = self.scene.guard_values(self.c, lane.mode, lane.state)
        small = self.scene.resolutions(self.c, lane.mode, marked=False)
        return [
            jnp.where(step.hits[guard.name] & (g > zero), g / scale, jnp.inf)
            for guard, g, zero, scale in zip(self.scene.guards(), values, small, _typical(small), strict=True)
            if guard.is_switch
        ]


def _typical(resolutions: tuple[Any, ...]) -> list[Array]:
    """Return typical values of functions; `resolutions`: values below which the functions count as zero."""
    return [resolution / (ROUNDINGS * jnp.finfo(resolution.dtype).eps) for resolution in resolutions]


def _at_hit(f: Coefficients, step: Step, hit: Flags, rate: Array) -> jax.Array:
    """Return the slope at the end of a step that ends on the guard, relative to a typical `rate`; else infinity."""
    return jnp.where(hit, jnp.abs(slope(f, step.tau)) / (step.h * rate), jnp.inf)


def _near_miss(f: Coefficients, step: Step, scale: Array) -> jax.Array:
    """Return the positive minimum of a function within the step, divided by `scale`; infinity without a minimum."""
    rate = [k * coefficient for k, coefficient in enumerate(f)][1:]
    start, end = rate[0], value(rate, step.tau)
    turns = (start < 0) & (end > 0)
    place = jnp.where(turns, step.tau * start / jnp.where(turns, start - end, 1), 0)
    for _ in range(2):
        better = place - value(rate, place) / slope(rate, place)
        place = jnp.where(turns & (better > 0) & (better < step.tau), better, place)
    least = value(f, place)
    return jnp.where(turns & (least > 0), least / scale, jnp.inf)

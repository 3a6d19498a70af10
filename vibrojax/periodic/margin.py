"""How far the order of events is from changing along an orbit: a number without unit that vanishes at a graze.

Guards are functions positive within a mode. Where one is reached, its slope over a typical one counts, because a slope
of zero is a graze; where one comes to a least value within a step and is not reached, that value over a typical one.
Of a switch, what it begins a mode with counts too: by that a stick appears or vanishes. The section's velocity counts
as a guard while its next zero is a return.
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
"""In a sentence, for the attributes."""

GRAZING = 1e-5
"""Margin below which multipliers are not given. Beside a graze the map goes as a root, so its derivative holds over a
distance of about the margin squared: here that of the residual which is accepted, 1e-10."""


@dataclass(frozen=True)
class Margin:
    """The least margin on the way, from the scene, its section and its constants."""

    scene: Scene[Any]
    section: Section | None
    c: Any

    def after(self, least: Lanes, armed: Flags, lane: Lane, step: Step) -> Lanes:
        """The least so far, with a step that led to `lane` taken in; no derivative goes through it."""
        lane, step = lax.stop_gradient((lane, step))
        states = tuple(known(one) for one in step.polynomials)
        functions = self.scene.guard_values(self.c, step.mode, states)
        scales = self._typical(self.scene.resolutions(self.c, step.mode, marked=False))
        pace = self._pace(step)
        found = [least]
        for name, one, scale in zip(self.scene.guard_names, functions, scales, strict=True):
            f = [one.array(k, step.dt) for k in range(len(step.polynomials[0]))]
            found += [_at_hit(f, step, step.hits[name], scale * pace), _near_miss(f, step, scale)]
        return reduce(jnp.minimum, [*found, *self._of_section(armed, step, pace), *self._begun(lane, step)])

    def _of_section(self, armed: Flags, step: Step, pace: Lanes) -> list[Array]:
        """Those of the section's velocity; none where returns are the beginnings of pulses."""
        section = self.section
        if section is None:
            return []
        velocity = step.polynomials[self.scene.place(section.velocity)]
        speed = self.scene.speed_scale(self.c)
        hit = step.hits[self.scene.marker_of(section.velocity)]
        away = [-one for one in velocity] if section.rising else velocity
        near = jnp.where(armed, _near_miss(away, step, speed), jnp.inf)
        return [_at_hit(velocity, step, hit & armed, speed * pace), near]

    def _begun(self, lane: Lane, step: Step) -> list[Array]:
        """What switches begin a mode with, where it is not zero."""
        values = self.scene.guard_values(self.c, lane.mode, lane.state)
        small = self.scene.resolutions(self.c, lane.mode, marked=False)
        scales = self._typical(small)
        return [
            jnp.where(step.hits[guard.name] & (g > zero), g / scale, jnp.inf)
            for guard, g, zero, scale in zip(self.scene.guards(), values, small, scales, strict=True)
            if guard.is_switch
        ]

    def _typical(self, resolutions: tuple[Any, ...]) -> list[Array]:
        """Typical values of functions, from those that count as zero."""
        return [one / (ROUNDINGS * jnp.finfo(one.dtype).eps) for one in resolutions]

    def _pace(self, step: Step) -> jax.Array:
        """The fastest rate of the free motion [1/s]."""
        return self.scene.rate(self.c, tuple(jnp.full_like(step.dt, mode.calmest) for mode in self.scene.modes))


def _at_hit(f: Coefficients, step: Step, hit: Flags, rate: Array) -> jax.Array:
    """The slope at the end of a step that ends there, over a typical `rate`."""
    return jnp.where(hit, jnp.abs(slope(f, step.tau)) / (step.h * rate), jnp.inf)


def _near_miss(f: Coefficients, step: Step, scale: Array) -> jax.Array:
    """The least value within the step, over a typical one, where the function falls and rises again above zero."""
    rate = [k * one for k, one in enumerate(f)][1:]
    start, end = rate[0], value(rate, step.tau)
    turns = (start < 0) & (end > 0)
    at = jnp.where(turns, step.tau * start / jnp.where(turns, start - end, 1), 0)
    for _ in range(2):
        better = at - value(rate, at) / slope(rate, at)
        at = jnp.where(turns & (better > 0) & (better < step.tau), better, at)
    least = value(f, at)
    return jnp.where(turns & (least > 0), least / scale, jnp.inf)

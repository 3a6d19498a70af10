"""Features of one period of an orbit, among them the grazing margin: a distance, zero at grazing.

Guards are functions that are positive within a mode. The margin is the smallest of these quantities over the orbit:

- where a guard reaches zero: its slope, relative to a typical slope;
- where a guard has a positive minimum within a step: that minimum, relative to a typical value;
- where a guard is constant, as along a circular orbit: its value, relative to a typical value;
- at a switch: the guard values with which the new mode begins, relative to typical values. These values vanish where a
  stick phase appears or vanishes.

The section's velocity also counts as a guard while its next zero is a section crossing. Guards and sections that follow
from time alone cannot be grazed: such guards are left out, and such a section counts as 1.

Of slower and slower bounces that end in rest on a stop (complete chatter), only the first counts, also where they pass
the section. The map through all of them is smooth, although the last bounces graze: the rest erases the differences
(Nordmark and Piiroinen, *Nonlinear Dynamics* 58 (2009), 85).
"""

from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np
from jaxtyping import Float

from vibrojax.lazy import jax, jnp, lax
from vibrojax.physics.arrays import Array, Flags, Lanes
from vibrojax.scenes.declared import Section, Values
from vibrojax.scenes.scene import Scene
from vibrojax.stepping import Lane, Step
from vibrojax.stepping.polynomial import Coefficients, slope, value
from vibrojax.stepping.series import known

HOW = (
    "the least over the orbit of: |rate of a guard| where it is reached, over (its typical value times the rate of the "
    "free motion); a guard's least value within a mode where it is not, over its typical value; what a switch begins a "
    "mode with, over its typical value; the same of the section's velocity, which is 1 where a period sets the section"
)
"""Definition of the margin, for dataset attributes."""

GRAZING = 1e-5
"""Margin below which no multipliers are reported. Near grazing the map has a square-root singularity, so its derivative
is valid over a distance of about the squared margin. At this limit that distance is 1e-10, the accepted residual."""

DEPARTED = 1e-9
"""Value of a guard at the start of a step, relative to its typical value, up to which the step departs from it."""

FLAT = 1e-9
"""Slope at the end of a step that counts as zero, relative to the slope at its start."""


CONSTANT = 1e-7
"""Slope of a constant guard at both ends of a step, relative to a typical slope; orbits are exact to 1e-10."""


@dataclass(frozen=True)
class Margin:
    """Grazing margin of a motion of `scene` with the constants `c`, accumulated step by step.

    The margin has three rows (3, lanes), see `total`. The first is that of switches of friction, which vanishes where a
    stick phase appears or vanishes. The second is that of all other guards. The third limits the validity of
    derivatives: it is the least of both, with the square root of a near miss. Short of a graze, the map is smooth over
    a distance of the margin itself, not of its square. It is 0 if two events happen at one instant.
    `derives`: True if the margin is differentiated.
    """

    scene: Scene[Any]
    section: Section | None
    c: Any
    derives: bool = False

    def begin(self, zero: Lanes, mode: Values) -> Array:
        """Return the rows (7, lanes) before the first step; see `after`."""
        far = jnp.full_like(zero, jnp.inf)
        rests = reduce(jnp.logical_or, self.scene.at_rest(mode).values(), zero > 0)
        return jnp.stack([far, far, far, jnp.where(rests, 0.0, far), far, jnp.where(rests, -far, far), far])

    def after(self, rows: Array, armed: Flags, lane: Lane, step: Step) -> Array:
        """Return the minimum of `rows` (7, lanes) and of the margins within `step`, which leads to `lane`.

        The last row is infinite until the first step after an event, then 0. The three rows before it describe bounces
        that may end in rest. They are the margin of the last bounce, the least margin of the bounces since the first of
        the series, and the margin of the first bounce since the section. The latter has a negative sign if its series
        has ended in rest; then it does not count if the series began before the section. It is minus infinity if the
        motion is at rest at the section. `armed`: mask of lanes whose next zero of the section's velocity is a
        crossing.
        """
        if not self.derives:
            lane, step = lax.stop_gradient((lane, step))
        states = tuple(known(polynomial) for polynomial in step.polynomials)
        functions = self.scene.guard_values(self.c, step.mode, states)
        scales = self.scene.typical_guard_values(self.c, step.mode, step.before)
        # The fastest rate of the free motion [1/s].
        pace = self.scene.rate(self.c, tuple(jnp.full_like(step.dt, mode.calmest) for mode in self.scene.modes))
        fresh = jnp.isinf(rows[6])
        at_switches, of_section = self._at_switches(lane, step), self._of_section(armed, step, pace, fresh)
        switches, others, reach = (
            [rows[0], *at_switches],
            [rows[1], *of_section],
            [rows[2], *at_switches, *of_section],
        )
        last, series, first = rows[3:6]
        before, after = self.scene.at_rest(step.mode), self.scene.at_rest(lane.mode)
        held = [step.mode[place] == 0 for place in self.scene.switch_places.values()]
        # While a body is held, guards are constant; only those of a body that moves show that its orbit is a circle.
        constant = jnp.where(reduce(jnp.logical_or, [*held, *before.values()], fresh), -1.0, CONSTANT * pace)
        for guard, function, scale in zip(self.scene.guards(), functions, scales, strict=True):
            if guard.name in self.scene.clocks:
                continue
            f = function.arrays(len(step.polynomials[0]) - 1, step.dt)
            margins = switches if guard.is_switch else others
            hit = self.considered(guard.name, "hit", _at_hit(f, step, step.hits[guard.name], scale * pace))
            # Other guards, as those of kinks, are constant in modes that they do not concern.
            slow = constant if guard.is_switch or guard.name in self.scene.stops else -1.0
            miss = self.considered(guard.name, "miss", _near_miss(f, step, scale, slow * scale, fresh))
            if guard.name in before:
                bounces, rests = step.hits[guard.name] & ~before[guard.name], after[guard.name] & ~before[guard.name]
                slower = bounces & (hit < last)
                begins = bounces & jnp.isinf(last)
                first = jnp.where(begins, hit, jnp.where(bounces & ~slower & (first > 0), jnp.inf, first))
                hit, first, series, last = (
                    jnp.where(slower, jnp.inf, jnp.where(bounces, jnp.minimum(hit, series), hit)),
                    jnp.where(rests & (first < jnp.inf), -jnp.abs(first), first),
                    jnp.where(
                        rests | (bounces & ~slower), jnp.inf, jnp.where(slower, jnp.minimum(hit, series), series)
                    ),
                    jnp.where(rests, 0.0, jnp.where(bounces, hit, last)),
                )
            margins += [hit, miss]
            # A guard that falls to zero at the instant of another event: the derivative may depend on their order.
            together = step.hits[guard.name] & fresh & (step.dt == 0) & (jnp.abs(f[0]) <= DEPARTED * scale)
            reach += [hit, jnp.sqrt(lax.stop_gradient(miss)), jnp.where(together, 0.0, jnp.inf)]
        least = (reduce(jnp.minimum, margins) for margins in (switches, others, reach))
        ended = reduce(jnp.logical_or, step.hits.values(), step.dt < 0)
        begins = jnp.where(ended, jnp.inf, jnp.where(step.dt > 0, 0.0, rows[6]))
        return jnp.stack([*least, last, series, first, begins])

    def total(self, rows: Array) -> Array:
        """Return the margins (3, lanes) after the last step, if no series of bounces passes the section."""
        bounces = jnp.minimum(rows[4], jnp.abs(rows[5]))
        return jnp.stack([rows[0], jnp.minimum(rows[1], bounces), jnp.minimum(rows[2], bounces)])

    def considered(self, guard: str, what: str, margin: Array) -> Array:
        """Return a margin of a guard, infinite where it does not count; `what`: hit, miss or switch."""
        return margin

    @staticmethod
    def ends(rows: Array) -> Array:
        """Return the rows (5, lanes) of one return that `over_period` combines over all returns."""
        return jnp.stack([jnp.minimum(rows[0], rows[1]), *rows[2:6]])

    def _of_section(self, armed: Flags, step: Step, pace: Lanes, fresh: Flags) -> list[Array]:
        section = self.section
        if section is None:
            return []
        velocity = step.polynomials[self.scene.place(section.velocity)]
        speed = self.scene.speed_scale(self.c)
        hit = step.hits[self.scene.marker_of(section.velocity)]
        if section.velocity in self.scene.clocks:  # it always has its typical rate
            return [jnp.where(hit & armed, 1.0, jnp.full_like(pace, jnp.inf))]
        away = [-coefficient for coefficient in velocity] if section.rising else velocity
        near = jnp.where(armed, _near_miss(away, step, speed, -speed, fresh), jnp.inf)
        return [_at_hit(velocity, step, hit & armed, speed * pace), near]

    def _at_switches(self, lane: Lane, step: Step) -> list[Array]:
        """Return the non-zero guard values with which a mode begins after a switch, relative to typical values."""
        values = self.scene.guard_values(self.c, lane.mode, lane.state)
        small = self.scene.resolutions(self.c, lane.mode, lane.state, marked=False)
        scales = self.scene.typical_guard_values(self.c, lane.mode, lane.state)
        places, margins = self.scene.switch_places, []
        for guard, g, zero, scale in zip(self.scene.guards(), values, small, scales, strict=True):
            if guard.is_switch:
                begins = step.hits[guard.name] & (lane.mode[places[guard.name]] == 0) & (g > zero)
                margins.append(self.considered(guard.name, "switch", jnp.where(begins, g / scale, jnp.inf)))
        return margins


def over_period(ends: Float[np.ndarray, "orbits cycles 5"]) -> Float[np.ndarray, "orbits 2"]:
    """Return the grazing margin of orbits, and the margin that limits the validity of derivatives.

    **Arguments:** `ends`: see `Margin.ends`, of the returns in one period of each orbit.
    """
    last, series, first = np.moveaxis(ends[..., 2:], -1, 0)
    before, opened = np.roll(last, 1, axis=1), np.roll(series, 1, axis=1)
    # A motion that begins next to a stop is kept off it by rounding errors, so that its next bounce may be faster.
    slower = -first < np.maximum(before, GRAZING)
    complete = np.isfinite(before) & (first < 0) & (slower | np.isinf(first))
    bounces = np.where(complete, np.inf, np.minimum(opened, np.abs(first)))
    return np.asarray(np.minimum(ends[..., :2], bounces[..., None]).min(axis=1))


def _at_hit(f: Coefficients, step: Step, hit: Flags, rate: Array) -> "jax.Array":
    """Return the slope at the end of a step that ends on the guard, relative to a typical `rate`; else infinity."""
    return jnp.where(hit, jnp.abs(slope(f, step.tau)) / (step.h * rate), jnp.inf)


def _near_miss(f: Coefficients, step: Step, scale: Array, rate: Array, fresh: Flags) -> "jax.Array":
    """Return the minimum of a function within the step, at least 0, over `scale`; infinity without a minimum.

    A function whose slope is not above `rate` at both ends is constant; none is with a negative rate.

    Steps end where friction reverses, and hence at minima of gaps, where the slope is a rounding error. `fresh`: mask
    of the steps that begin with an event.
    """
    turns, place = turning(f, step.tau, 2)
    least = value(f, place)
    # A motion that has just left a surface along a tangent begins next to it, with a rate that is a rounding error.
    constant = jnp.maximum(jnp.abs(f[1]), jnp.abs(slope(f, step.tau))) <= step.h * rate
    departed = (fresh | (jnp.abs(f[1]) <= DEPARTED * scale)) & (f[0] <= DEPARTED * scale)
    # Down to the resolution of events, a guard may pass zero without one: the motion grazes.
    least = jnp.where(constant, f[0], least)
    return jnp.where(turns & ~departed | constant, jnp.maximum(least, 0.0) / scale, jnp.inf)


def turning(f: Coefficients, end: Array, iterations: int = 3) -> tuple[Flags, Array]:
    """Return a mask of the functions with a minimum up to `end`, and the minimum's place."""
    rate = [k * coefficient for k, coefficient in enumerate(f)][1:]
    start, last = rate[0], value(rate, end)
    turns = (start < 0) & (last > FLAT * start)
    place = jnp.where(turns, end * start / jnp.where(turns, start - jnp.maximum(last, 0.0), 1), 0)
    for _ in range(iterations):
        better = place - value(rate, place) / slope(rate, place)
        place = jnp.where(turns & (better > 0) & (better < end), better, place)
    return turns, place

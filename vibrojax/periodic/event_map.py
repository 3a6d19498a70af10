"""The return map past a graze: its smooth continuation to both sides, and the signed margin of the grazing event.

At a graze, the return map has a kink or a square-root singularity, because an event begins. Here the motion passes
shallow zeros of one guard without the event. The guard's minimum is then a smooth function of states and parameters
that changes its sign at the graze. Newton's method can therefore use orbits on both sides.

At a switch of friction the margin of sticking is evaluated whether the body sticks or reverses. It changes its sign
where a stick phase appears or vanishes.
"""

from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np
from jaxtyping import Float

from vibrojax.lanes.compiler import lane_function
from vibrojax.lazy import jax, jnp, lax
from vibrojax.periodic.margin import DEPARTED, Margin, turning
from vibrojax.periodic.return_map import Mapped, ReturnLoop, map_state
from vibrojax.physics.arrays import Array, Flags, Lanes
from vibrojax.scenes import Scene
from vibrojax.scenes.declared import Values
from vibrojax.stepping import Accuracy, Lane, Step, Varied
from vibrojax.stepping.event import Event
from vibrojax.stepping.polynomial import Coefficients, first_guess, root, slope, value
from vibrojax.stepping.series import known

PASSED_DEPTH = 1e-4
"""Depth below zero, relative to a typical value of the guard, up to which a motion passes the guard. It bounds the
errors of predictors, and with them the step length along curves."""

Chosen = Float[np.ndarray, "conditions lanes"]
"""For each lane, 1 for the condition of its curve, else 0; see `conditions_of`."""


def conditions_of(scene: Scene[Any]) -> list[tuple[str, int | None]]:
    """Return the conditions of events: the name of a guard, and the mode in which a switch may hold the motion.

    The mode is None for the condition that the minimum of the guard is zero.
    """
    return [(name, None) for name in scene.guard_names] + list(scene.switch_places.items())


@dataclass(frozen=True)
class PassedEvent(Event):
    """The functions of a step, with guards lifted where the motion passes them; `lifts`: one array per guard."""

    lifts: tuple[Array, ...] = ()

    def functions(self, state: tuple[Any, ...]) -> tuple[Any, ...]:
        functions = super().functions(state)
        lifted = [f + lift for f, lift in zip(functions, self.lifts, strict=False)]
        return (*lifted, *functions[len(lifted) :])


@dataclass(frozen=True)
class Passing(Varied):
    """The located stepper whose motion passes shallow zeros of the `chosen` guards, masks (lanes,) of 0 and 1."""

    chosen: tuple[Array, ...] = ()

    def passing(
        self, event: Event, functions: list[list[Array]], polynomials: tuple[list[Array], ...], lane: Lane, reach: Array
    ) -> tuple[Event, list[list[Array]]]:
        # Where the motion passes a guard does not depend smoothly on anything, so derivatives are not propagated.
        c, own, series = lax.stop_gradient((event.constants, functions[: len(self.chosen)], polynomials))
        mode, state, reach = lax.stop_gradient((lane.mode, lane.state, reach))
        scales = event.scene.typical_guard_values(c, mode, state)
        zeros = [_first_zero(f, reach) for f in own]
        lifts = []
        for k, (f, chosen, scale) in enumerate(zip(own, self.chosen, scales, strict=False)):
            least = _predicted_minimum(f, reach)
            if len(own) > 1:
                until, rises = _other_event(event.scene, c, mode, k, zeros, series)
                least = jnp.where(rises, _least_value(f, jnp.where(rises, until, reach)), least)
            lifts.append(chosen * jnp.where(least > -PASSED_DEPTH * scale, 2.0, 0.0) * (PASSED_DEPTH * scale))
        lifted = [[f[0] + lift, *f[1:]] for f, lift in zip(functions, lifts, strict=False)]
        passed = PassedEvent(event.scene, event.constants, event.mode, event.marked, event.smooths, tuple(lifts))
        return passed, [*lifted, *functions[len(lifted) :]]


@dataclass(frozen=True)
class EventMargin(Margin):
    """Signed margin of the `chosen` condition of each lane, and the grazing margin of all other events.

    Its first rows are the signed value that is closest to zero, the margin of the other events, the second-closest
    value, and the last four rows of `Margin`. A row for each guard follows: its value at the end of the last step, if
    it fell there until another event. If the guard rises behind the event, this value is its minimum.
    """

    chosen: tuple[Array, ...] = ()

    def begin(self, zero: Lanes, mode: Values) -> Array:
        rows = super().begin(zero, mode)
        return jnp.concatenate([rows, jnp.full((len(self.scene.guard_names), *zero.shape), jnp.inf, rows.dtype)])

    def after(self, least: Array, armed: Flags, lane: Lane, step: Step) -> Array:
        scene = self.scene
        states = tuple(known(polynomial) for polynomial in step.polynomials)
        order = len(step.polynomials[0]) - 1
        functions = [f.arrays(order, step.dt) for f in scene.guard_values(self.c, step.mode, states)]
        scales = scene.typical_guard_values(self.c, step.mode, step.before)
        first, second, others, fallen = least[0], least[2], least[3:7], least[7:]
        for (name, place), chosen in zip(conditions_of(scene), self.chosen, strict=True):
            index = scene.guard_names.index(name)
            if place is None:
                f = functions[index]
                corner = jnp.where(f[1] > 0, fallen[index], jnp.inf)
                scale = lax.stop_gradient(scales[index])
                margins = [_signed_minimum(f, step, scale) / scale, corner / scale]
            else:
                held = tuple(jnp.zeros_like(m) if k == place else m for k, m in enumerate(step.mode))
                scale = scene.typical_guard_values(self.c, held, step.after)[index]
                now = scene.guards()[index].function(self.c, held, step.after) / lax.stop_gradient(scale)
                margins = [jnp.where(step.hits[name] & (step.mode[place] != 0), now, jnp.inf)]
            for margin in margins:
                margin = jnp.where(chosen > 0, margin, jnp.inf)
                closer, between = jnp.abs(margin) < jnp.abs(first), jnp.abs(margin) < jnp.abs(second)
                second = jnp.where(closer, first, jnp.where(between, margin, second))
                first = jnp.where(closer, margin, first)
        fallen = jnp.stack([self._fallen(index, f, step) for index, f in enumerate(functions)])
        far = jnp.full_like(least[:3], jnp.inf)
        plain = lax.stop_gradient(super().after(jnp.concatenate([far, others]), armed, lane, step))
        nearest = jnp.minimum(least[1], plain[:2].min(axis=0))
        return jnp.concatenate([jnp.stack([first, nearest, second]), plain[3:], fallen])

    def _fallen(self, index: int, f: Coefficients, step: Step) -> Array:
        """Return the value of a guard that has fallen until another event at the end of the step, else infinity."""
        names = self.scene.guard_names
        others = [step.hits[name] for k, name in enumerate(names) if k != index]
        at_other = reduce(jnp.logical_or, others, jnp.zeros_like(step.hits[names[index]]))
        return jnp.where(at_other & (slope(f, step.tau) < 0), value(f, step.tau), jnp.inf)

    def total(self, rows: Array) -> Array:
        return jnp.stack([rows[0], jnp.minimum(rows[1], jnp.minimum(rows[4], jnp.abs(rows[5]))), rows[2]])

    def considered(self, guard: str, what: str, margin: Array) -> Array:
        for (name, place), chosen in zip(conditions_of(self.scene), self.chosen, strict=True):
            if name != guard:
                continue
            if place is None:
                own = (chosen > 0) & (what == "miss")
            else:
                # A slip that is reversed for an instant before the body sticks belongs to the same event.
                own = (chosen > 0) & ((what == "switch") | (margin < PASSED_DEPTH))
            margin = jnp.where(own, jnp.inf, margin)
        return margin


@lane_function(static=2)
def event_mapped(
    scene: Scene[Any],
    along: tuple[str, ...],
    p: dict[str, Lanes],
    state: Array,
    chosen: Array,
    accuracy: Accuracy,
    most_steps: Any,
) -> tuple[Mapped, Array]:
    """Return the images of states past a graze with their derivatives, and the derivatives of the signed margin.

    **Arguments:** `chosen`: see `Chosen`; the others as in [vibrojax.periodic.return_map.mapped][]. Of the results,
    `seen.margin` has the rows of `EventMargin`.
    """
    names, masks = scene.guard_names, tuple(chosen)
    loop = ReturnLoop(
        scene,
        Passing(chosen=masks[: len(names)]),
        accuracy,
        most_steps,
        lambda c: EventMargin(scene, scene.section, c, True, masks),
    )
    flight, moved = loop.differentiated(along, p, state)
    image, jacobian = map_state(scene, flight.lane), map_state(scene, moved.lane)
    return Mapped(image, flight.time, jacobian, flight.seen), moved.seen.margin[:, 0]


def _signed_minimum(f: Coefficients, step: Step, scale: Array) -> Array:
    """Return the minimum of a function within the step, which may be negative; infinity without a minimum.

    A motion that has just reached or left the surface begins next to it, with a rate that is a rounding error.
    """
    turns, place = turning(f, step.tau)
    departs = (jnp.abs(f[0]) <= DEPARTED * scale) & (jnp.abs(f[1]) <= DEPARTED * scale)
    return jnp.where(turns & ~departs, value(f, lax.stop_gradient(place)), jnp.inf)


def _least_value(f: Coefficients, end: Array) -> Array:
    """Return the least value of a function between the start of the step and `end`."""
    turns, place = turning(f, end)
    return jnp.minimum(jnp.minimum(f[0], value(f, end)), jnp.where(turns, value(f, place), jnp.inf))


def _predicted_minimum(f: Coefficients, reach: Array) -> Array:
    """Return the least value in a step, or the minimum behind its end to which a parabola leads."""
    end, rate = value(f, reach), slope(f, reach)
    curvature = slope([k * coefficient for k, coefficient in enumerate(f)][1:], reach)
    ahead = jnp.where(curvature > 0, end - rate * rate / jnp.where(curvature > 0, 2 * curvature, 1.0), -jnp.inf)
    return jnp.minimum(_least_value(f, reach), jnp.where(rate < 0, ahead, jnp.inf))


def _first_zero(f: Coefficients, reach: Array) -> Array:
    """Return the place in tau at which a function becomes negative; infinity if it does not."""
    end = value(f, reach)
    falls = (f[0] > 0) & (end < 0)
    guess = first_guess(jnp.maximum(f[0], 0.0), f[1] * reach, end) * reach
    return jnp.where(falls, root(f, jnp.zeros_like(reach), jnp.where(falls, guess, 0.5 * reach), reach), jnp.inf)


def _other_event(
    scene: Scene[Any], c: Any, mode: tuple[Array, ...], index: int, zeros: list[Array], polynomials: Any
) -> tuple[Array, Flags]:
    """Return the place in tau of the first event of the other guards, and a mask of lanes whose guard rises behind it.

    `index`: index of the guard; `zeros`: see `_first_zero`.
    """
    others = [jnp.full_like(zero, jnp.inf) if k == index else zero for k, zero in enumerate(zeros)]
    until = reduce(jnp.minimum, others)
    ends = until < jnp.inf
    hits: dict[str, Any] = dict.fromkeys(scene.event_names, jnp.zeros_like(ends))
    hits |= {name: ends & (zero == until) for name, zero in zip(scene.guard_names, others, strict=True)}
    reached = tuple(value(polynomial, jnp.where(ends, until, 0.0)) for polynomial in polynomials)
    mode, state = scene.after_event(c, mode, reached, hits)
    guard = scene.guards()[index].function
    rates = tuple(jnp.broadcast_to(rate, x.shape) for rate, x in zip(scene.field(c, mode, state), state, strict=True))
    _, slope_behind = jax.jvp(lambda state: guard(c, mode, state), (state,), (rates,))
    return until, ends & (slope_behind > 0)

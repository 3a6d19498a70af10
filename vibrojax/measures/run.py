"""The programs of one block of lanes: settle, as often as is asked, then observe and read."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from vibrojax.measures.recorder import Features, Records
from vibrojax.models.arrays import Array, Flags, Lanes, Real
from vibrojax.models.scenes.declared import Values
from vibrojax.models.scenes.scene import Scene
from vibrojax.stepping import Accuracy, Goal, Lane, Step, Stepper, lane_at

STEPS_PER_TURN = 4
"""Steps between two looks at the section: a lane that reaches it waits there, on average half of them."""

STEPS_PER_PASS = 3
"""The same while it settles, where a lane goes on past the section: fewer than a period has at the longest strides."""


class Effort(NamedTuple):
    """What the steps follow from, and after how many of them a lane is given up."""

    accuracy: Accuracy
    most_steps: Any


class Underway(NamedTuple):
    """Lanes between two programs: the lane, what its recorder carries, and the steps taken since t = 0."""

    lane: Lane
    carry: Any
    steps: Lanes


class Phase(NamedTuple):
    """What is done with the steps of one part of the way; `marked`: whether they end on markers.

    - `step`: takes in each; `turn`: what was met, every few (`steps`); `moves`: lanes that do not wait for that.
    """

    step: Callable[[Any, Lane, Step], Any]
    turn: Callable[[Any, Lane], Any]
    moves: Callable[[Any], Flags | bool]
    steps: int
    marked: bool


def start_block(scene: Scene[Any], recorder: Records, c: Any, state: Values) -> tuple[Lane, Any]:
    """(lane, what its recorder carries) at t = 0, from `state`, each (lanes,); `c`: the scene's constants."""
    lane = lane_at(scene, scene.scaled(c, state), state)
    return lane, recorder.settling(scene, lane)


def settle_block(
    scene: Scene[Any], stepper: Stepper, recorder: Records, c: Any, begun: Underway, until: Lanes, effort: Effort
) -> Underway:
    """The lanes at the times `until` [s], each (lanes,); `c`: the scene's constants, scaled for the lane's start."""

    def take_in(carry: Any, lane: Lane, step: Step) -> Any:
        return recorder.settle(scene, c, carry, lane, step)

    def turn(carry: Any, lane: Lane) -> Any:
        return recorder.settle_returns(carry)

    phase = Phase(take_in, turn, lambda carry: True, STEPS_PER_PASS, marked=False)
    return _through(scene, stepper, c, begun, until, effort, phase)


def observe_block(
    scene: Scene[Any],
    stepper: Stepper,
    recorder: Records,
    c: Any,
    begun: Underway,
    begin: Lanes,
    duration: Lanes,
    effort: Effort,
) -> tuple[Lane, Features]:
    """Lanes that have settled at the end of their observation, and their features, by name.

    **Arguments:** as of `settle_block`; `begin`, `duration` [s]: when each lane's observation begins, how long it is.
    """

    def take_in(carry: Any, lane: Lane, step: Step) -> Any:
        return recorder.step(scene, c, carry, lane, step)

    def turn(carry: Any, lane: Lane) -> Any:
        share = 1 - lane.clock.until(end) / duration
        return recorder.take_returns(scene, c, carry, lane, share)

    end = begin + duration
    settled = begun.lane.clock.until(begin) <= 0
    begun = begun._replace(carry=recorder.begin(scene, c, begun.lane, begun.carry))
    phase = Phase(take_in, turn, lambda carry: ~recorder.waiting(carry), STEPS_PER_TURN, marked=True)
    lane, carry, steps = _through(scene, stepper, c, begun, end, effort, phase)
    finite = jnp.all(jnp.stack([jnp.isfinite(y) for y in lane.state]), axis=0)
    return lane, recorder.read(scene, c, carry) | {
        "steps": steps,
        "finite": finite & jnp.isfinite(lane.clock.high),
        "finished": settled & (lane.clock.until(end) <= 0),
    }


def run_block(
    scene: Scene[Any],
    stepper: Stepper,
    recorder: Records,
    c: Any,
    state: Values,
    effort: Effort,
    settle: Real,
    observe: Real,
) -> Features:
    """Features of a block of lanes from their start to their end, by name; see the programs above.

    `settle`, `observe` [s]: how long they settle, and are observed then.
    """
    lane, carry = start_block(scene, recorder, c, state)
    c = scene.scaled(c, state)
    none = jnp.zeros_like(state[0])
    begin, duration = none + settle, none + observe
    begun = settle_block(scene, stepper, recorder, c, Underway(lane, carry, none), begin, effort)
    return observe_block(scene, stepper, recorder, c, begun, begin, duration, effort)[1]


def _through(
    scene: Scene[Any], stepper: Stepper, c: Any, begun: Underway, end: Lanes, effort: Effort, phase: Phase
) -> Underway:
    """Step every lane to its `end`."""

    def active(lane: Lane) -> Flags:
        return lane.clock.until(end) > 0  # a NaN is not

    def one(_: Any, now: Underway) -> Underway:
        lane, carry, steps = now
        moving = active(lane) & phase.moves(carry) & (steps < effort.most_steps)
        lane, step = stepper.step(scene, c, lane, effort.accuracy, Goal(end, moving), phase.marked)
        return Underway(lane, phase.step(carry, lane, step), jnp.where(moving, steps + 1, steps))

    def turn(now: Underway) -> Underway:
        lane, carry, steps = jax.lax.fori_loop(0, phase.steps, one, now)
        return Underway(lane, phase.turn(carry, lane), steps)

    def goes_on(now: Underway) -> Array:
        return jnp.any(active(now.lane) & (now.steps < effort.most_steps))

    return jax.lax.while_loop(goes_on, turn, begun)

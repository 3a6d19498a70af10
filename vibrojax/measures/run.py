"""Programs for one block of lanes: settle (any number of times), then observe, which returns the features."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from vibrojax.measures.recorder import Features, Records
from vibrojax.models.arrays import Array, Flags, Lanes, Real
from vibrojax.models.scenes.declared import Values
from vibrojax.models.scenes.scene import Scene
from vibrojax.stepping import Accuracy, Goal, Lane, Stepper, lane_at

STEPS_PER_TURN = 4
"""Number of steps between two checks for section crossings during the observation. A lane at the section waits for the
next check, on average for half of these steps."""

STEPS_PER_PASS = 3
"""The corresponding number while settling, when lanes do not wait. It is less than the number of steps per period with
the longest steps, so that no section crossing is missed."""


class Effort(NamedTuple):
    """The settings of the steps, and the greatest number of steps of a lane; the lane then stops early."""

    accuracy: Accuracy
    most_steps: Any


class Underway(NamedTuple):
    """A block of lanes between two programs: the lanes, the recorder's carry, and the number of steps since t = 0."""

    lane: Lane
    carry: Any
    steps: Lanes


def start_block(scene: Scene[Any], recorder: Records, c: Any, state: Values) -> tuple[Lane, Any]:
    """Return the lanes at t = 0 and the recorder's carry.

    `c`: the scene's constants; `state`: the initial state, a tuple of arrays (lanes,).
    """
    lane = lane_at(scene, scene.scaled(c, state), state)
    return lane, recorder.settling(scene, lane)


def settle_block(
    scene: Scene[Any], stepper: Stepper, recorder: Records, c: Any, begun: Underway, until: Lanes, effort: Effort
) -> Underway:
    """Return the lanes at the times `until` [s] (lanes,).

    `c`: the scene's constants after `Scene.scaled` for the initial state.
    """

    def step(lane: Lane, carry: Any, goal: Goal) -> tuple[Lane, Any]:
        lane, step = stepper.step(scene, c, lane, effort.accuracy, goal, False)
        return lane, recorder.settle(scene, c, carry, lane, step)

    return _run(begun, until, effort, STEPS_PER_PASS, step, lambda carry, lane: recorder.settle_returns(carry))


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
    """Return the lanes at the end of their observation, and their features by name.

    **Arguments:** as for `settle_block`; `begin`, `duration` [s]: beginning and length of each lane's observation.
    """
    end = begin + duration
    settled = begun.lane.clock.until(begin) <= 0
    begun = begun._replace(carry=recorder.begin(scene, c, begun.lane, begun.carry))

    def step(lane: Lane, carry: Any, goal: Goal) -> tuple[Lane, Any]:
        lane, step = stepper.step(scene, c, lane, effort.accuracy, goal, True)
        return lane, recorder.step(scene, c, carry, lane, step)

    def turn(carry: Any, lane: Lane) -> Any:
        return recorder.take_returns(scene, c, carry, lane, 1 - lane.clock.until(end) / duration)

    lane, carry, steps = _run(begun, end, effort, STEPS_PER_TURN, step, turn, lambda carry: ~recorder.waiting(carry))
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
    """Return the features of a block of lanes by name.

    `settle`: duration of settling [s]; `observe`: duration of the observation after it [s].
    """
    lane, carry = start_block(scene, recorder, c, state)
    c = scene.scaled(c, state)
    none = jnp.zeros_like(state[0])
    begin, duration = none + settle, none + observe
    begun = settle_block(scene, stepper, recorder, c, Underway(lane, carry, none), begin, effort)
    return observe_block(scene, stepper, recorder, c, begun, begin, duration, effort)[1]


def _run(
    begun: Underway,
    end: Lanes,
    effort: Effort,
    steps_per_turn: int,
    step: Callable[[Lane, Any, Goal], tuple[Lane, Any]],
    turn: Callable[[Any, Lane], Any],
    moves: Callable[[Any], Flags | bool] = lambda carry: True,
) -> Underway:
    """Step every lane to its `end` with `step`, and update the recorder's carry with `turn` every few steps.

    `moves` returns a mask of the lanes that do not wait for `turn`.
    """

    def active(lane: Lane) -> Flags:
        return lane.clock.until(end) > 0  # false for NaN

    def advance(_: Any, now: Underway) -> Underway:
        moving = active(now.lane) & moves(now.carry) & (now.steps < effort.most_steps)
        lane, carry = step(now.lane, now.carry, Goal(end, moving))
        return Underway(lane, carry, jnp.where(moving, now.steps + 1, now.steps))

    def several(now: Underway) -> Underway:
        lane, carry, steps = jax.lax.fori_loop(0, steps_per_turn, advance, now)
        return Underway(lane, turn(carry, lane), steps)

    def continues(now: Underway) -> Array:
        return jnp.any(active(now.lane) & (now.steps < effort.most_steps))

    return jax.lax.while_loop(continues, several, begun)

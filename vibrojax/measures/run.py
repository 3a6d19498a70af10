"""Programs for one block of lanes: settle (any number of times), then observe, which returns the features."""

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


class Phase(NamedTuple):
    """The functions and settings of one part of the run, settling or observation.

    - `step`: function that updates the recorder's carry with a step.
    - `turn`: function that updates the recorder's carry with section crossings, called once every `steps` steps.
    - `moves`: function that returns a mask of the lanes that do not wait for `turn`.
    - `marked`: True if steps end on markers.
    """

    step: Callable[[Any, Lane, Step], Any]
    turn: Callable[[Any, Lane], Any]
    moves: Callable[[Any], Flags | bool]
    steps: int
    marked: bool


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
    phase = Phase(
        step=lambda carry, lane, step: recorder.settle(scene, c, carry, lane, step),
        turn=lambda carry, lane: recorder.settle_returns(carry),
        moves=lambda carry: True,
        steps=STEPS_PER_PASS,
        marked=False,
    )
    return _run(scene, stepper, c, begun, until, effort, phase)


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
    phase = Phase(
        step=lambda carry, lane, step: recorder.step(scene, c, carry, lane, step),
        turn=lambda carry, lane: recorder.take_returns(scene, c, carry, lane, 1 - lane.clock.until(end) / duration),
        moves=lambda carry: ~recorder.waiting(carry),
        steps=STEPS_PER_TURN,
        marked=True,
    )
    lane, carry, steps = _run(scene, stepper, c, begun, end, effort, phase)
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
    scene: Scene[Any], stepper: Stepper, c: Any, begun: Underway, end: Lanes, effort: Effort, phase: Phase
) -> Underway:
    """Step every lane to its `end`."""

    def active(lane: Lane) -> Flags:
        return lane.clock.until(end) > 0  # false for NaN

    def advance(_: Any, now: Underway) -> Underway:
        lane, carry, steps = now
        moving = active(lane) & phase.moves(carry) & (steps < effort.most_steps)
        lane, step = stepper.step(scene, c, lane, effort.accuracy, Goal(end, moving), phase.marked)
        return Underway(lane, phase.step(carry, lane, step), jnp.where(moving, steps + 1, steps))

    def turn(now: Underway) -> Underway:
        lane, carry, steps = jax.lax.fori_loop(0, phase.steps, advance, now)
        return Underway(lane, phase.turn(carry, lane), steps)

    def continues(now: Underway) -> Array:
        return jnp.any(active(now.lane) & (now.steps < effort.most_steps))

    return jax.lax.while_loop(continues, turn, begun)

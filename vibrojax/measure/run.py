"""The programs of one block of lanes: settle, as often as is asked, then observe and read."""

import jax
import jax.numpy as jnp

from vibrojax.stepping import lane_at

STEPS_PER_TURN = 4
"""Steps between two looks at the section: a lane that reaches it waits there, on average half of them."""

STEPS_PER_PASS = 3
"""The same while it settles, where a lane goes on past the section: fewer than a period has at the longest strides."""


def start_block(scene, recorder, p, state) -> tuple:
    """(lane, what its recorder watches) at t = 0, from `state`, each (lanes,)."""
    lane = lane_at(scene, scene.scaled(p, state), state)
    return lane, recorder.watch.begin(lane)


def settle_block(scene, method, recorder, p, lane, returns, steps, until, settings) -> tuple:
    """(lane, what its recorder watches, steps taken since t = 0) at the times `until` [s], each (lanes,).

    **Arguments:**

    - `p`: the scene's constants, scaled for the lane's start, each (lanes,).
    - `steps`: that the lanes have taken before.
    - `settings`: the method's, and `most_steps`, after which a lane is given up.
    """
    watch = recorder.watch

    def step(returns, lane, step):
        return watch.pass_by(scene, p, returns, lane, step)

    def turn(returns, lane):
        return watch.turn_over_passed(returns)

    def moves(returns):
        return True

    begun = (lane, returns, steps)
    return _stretch(scene, method, p, settings, until, begun, step, turn, moves, STEPS_PER_PASS, marked=False)


def observe_block(scene, method, recorder, p, lane, returns, steps, begin, last, settings) -> dict:
    """Features of a block of lanes that have settled, by name.

    **Arguments:** as of `settle_block`; `begin`, `last` [s]: when each lane's observation begins, and how long it is.
    """

    def step(carry, lane, step):
        return recorder.step(scene, p, carry, lane, step)

    def turn(carry, lane):
        share = 1 - lane.clock.until(end) / last
        return recorder.turn_over(scene, p, carry, lane, share)

    def moves(carry):
        return ~carry["returns"]["waiting"]

    end = begin + last
    settled = lane.clock.until(begin) <= 0
    carry = recorder.begin(scene, p, lane, returns)
    begun = (lane, carry, steps)
    lane, carry, steps = _stretch(scene, method, p, settings, end, begun, step, turn, moves, STEPS_PER_TURN)
    finite = jnp.all(jnp.stack([jnp.isfinite(y) for y in lane.state]), axis=0)
    return recorder.read(scene, p, carry) | {
        "steps": steps,
        "finite": finite & jnp.isfinite(lane.clock.high),
        "finished": settled & (lane.clock.until(end) <= 0),
    }


def run_block(scene, method, recorder, p, state, settings) -> dict:
    """Features of a block of lanes from their start to their end, by name; see the programs above.

    `settings` also has `settle` and `observe` [s]: how long they settle, and are observed then.
    """
    lane, returns = start_block(scene, recorder, p, state)
    p = scene.scaled(p, state)
    none = jnp.zeros_like(state[0])
    begin, last = none + settings["settle"], none + settings["observe"]
    lane, returns, steps = settle_block(scene, method, recorder, p, lane, returns, none, begin, settings)
    return observe_block(scene, method, recorder, p, lane, returns, steps, begin, last, settings)


def _stretch(scene, method, p, settings, end, begun, take_in, turn_over, moves, steps_per_turn, marked=True):
    """Step every lane to its `end`, taking in each step, and what was met every few steps.

    `begun` is (lane, what is carried, steps taken so far), and so is what comes out.
    """

    def active(lane):
        return lane.clock.until(end) > 0  # a NaN is not

    def one(_, state):
        lane, carry, steps = state
        moving = active(lane) & moves(carry) & (steps < settings["most_steps"])
        lane, step = method.step(scene, p, lane, settings, end, moving, marked)
        return lane, take_in(carry, lane, step), jnp.where(moving, steps + 1, steps)

    def turn(state):
        lane, carry, steps = jax.lax.fori_loop(0, steps_per_turn, one, state)
        return lane, turn_over(carry, lane), steps

    def goes_on(state):
        lane, _, steps = state
        return jnp.any(active(lane) & (steps < settings["most_steps"]))

    return jax.lax.while_loop(goes_on, turn, begun)

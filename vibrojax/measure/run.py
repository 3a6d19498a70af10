"""The program of one block of lanes: settle, observe, read."""

import jax
import jax.numpy as jnp

from vibrojax.stepping import lane_at

STEPS_PER_TURN = 4
"""Steps between two looks at the section: a lane that reaches it waits there, on average half of them."""


def run_block(scene, method, recorder, p, state, real, settings) -> dict:
    """Features of a block of lanes, by name.

    **Arguments:**

    - `p`: the scene's constants, each (lanes,); `state`: the states at t = 0, each (lanes,).
    - `real`: False for lanes that only fill up the block; they take no step.
    - `settings`: the method's, and `settle`, `observe` [s], `most_steps` (steps after which a lane is given up).
    """
    p = scene.scaled(p, state)
    lane = lane_at(scene, p, state, real)
    settle = settings["settle"] * jnp.ones_like(state[0])
    end = settle + settings["observe"]

    watch = recorder.watch

    def settling_step(returns, lane, step):
        return watch.step(scene, p, returns, lane, step)

    def settling_turn(returns, lane):
        return watch.turn_over(returns, lane)

    lane, returns, steps = _stretch(
        scene, method, p, settings, settle, lane, watch.begin(lane), settling_step, settling_turn, lambda c: c
    )

    settled = lane.clock.until(settle) <= 0

    def observing_step(carry, lane, step):
        return recorder.step(scene, p, carry, lane, step)

    def observing_turn(carry, lane):
        share = 1 - lane.clock.until(end) / settings["observe"]
        return recorder.turn_over(scene, p, carry, lane, share)

    lane, carry, more = _stretch(
        scene,
        method,
        p,
        settings,
        end,
        lane,
        recorder.begin(scene, p, lane, returns),
        observing_step,
        observing_turn,
        lambda c: c["returns"],
    )
    finite = jnp.all(jnp.stack([jnp.isfinite(y) for y in lane.state]), axis=0)
    return recorder.read(scene, p, carry) | {
        "steps": steps + more,
        "finite": finite & jnp.isfinite(lane.clock.high),
        "finished": settled & (lane.clock.until(end) <= 0),
    }


def _stretch(scene, method, p, settings, end, lane, carry, take_in, turn_over, returns_of):
    """Step every lane to its `end`, taking in each step, and each return while the lane waits at the section."""

    def active(lane):
        return lane.clock.until(end) > 0  # a NaN is not

    def one(_, state):
        lane, carry, steps = state
        moving = active(lane) & ~returns_of(carry)["waiting"] & (steps < settings["most_steps"])
        lane, step = method.step(scene, p, lane, settings, end, moving)
        return lane, take_in(carry, lane, step), jnp.where(moving, steps + 1, steps)

    def turn(state):
        lane, carry, steps = jax.lax.fori_loop(0, STEPS_PER_TURN, one, state)
        return lane, turn_over(carry, lane), steps

    def goes_on(state):
        lane, _, steps = state
        return jnp.any(active(lane) & (steps < settings["most_steps"]))

    return jax.lax.while_loop(goes_on, turn, (lane, carry, jnp.zeros_like(end)))

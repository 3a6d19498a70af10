"""The compiled programs of lanes: start, settle up to a time, observe; each for a few blocks of lanes one by one."""

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import jax
import jax.numpy as jnp

from vibrojax.measure.run import observe_block, settle_block, start_block

BLOCK = 64
"""Lanes that step together on a CPU core: a step's arrays stay in cache, and few lanes wait for others. Every block has
this size, and one thread, so that a lane's answer does not depend, to the last bit, on what is computed beside it."""

BLOCKS = 8
"""Blocks per call of a program, one after the other: a call costs as much as some hundred steps of a block."""

BLOCK_ON_ACCELERATOR = 16384
"""Lanes that step together on an accelerator, where a step of a few costs as much as one of many."""


class Compiled(NamedTuple):
    """The programs, jitted: see the functions of these names."""

    start: Callable
    settle: Callable
    observe: Callable


@cache
def compiled(platform: str) -> Compiled:
    """The programs for the devices of a platform, such as "cpu"."""
    options: dict[str, int | str] = {}
    if platform == "cpu":
        # A block fills the widest registers there are; where they are narrower this says nothing.
        options["xla_cpu_prefer_vector_width"] = 512
        if jax.__version_info__ < (0, 11, 2):
            # It takes barriers out before values are fused, and then works them out again and again: eight times the
            # arithmetic. Later versions do without.
            options["xla_disable_hlo_passes"] = "cse_barrier_expander"

    def jitted(program, *static):
        return jax.jit(
            program, static_argnames=("scene", *static, "recorder", "starts", "block"), compiler_options=options
        )

    return Compiled(jitted(start_lanes), jitted(settle_lanes, "method"), jitted(observe_lanes, "method"))


def start_lanes(scene, recorder, starts, block, count, p, start) -> tuple:
    """(lane, what its recorder watches) at t = 0.

    **Arguments:**

    - `starts`: names or vectors (static); `start` says which one each lane takes, integers (lanes,).
    - `block`: how many lanes step together (static); `count`: how many blocks of the lanes are to be computed.
    - `p`: parameters by name, each (lanes,).
    """

    def program(p, start):
        constants = dict(scene.constants(p))
        return start_block(scene, recorder, constants, _state(scene, constants, starts, start))

    return _block_by_block(program, block, count, p, start)


def settle_lanes(
    scene, method, recorder, starts, block, count, p, start, lane, returns, steps, until, settings
) -> tuple:
    """(lane, what its recorder watches, steps taken) at the times `until` [s]; see `settle_block`."""

    def program(p, start, lane, returns, steps, until):
        constants = _constants(scene, starts, p, start)
        return settle_block(scene, method, recorder, constants, lane, returns, steps, until, settings)

    return _block_by_block(program, block, count, p, start, lane, returns, steps, until)


def observe_lanes(
    scene, method, recorder, starts, block, count, p, start, lane, returns, steps, begin, last, settings
) -> dict:
    """Features by name, (lanes,), or (rows, lanes) for returns that are kept; see `observe_block`."""

    def program(p, start, lane, returns, steps, begin, last):
        constants = _constants(scene, starts, p, start)
        return observe_block(scene, method, recorder, constants, lane, returns, steps, begin, last, settings)

    return _block_by_block(program, block, count, p, start, lane, returns, steps, begin, last)


def _block_by_block(program, block, count, *given):
    """What `program` gives for the first `count` blocks of lanes, one after the other; zeros for the others.

    Lanes are the last axis of all that is given and of all that comes out.
    """

    def cut(x):
        return jnp.moveaxis(x.reshape(*x.shape[:-1], -1, block), -2, 0)

    def joined(x):
        return jnp.moveaxis(x, 0, -2).reshape(*x.shape[1:-1], -1)

    blocks = jax.tree.map(cut, given)
    of_one = jax.eval_shape(program, *jax.tree.map(lambda x: x[0], blocks))
    blocks_given = len(jax.tree.leaves(blocks)[0])

    def one(index, found):
        new = program(*jax.tree.map(lambda x: x[index], blocks))
        return jax.tree.map(lambda whole, part: whole.at[index].set(part), found, new)

    nothing = jax.tree.map(lambda x: jnp.zeros((blocks_given, *x.shape), x.dtype), of_one)
    return jax.tree.map(joined, jax.lax.fori_loop(0, count, one, nothing))


def _constants(scene, starts, p, start):
    """The scene's constants, for a motion from the lane's start."""
    constants = dict(scene.constants(p))
    return scene.scaled(constants, _state(scene, constants, starts, start))


def _state(scene, p, starts, start):
    """The state at t = 0 of each lane, from the start that it takes; the scene's own where it has no starts."""
    candidates = [scene.start(p, name, start.shape) for name in starts or (None,)]
    state = candidates[0]
    for index, other in enumerate(candidates[1:], start=1):
        state = tuple(jnp.where(start == index, new, old) for new, old in zip(other, state, strict=True))
    return state

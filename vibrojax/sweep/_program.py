"""The compiled program of a block of lanes."""

from functools import partial

import jax
import jax.numpy as jnp

from vibrojax.measure.run import run_block

BLOCK = 64
"""Lanes that step together on a CPU core: a step's arrays stay in cache, and few lanes wait for others. Every block has
this size, and one thread, so that a lane's answer does not depend, to the last bit, on what is computed beside it."""

BLOCK_ON_ACCELERATOR = 16384
"""Lanes that step together on an accelerator, where a step of a few costs as much as one of many."""


_WIDE = {"xla_cpu_prefer_vector_width": 512}
"""A block fills the widest registers there are; where they are narrower this says nothing."""


@partial(jax.jit, static_argnames=("scene", "method", "recorder", "starts"), compiler_options=_WIDE)
def run_lanes(scene, method, recorder, starts, p, start, count, settings) -> dict:
    """Features of a block of lanes.

    **Arguments:**

    - `starts`: names or vectors (static); `start` says which one each lane takes, integers (lanes,).
    - `p`: parameters by name, each (lanes,).
    - `count`: how many of the lanes, from the first, are to be computed; the others only fill up the block.
    - `settings`: see [vibrojax.measure.run.run_block][].

    **Returns:** features by name, (lanes,), or (rows, lanes) for returns that are kept.
    """
    constants = dict(scene.constants(p))
    state = _start(scene, constants, starts, start)
    real = jnp.arange(start.size, dtype=count.dtype) < count
    return run_block(scene, method, recorder, constants, state, real, settings)


def _start(scene, p, starts, start):
    """The state at t = 0 of each lane, from the start that it takes; the scene's own where it has no starts."""
    candidates = [scene.start(p, name, start.shape) for name in starts or (None,)]
    state = candidates[0]
    for index, other in enumerate(candidates[1:], start=1):
        state = tuple(jnp.where(start == index, new, old) for new, old in zip(other, state, strict=True))
    return state

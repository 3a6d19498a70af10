"""Programs of lanes compiled by XLA: for accelerators, and for what no kernel can do."""

from collections.abc import Callable
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxlib import version as jaxlib
from jaxtyping import Int

from vibrojax.compile.arithmetic import check
from vibrojax.models.arrays import Array
from vibrojax.sweep.engine.compiler import compiler_options
from vibrojax.sweep.engine.programs import Kind, Programs

BLOCK = 64
"""Lanes that step together on a CPU core: a step's arrays stay in cache, and few lanes wait for others. Every block has
this size, and one thread, so that a lane's answer does not depend, to the last bit, on what is computed beside it."""

BLOCKS = 8
"""Blocks per call of a program, one after the other: a call costs as much as some hundred steps of a block."""

BLOCK_ON_ACCELERATOR = 16384
"""Lanes that step together on an accelerator, where a step of a few costs as much as one of many."""

Count = Int[Array, ""]
"""A whole number, an array so that another value compiles nothing again."""


class ByXla(Programs):
    """Programs for the devices of a `platform`, such as "cpu"."""

    compiler = "xla"

    def __init__(self, kind: Kind, platform: str) -> None:
        super().__init__(kind)
        self._platform = platform
        self.block, blocks = (BLOCK, BLOCKS) if platform == "cpu" else (BLOCK_ON_ACCELERATOR, 1)
        self.hand = self.block * blocks

    def check_arithmetic(self, dtype: np.dtype) -> None:
        options = compiler_options(self._platform)
        evaluate = _evaluated_by(tuple(options.items()))
        check(evaluate, f"jaxlib {jaxlib.__version__}", dtype, self.block)

    def _run(self, program: Callable[..., Any], *arguments: Any) -> Any:
        lanes = max(np.shape(x)[-1] for x in jax.tree.leaves(arguments) if np.ndim(x))
        count = np.int32(-(-lanes // self.block))
        several = jax.tree.map(lambda x: _resized(x, self.hand), arguments)
        found = _compiled(self._platform)(program, self.kind, self.block, count, *several)
        return jax.tree.map(lambda x: np.asarray(x)[..., :lanes], found)


@cache
def _evaluated_by(options: tuple[tuple[str, int | str], ...]) -> Callable[..., Any]:
    return lambda function, *x: jax.jit(function, compiler_options=dict(options))(*x)


def _resized(x: Any, lanes: int) -> Any:
    """So many lanes, those that there are again and again; what is one for all lanes as it is."""
    return np.take(x, np.resize(np.arange(np.shape(x)[-1]), lanes), axis=-1) if np.ndim(x) else x


@cache
def _compiled(platform: str) -> Callable[..., Any]:
    return jax.jit(_block_by_block, static_argnums=(0, 1, 2), compiler_options=compiler_options(platform))


def _block_by_block(program: Callable[..., Any], kind: Kind, block: int, count: Count, *given: Any) -> Any:
    """What `program` gives for the first `count` blocks of lanes, one after the other; zeros for the others.

    Lanes are the last axis of all that is given and of all that comes out; what has no axes is one for all of them.
    """

    def cut(x: Array) -> Array:
        return jnp.moveaxis(x.reshape(*x.shape[:-1], -1, block), -2, 0) if x.ndim else x

    def joined(x: Array) -> Array:
        return jnp.moveaxis(x, 0, -2).reshape(*x.shape[1:-1], -1)

    def of_block(index: Any) -> Any:
        return jax.tree.map(lambda x: x[index] if x.ndim else x, blocks)

    blocks = jax.tree.map(cut, given)
    of_one = jax.eval_shape(lambda: program(kind, *of_block(0)))
    number = next(len(x) for x in jax.tree.leaves(blocks) if x.ndim)

    def one(index: Array, done: Any) -> Any:
        new = program(kind, *of_block(index))
        return jax.tree.map(lambda whole, part: whole.at[index].set(part), done, new)

    nothing = jax.tree.map(lambda x: jnp.zeros((number, *x.shape), x.dtype), of_one)
    return jax.tree.map(joined, jax.lax.fori_loop(0, count, one, nothing))

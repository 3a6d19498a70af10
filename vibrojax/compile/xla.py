"""Functions of lanes compiled by XLA: for accelerators, and for what no kernel can express."""

from collections.abc import Callable, Hashable
from functools import cache, wraps
from typing import Any, ParamSpec, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxlib import version as jaxlib
from jaxtyping import Int

WIDE_VECTORS_CHECKED = ("0.10.0", "0.12.0.1")
"""Versions of jaxlib whose functions are right with the widest registers (AVX-512). In 0.10.2, 0.11.0 and 0.11.2 arctan
of more than 16 values returns them in the wrong places."""

P = ParamSpec("P")
R = TypeVar("R")

Options = tuple[tuple[str, int | str], ...]


def compiler_options(platform: str) -> dict[str, int | str]:
    """Return XLA's options for functions of lanes on the devices of a platform, such as "cpu"."""
    options: dict[str, int | str] = {}
    if platform == "cpu":
        if jaxlib.__version__ in WIDE_VECTORS_CHECKED:
            # A block fills the widest registers; on processors with narrower ones this has no effect.
            options["xla_cpu_prefer_vector_width"] = 512
        if jax.__version_info__ < (0, 11, 2):
            # This pass removes barriers before values are fused, which computes them again and again: eight times the
            # arithmetic. Later versions do not have it.
            options["xla_disable_hlo_passes"] = "cse_barrier_expander"
    return options


def jitted(static: tuple[str, ...] = ()) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Return a decorator: `jax.jit` with the options of the platform in use; arguments named in `static` are static."""

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        @cache
        def program(options: Options) -> Callable[P, R]:
            return jax.jit(function, static_argnames=static, compiler_options=dict(options))

        @wraps(function)
        def call(*args: P.args, **kwargs: P.kwargs) -> R:
            return program(tuple(compiler_options(jax.default_backend()).items()))(*args, **kwargs)

        return call

    return decorate


@cache
def evaluation(options: Options) -> Callable[..., Any]:
    """Return `evaluate(function, *arrays)`, which compiles with these options."""
    return lambda function, *arrays: jax.jit(function, compiler_options=dict(options))(*arrays)


def run_in_blocks(
    function: Callable[..., Any], static: tuple[Hashable, ...], block: int, blocks: int, *arguments: Any
) -> Any:
    """Return `function(*static, *arguments)` for lanes in blocks of `block`, one after the other, as numpy arrays.

    Arguments and results are pytrees of arrays whose last axis is the lanes', or without axes. Each call has room for
    `blocks` blocks, which must hold all lanes, so that any number of lanes runs through one compiled program.
    """
    lanes = max(np.shape(x)[-1] for x in jax.tree.leaves(arguments) if np.ndim(x))
    repeated = np.resize(np.arange(lanes), block * blocks)  # lanes beyond the last fill up its block
    padded = jax.tree.map(lambda x: np.take(x, repeated, axis=-1) if np.ndim(x) else x, arguments)
    results = _run_blocks(function, static, block, np.int32(-(-lanes // block)), *padded)
    return jax.tree.map(lambda x: np.asarray(x)[..., :lanes], results)


@jitted(static=("function", "static", "block"))
def _run_blocks(
    function: Callable[..., Any], static: tuple[Hashable, ...], block: int, count: Int[Any, ""], *arguments: Any
) -> Any:
    """Return the results for the first `count` blocks, a traced number, and zeros for the others."""

    def cut(x: jax.Array) -> jax.Array:
        return jnp.moveaxis(x.reshape(*x.shape[:-1], -1, block), -2, 0) if x.ndim else x

    def join(x: jax.Array) -> jax.Array:
        return jnp.moveaxis(x, 0, -2).reshape(*x.shape[1:-1], -1)

    def run_block(index: Any) -> Any:
        return function(*static, *jax.tree.map(lambda x: x[index] if x.ndim else x, in_blocks))

    def turn(index: Any, results: Any) -> Any:
        return jax.tree.map(lambda whole, part: whole.at[index].set(part), results, run_block(index))

    in_blocks = jax.tree.map(cut, arguments)
    number = next(len(x) for x in jax.tree.leaves(in_blocks) if x.ndim)
    shapes = jax.eval_shape(lambda: run_block(0))
    zeros = jax.tree.map(lambda x: jnp.zeros((number, *x.shape), x.dtype), shapes)
    return jax.tree.map(join, jax.lax.fori_loop(0, count, turn, zeros))

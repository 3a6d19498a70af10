"""The compiled programs of lanes: start, settle up to a time, observe; each for a few blocks of lanes one by one."""

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Int

from vibrojax.arrays import Array, Counts, Lanes
from vibrojax.engine.compiler import compiler_options
from vibrojax.input.definition import Start
from vibrojax.measure.recorder import Features, Records
from vibrojax.measure.run import Effort, Underway, observe_block, settle_block, start_block
from vibrojax.scenes import Scene
from vibrojax.scenes.scene import Values
from vibrojax.stepping import Lane, Stepper

BLOCK = 64
"""Lanes that step together on a CPU core: a step's arrays stay in cache, and few lanes wait for others. Every block has
this size, and one thread, so that a lane's answer does not depend, to the last bit, on what is computed beside it."""

BLOCKS = 8
"""Blocks per call of a program, one after the other: a call costs as much as some hundred steps of a block."""

BLOCK_ON_ACCELERATOR = 16384
"""Lanes that step together on an accelerator, where a step of a few costs as much as one of many."""


Count = Int[Array, ""]
"""A whole number, an array so that another value compiles nothing again."""


class Kind(NamedTuple):
    """What a program is compiled for: scene, stepper, recorder, the starts there are, and the lanes of a block."""

    scene: Scene[Any]
    stepper: Stepper
    recorder: Records
    starts: tuple[Start, ...] | None
    block: int


class Given(NamedTuple):
    """Parameters by name, and which of the starts, of each lane (lanes,); or the states of a start of its own."""

    parameters: dict[str, Lanes]
    start: Counts
    states: tuple[Lanes, ...] = ()


class Compiled(NamedTuple):
    """The programs, jitted: see the functions of these names."""

    start: Callable[..., tuple[Lane, Any]]
    settle: Callable[..., Underway]
    observe: Callable[..., Features]


@cache
def compiled(platform: str) -> Compiled:
    """The programs for the devices of a platform, such as "cpu"."""
    options = compiler_options(platform)
    programs = (start_lanes, settle_lanes, observe_lanes)
    return Compiled(*(jax.jit(program, static_argnames="kind", compiler_options=options) for program in programs))


def start_lanes(kind: Kind, count: Count, given: Given) -> tuple[Lane, Any]:
    """(lane, what its recorder carries) at t = 0 of the lanes of the first `count` blocks."""

    def program(given: Given) -> tuple[Lane, Any]:
        constants = kind.scene.constants(given.parameters)
        return start_block(kind.scene, kind.recorder, constants, _state(kind, constants, given))

    return _block_by_block(program, kind.block, count, given)


def settle_lanes(kind: Kind, count: Count, given: Given, begun: Underway, until: Lanes, effort: Effort) -> Underway:
    """The lanes at the times `until` [s]; see `settle_block`."""

    def program(given: Given, begun: Underway, until: Lanes) -> Underway:
        constants = _constants(kind, given)
        return settle_block(kind.scene, kind.stepper, kind.recorder, constants, begun, until, effort)

    return _block_by_block(program, kind.block, count, given, begun, until)


def observe_lanes(
    kind: Kind, count: Count, given: Given, begun: Underway, begin: Lanes, duration: Lanes, effort: Effort
) -> Features:
    """Features by name, (lanes,), or (returns, lanes) for the last returns; see `observe_block`."""

    def program(given: Given, begun: Underway, begin: Lanes, duration: Lanes) -> Features:
        constants = _constants(kind, given)
        return observe_block(kind.scene, kind.stepper, kind.recorder, constants, begun, begin, duration, effort)

    return _block_by_block(program, kind.block, count, given, begun, begin, duration)


def _block_by_block(program: Callable[..., Any], block: int, count: Count, *given: Any) -> Any:
    """What `program` gives for the first `count` blocks of lanes, one after the other; zeros for the others.

    Lanes are the last axis of all that is given and of all that comes out.
    """

    def cut(x: Array) -> Array:
        return jnp.moveaxis(x.reshape(*x.shape[:-1], -1, block), -2, 0)

    def joined(x: Array) -> Array:
        return jnp.moveaxis(x, 0, -2).reshape(*x.shape[1:-1], -1)

    blocks = jax.tree.map(cut, given)
    of_one = jax.eval_shape(program, *jax.tree.map(lambda x: x[0], blocks))
    number = len(jax.tree.leaves(blocks)[0])

    def one(index: Array, done: Any) -> Any:
        new = program(*jax.tree.map(lambda x: x[index], blocks))
        return jax.tree.map(lambda whole, part: whole.at[index].set(part), done, new)

    nothing = jax.tree.map(lambda x: jnp.zeros((number, *x.shape), x.dtype), of_one)
    return jax.tree.map(joined, jax.lax.fori_loop(0, count, one, nothing))


def _constants(kind: Kind, given: Given) -> Any:
    """The scene's constants, for a motion from the lane's start."""
    constants = kind.scene.constants(given.parameters)
    return kind.scene.scaled(constants, _state(kind, constants, given))


def _state(kind: Kind, constants: Any, given: Given) -> Values:
    """The state at t = 0 of each lane, from the start that it takes; the scene's own where it has no starts."""
    start = given.start
    if given.states:
        return kind.scene.start(constants, given.states, start.shape)
    candidates = [kind.scene.start(constants, name, start.shape) for name in kind.starts or (None,)]
    state = candidates[0]
    for index, other in enumerate(candidates[1:], start=1):
        state = tuple(jnp.where(start == index, new, old) for new, old in zip(other, state, strict=True))
    return state

"""The primitives of jax that move entries and leave them as they are: they are done while the kernel is written."""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from vibrojax.compile.kernels.operands import LANES, Untranslatable, Value, literals, without_lanes

Arranged = Callable[[Any, Sequence[Value]], list[Value]]
"""A rule: from an equation of a jaxpr and its arguments to its results."""


def _broadcast(equation: Any, values: Sequence[Value]) -> list[Value]:
    shape, axes = without_lanes(equation.params["shape"]), equation.params["broadcast_dimensions"]
    spread = [1] * len(shape)
    for axis, length in zip(axes, values[0].shape, strict=True):
        spread[axis] = length
    return [np.broadcast_to(values[0].reshape(spread), shape)]


def _reshaped(equation: Any, values: Sequence[Value]) -> list[Value]:
    before, after = equation.invars[0].aval.shape, equation.outvars[0].aval.shape
    if _entries_before_lanes(before) != _entries_before_lanes(after):
        raise Untranslatable("a shape that mixes lanes")
    return [values[0].reshape(without_lanes(after))]


def _entries_before_lanes(shape: tuple[int, ...]) -> int | None:
    """Return how many entries the axes before that of the lanes have; None if there are no lanes."""
    return math.prod(shape[: shape.index(LANES)]) if LANES in shape else None


def _refuse_lanes(equation: Any, axis: int, what: str) -> None:
    """Raise `Untranslatable` if an argument has its lanes along an axis."""
    if any(var.aval.shape[axis] == LANES for var in equation.invars):
        raise Untranslatable(what)


def _slice(equation: Any, values: Sequence[Value]) -> list[Value]:
    params, shape = equation.params, equation.invars[0].aval.shape
    strides = params["strides"] or [1] * len(shape)
    parts = []
    for length, start, end, stride in zip(
        shape, params["start_indices"], params["limit_indices"], strides, strict=True
    ):
        if length == LANES and (start, end, stride) != (0, LANES, 1):
            raise Untranslatable("some of the lanes")
        parts.append(slice(start, end, stride) if length != LANES else slice(None))
    return [values[0][tuple(parts)]]


def _concatenated(equation: Any, values: Sequence[Value]) -> list[Value]:
    axis = equation.params["dimension"]
    _refuse_lanes(equation, axis, "lanes beside lanes")
    return [np.concatenate(values, axis=axis)]


def _stacked(equation: Any, values: Sequence[Value]) -> list[Value]:
    return [np.stack(values, axis=equation.params["axis"])]


def _unstacked(equation: Any, values: Sequence[Value]) -> list[Value]:
    axis = equation.params["axis"]
    _refuse_lanes(equation, axis, "each lane by itself")
    return [np.take(values[0], [index], axis).squeeze(axis) for index in range(values[0].shape[axis])]


def _split(equation: Any, values: Sequence[Value]) -> list[Value]:
    ends, axis = np.cumsum(equation.params["sizes"])[:-1], equation.params["axis"]
    _refuse_lanes(equation, axis, "some of the lanes")
    return list(np.split(values[0], ends, axis=axis))


def _transposed(equation: Any, values: Sequence[Value]) -> list[Value]:
    return [values[0].transpose(equation.params["permutation"])]


def _reversed(equation: Any, values: Sequence[Value]) -> list[Value]:
    axes = equation.params["dimensions"]
    if any(equation.invars[0].aval.shape[axis] == LANES for axis in axes):
        raise Untranslatable("lanes in reverse")
    return [np.flip(values[0], axes)]


def _counted(equation: Any, values: Sequence[Value]) -> list[Value]:
    shape, axis, dtype = (equation.params[name] for name in ("shape", "dimension", "dtype"))
    if shape[axis] == LANES:
        raise Untranslatable("the numbers of lanes")
    along = [1] * len(shape)
    along[axis] = shape[axis]
    numbers = np.arange(shape[axis]).astype(dtype).reshape(along)
    return [literals(np.broadcast_to(numbers, without_lanes(shape)))]


def _as_they_are(equation: Any, values: Sequence[Value]) -> list[Value]:
    return list(values)


RULES: dict[str, Arranged] = {
    "broadcast_in_dim": _broadcast,
    "reshape": _reshaped,
    "squeeze": _reshaped,
    "slice": _slice,
    "concatenate": _concatenated,
    "stack": _stacked,
    "unstack": _unstacked,
    "split": _split,
    "transpose": _transposed,
    "rev": _reversed,
    "iota": _counted,
    "optimization_barrier": _as_they_are,
}

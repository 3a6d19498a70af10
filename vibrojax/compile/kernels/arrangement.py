"""Translation rules for primitives that rearrange array elements. These rules emit no instructions."""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from vibrojax.compile.kernels.operands import LANES, Untranslatable, Value, literals, without_lanes

ArrangementRule = Callable[[Any, Sequence[Value]], list[Value]]
"""A rule that takes an equation of a jaxpr and the equation's arguments, and returns the equation's results."""


def _broadcast(equation: Any, values: Sequence[Value]) -> list[Value]:
    shape, axes = without_lanes(equation.params["shape"]), equation.params["broadcast_dimensions"]
    spread = [1] * len(shape)
    for axis, length in zip(axes, values[0].shape, strict=True):
        spread[axis] = length
    return [np.broadcast_to(values[0].reshape(spread), shape)]


def _reshape(equation: Any, values: Sequence[Value]) -> list[Value]:
    before, after = equation.invars[0].aval.shape, equation.outvars[0].aval.shape
    if _entries_before_lanes(before) != _entries_before_lanes(after):
        raise Untranslatable("a shape that mixes lanes")
    return [values[0].reshape(without_lanes(after))]


def _entries_before_lanes(shape: tuple[int, ...]) -> int | None:
    """Return the number of array elements along the axes before the lane axis, or None if there is no lane axis."""
    return math.prod(shape[: shape.index(LANES)]) if LANES in shape else None


def _slice(equation: Any, values: Sequence[Value]) -> list[Value]:
    params, shape = equation.params, equation.invars[0].aval.shape
    ranges = zip(params["start_indices"], params["limit_indices"], params["strides"] or [1] * len(shape), strict=True)
    parts = []
    for length, (start, end, stride) in zip(shape, ranges, strict=True):
        if length == LANES and (start, end, stride) != (0, LANES, 1):
            raise Untranslatable("some of the lanes")
        parts.append(slice(start, end, stride) if length != LANES else slice(None))
    return [values[0][tuple(parts)]]


def _split(equation: Any, values: Sequence[Value]) -> list[Value]:
    return list(np.split(values[0], np.cumsum(equation.params["sizes"])[:-1], equation.params["axis"]))


def _unstack(equation: Any, values: Sequence[Value]) -> list[Value]:
    axis = equation.params["axis"]
    return [np.take(values[0], [index], axis).squeeze(axis) for index in range(values[0].shape[axis])]


def _count(equation: Any, values: Sequence[Value]) -> list[Value]:
    shape, axis, dtype = (equation.params[name] for name in ("shape", "dimension", "dtype"))
    if shape[axis] == LANES:
        raise Untranslatable("the numbers of lanes")
    along = [1] * len(shape)
    along[axis] = shape[axis]
    numbers = np.arange(shape[axis]).astype(dtype).reshape(along)
    return [literals(np.broadcast_to(numbers, without_lanes(shape)))]


def arrange(equation: Any, values: Sequence[Value]) -> list[Value]:
    """Return the results of an equation, or raise `Untranslatable` if the equation moves lanes."""
    name, params = equation.primitive.name, equation.params
    axes = np.atleast_1d(params[MOVED_AXES[name]]) if name in MOVED_AXES else ()
    if any(var.aval.shape[axis] == LANES for var in equation.invars for axis in axes):
        raise Untranslatable(f"{name} along the lanes")
    return RULES[name](equation, values)


MOVED_AXES = {"concatenate": "dimension", "unstack": "axis", "split": "axis", "rev": "dimensions"}
"""Parameter of each primitive that holds the axes along which array elements move."""

RULES: dict[str, ArrangementRule] = {
    "broadcast_in_dim": _broadcast,
    "reshape": _reshape,
    "squeeze": _reshape,
    "slice": _slice,
    "concatenate": lambda equation, values: [np.concatenate(values, equation.params["dimension"])],
    "stack": lambda equation, values: [np.stack(values, equation.params["axis"])],
    "unstack": _unstack,
    "split": _split,
    "transpose": lambda equation, values: [values[0].transpose(equation.params["permutation"])],
    "rev": lambda equation, values: [np.flip(values[0], equation.params["dimensions"])],
    "iota": _count,
    "optimization_barrier": lambda equation, values: list(values),
}

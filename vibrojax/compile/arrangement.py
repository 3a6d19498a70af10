"""Translation rules for primitives that rearrange array elements. These rules emit no instructions."""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from vibrojax.compile.assembly import LANES, Operand, Value, literals, refuse_if, without_lanes


def _broadcast(equation: Any, x: Value) -> Value:
    shape = without_lanes(equation.params["shape"])
    spread = [1] * len(shape)
    for axis, length in zip(equation.params["broadcast_dimensions"], x.shape, strict=True):
        spread[axis] = length
    return np.broadcast_to(x.reshape(spread), shape)


def _reshape(equation: Any, x: Value) -> Value:
    before, after = equation.invars[0].aval.shape, equation.outvars[0].aval.shape
    # The array elements along the axes before the lane axis; None without a lane axis.
    rows = [math.prod(shape[: shape.index(LANES)]) if LANES in shape else None for shape in (before, after)]
    refuse_if(rows[0] != rows[1], "a shape that mixes lanes")
    return x.reshape(without_lanes(after))


def _slice(equation: Any, x: Value) -> Value:
    params, shape = equation.params, equation.invars[0].aval.shape
    ranges = zip(params["start_indices"], params["limit_indices"], params["strides"] or [1] * len(shape), strict=True)
    parts = []
    for length, (start, end, stride) in zip(shape, ranges, strict=True):
        refuse_if(length == LANES and (start, end, stride) != (0, LANES, 1), "some of the lanes")
        parts.append(slice(start, end, stride) if length != LANES else slice(None))
    return x[tuple(parts)]


def _dynamic_slice(equation: Any, x: Value, *starts: Value) -> Value:
    """Return consecutive rows. The number of the first row must be a compile-time constant."""
    shapes = equation.invars[0].aval.shape, equation.params["slice_sizes"]
    refuse_if((LANES in shapes[0]) != (LANES in shapes[1]), "some of the lanes")
    parts = []
    for length, size, start in zip(*map(without_lanes, shapes), starts, strict=True):
        entry, first = start.item(), 0
        if size != length:
            known = isinstance(entry, Operand) and entry.is_literal
            refuse_if(not known, "rows from a number on that is not known beforehand")
            first = min(max(int(entry.text), 0), length - size)
        parts.append(slice(first, first + size))
    return x[tuple(parts)]


def _iota(equation: Any) -> Value:
    shape, axis, dtype = (equation.params[name] for name in ("shape", "dimension", "dtype"))
    refuse_if(shape[axis] == LANES, "the numbers of lanes")
    numbers = np.arange(shape[axis]).astype(dtype).reshape([-1 if other == axis else 1 for other in range(len(shape))])
    return literals(np.broadcast_to(numbers, without_lanes(shape)))


def _unstack(equation: Any, x: Value) -> list[Value]:
    axis = equation.params["axis"]
    return [np.take(x, [index], axis).squeeze(axis) for index in range(x.shape[axis])]


def arrange(equation: Any, values: Sequence[Value]) -> list[Value]:
    """Return the results of an equation, or raise `Untranslatable` if the equation moves lanes."""
    name, params = equation.primitive.name, equation.params
    axes = np.atleast_1d(params[MOVED_AXES[name]]) if name in MOVED_AXES else ()
    moved = any(var.aval.shape[axis] == LANES for var in equation.invars for axis in axes)
    refuse_if(moved, f"{name} along the lanes")
    results = RULES[name](equation, *values)
    return results if isinstance(results, list) else [results]


MOVED_AXES = {"concatenate": "dimension", "unstack": "axis", "split": "axis", "rev": "dimensions"}
"""Parameter of each primitive that holds the axes along which array elements move."""

RULES: dict[str, Callable[..., Value | list[Value]]] = {
    "broadcast_in_dim": _broadcast,
    "reshape": _reshape,
    "squeeze": _reshape,
    "slice": _slice,
    "dynamic_slice": _dynamic_slice,
    "concatenate": lambda equation, *values: np.concatenate(values, equation.params["dimension"]),
    "stack": lambda equation, *values: np.stack(values, equation.params["axis"]),
    "unstack": _unstack,
    "split": lambda equation, x: np.split(x, np.cumsum(equation.params["sizes"])[:-1], equation.params["axis"]),
    "transpose": lambda equation, x: x.transpose(equation.params["permutation"]),
    "rev": lambda equation, x: np.flip(x, equation.params["dimensions"]),
    "iota": _iota,
    "optimization_barrier": lambda equation, *values: list(values),
}
"""Rules that take an equation of a jaxpr and its arguments, and return its result or the list of its results."""

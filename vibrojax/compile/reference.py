"""Values of a traced function, computed one instruction at a time without any code of the kernels.

XLA compiles a program for each kind of instruction, which takes far longer than to run it. numpy therefore evaluates
the instructions whose results are determined to the last bit: arithmetic that IEEE 754 rounds correctly, comparisons,
choices, and arrangements of array elements. XLA evaluates all others. The tests compare both.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

CALLS = {"jit": "jaxpr", "custom_jvp_call": "call_jaxpr", "custom_vjp_call": "call_jaxpr"}
"""Primitives that call a function, and the parameter that holds the function's jaxpr."""


def evaluate(closed: Any, *arguments: Any) -> list[Any]:
    """Return the results of a closed jaxpr for arrays with the types of its arguments."""
    jaxpr = closed.jaxpr
    known = dict(zip((*jaxpr.constvars, *jaxpr.invars), (*closed.consts, *arguments), strict=True))
    for equation in jaxpr.eqns:
        name, rule = equation.primitive.name, RULES.get(equation.primitive.name)
        values = [np.asarray(x.val, x.aval.dtype) if hasattr(x, "val") else known[x] for x in equation.invars]
        if name in CALLS:
            results = evaluate(equation.params[CALLS[name]], *values)
        elif name == "scan" and "num_consts" in equation.params:  # other versions of jax describe loops otherwise
            results = _scan(equation, values)
        elif rule is not None and _is_exact(equation):
            with np.errstate(all="ignore"):
                result = rule(equation.params, *values)
            results = result if equation.primitive.multiple_results else [result]
        else:
            results = _by_xla(equation, values)
        known |= dict(zip(equation.outvars, results, strict=True))
    return [np.asarray(x.val, x.aval.dtype) if hasattr(x, "val") else known[x] for x in jaxpr.outvars]


def _scan(equation: Any, values: Sequence[Any]) -> list[Any]:
    """Return the results of a loop over the first axis of some arguments, see `jax.lax.scan`."""
    params = equation.params
    fixed, last = params["num_consts"], params["num_consts"] + params["num_carry"]
    carry, rows = list(values[fixed:last]), []
    for row in sorted(range(params["length"]), reverse=params["reverse"]):
        results = evaluate(params["jaxpr"], *values[:fixed], *carry, *(np.asarray(x)[row] for x in values[last:]))
        carry = results[: params["num_carry"]]
        rows.append(results[params["num_carry"] :])
    rows = rows[::-1] if params["reverse"] else rows
    if not rows:
        return [*carry, *(np.zeros(var.aval.shape, var.aval.dtype) for var in equation.outvars[len(carry) :])]
    return [*carry, *map(np.stack, zip(*rows, strict=True))]


def _by_xla(equation: Any, values: Sequence[Any]) -> list[Any]:
    """Return the results of one equation of a jaxpr for given arguments."""
    primitive = equation.primitive
    results = primitive.bind(*values, **primitive.get_bind_params(equation.params))
    return list(map(np.asarray, results if primitive.multiple_results else [results]))


def _is_exact(equation: Any) -> bool:
    """Return whether numpy's result has the bits of XLA's, given that numpy has a rule for the primitive."""
    name, types = equation.primitive.name, [var.aval.dtype for var in (*equation.invars, *equation.outvars)]
    if any(not isinstance(x, np.dtype) or x not in EXACT_TYPES for x in types):
        return False
    first, kind = types[0], types[-1].kind
    if name == "convert_element_type":
        return first.kind != "f" or kind == "f"  # what becomes of NaN as an integer is undefined
    if name == "bitcast_convert_type":
        return first.itemsize == types[-1].itemsize
    if name in BITS_ONLY:
        return kind == "b"
    if name == "select_n":
        return first.kind == "b" and len(equation.invars) == 3
    return name not in FLOATS_ONLY or first.kind == "f"


EXACT_TYPES = {*map(np.dtype, ("float64", "float32", "int64", "int32", "uint64", "uint32", "bool"))}
"""Types with which numpy computes like XLA."""

FLOATS_ONLY = ("div", "rem", "abs", "neg", "sqrt", "floor", "ceil", "is_finite")
"""Primitives for whose integers numpy has other results or types."""


BITS_ONLY = ("reduce_and", "reduce_or")
"""Primitives whose rules are those of booleans."""


def _of(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return the rule of a primitive that is a function of numpy."""
    return lambda params, *x: function(*x)


def _broadcast(params: Any, x: Any) -> Any:
    lengths = dict(zip(params["broadcast_dimensions"], np.shape(x), strict=True))
    spread = np.reshape(x, [lengths.get(axis, 1) for axis in range(len(params["shape"]))])
    return np.broadcast_to(spread, params["shape"])


def _slice(params: Any, x: Any) -> Any:
    strides = params["strides"] or (1,) * np.ndim(x)
    return x[tuple(map(slice, params["start_indices"], params["limit_indices"], strides))]


def _iota(params: Any) -> Any:
    shape, axis = params["shape"], params["dimension"]
    numbers = np.arange(shape[axis], dtype=params["dtype"])
    return np.broadcast_to(numbers.reshape([-1 if k == axis else 1 for k in range(len(shape))]), shape)


RULES: dict[str, Callable[..., Any]] = {
    "add": _of(np.add),
    "sub": _of(np.subtract),
    "mul": _of(np.multiply),
    "div": _of(np.divide),
    "rem": _of(np.fmod),
    "neg": _of(np.negative),
    "abs": _of(np.abs),
    "sqrt": _of(np.sqrt),
    "floor": _of(np.floor),
    "ceil": _of(np.ceil),
    "max": _of(np.maximum),
    "min": _of(np.minimum),
    "is_finite": _of(np.isfinite),
    "eq": _of(np.equal),
    "ne": _of(np.not_equal),
    "lt": _of(np.less),
    "le": _of(np.less_equal),
    "gt": _of(np.greater),
    "ge": _of(np.greater_equal),
    "and": _of(np.bitwise_and),
    "or": _of(np.bitwise_or),
    "xor": _of(np.bitwise_xor),
    "not": _of(np.invert),
    "select_n": _of(lambda which, no, yes: np.where(which, yes, no)),
    "convert_element_type": lambda params, x: np.asarray(x).astype(params["new_dtype"]),
    "broadcast_in_dim": _broadcast,
    "slice": _slice,
    "squeeze": lambda params, x: np.squeeze(x, tuple(params["dimensions"])),
    "reshape": lambda params, x: np.reshape(x, params["new_sizes"]),
    "transpose": lambda params, x: np.transpose(x, params["permutation"]),
    "concatenate": lambda params, *x: np.concatenate(x, params["dimension"]),
    "stack": lambda params, *x: np.stack(x, params["axis"]),
    "optimization_barrier": lambda params, *x: list(x),
    "reduce_and": lambda params, x: np.all(x, tuple(params["axes"])),
    "reduce_or": lambda params, x: np.any(x, tuple(params["axes"])),
    "iota": _iota,
    "bitcast_convert_type": lambda params, x: np.asarray(x).view(params["new_dtype"]),
    "stop_gradient": lambda params, x: x,
}
"""Rules that take the parameters and arguments of an equation, and return its result or the list of its results."""

"""Numerical agreement of a kernel with XLA, and of compiled elementary functions with numpy.

XLA evaluates the same function one instruction at a time, for all lanes at once, without any code of the kernels. This
takes about a second; compiling the function as one XLA program would take about ten. XLA compiles a program for each
kind of instruction, which takes far longer than to run it. numpy therefore evaluates the instructions whose results are
determined to the last bit: arithmetic that IEEE 754 rounds correctly, comparisons, choices, and arrangements of array
elements. The tests compare both.

Rounding errors differ between kernel and XLA, and are amplified near a switch between modes or by cancellation. The
kernel is therefore also run on arguments that are perturbed by a few units of rounding. A difference from XLA counts
only if it is large compared with the changes that these perturbations cause.
"""

from collections.abc import Callable, Sequence
from functools import cache
from inspect import signature
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from vibrojax.compile.assembly import LANES
from vibrojax.compile.control import CALLS, called
from vibrojax.compile.native import Kernel, trace
from vibrojax.errors import InputError
from vibrojax.lazy import jax

AGREEMENT_TOLERANCE = {"float64": 1e-10, "float32": 1e-4}
"""Accepted difference, relative to the largest value in all compared lanes."""

PERTURBATION_ROUNDINGS = 16
"""Size of the perturbation of the arguments, in units of the relative rounding error (machine epsilon)."""

PERTURBED_COPIES = 16
"""Number of perturbed copies of the arguments. A comparison whose outcome is determined by rounding error almost surely
has the other outcome in at least one of 16 copies."""

COPIES_WITH_ZEROS = 8
"""Number of further copies in which zeros and rounding errors among other values are perturbed, such as a velocity that
a surface holds, or that has decayed."""

DERIVATIVE = "derivative"
"""Part of the names of results that are derivatives."""

AMPLIFICATION_LIMIT = 100.0
"""Largest accepted ratio of a difference to the change that the perturbation causes."""

USUAL_QUANTILE = 0.9
"""Quantile over lanes that defines the typical change under perturbation. A single lane may by chance not change."""


class Difference(NamedTuple):
    """A difference between kernel and XLA: name of the quantity, and difference relative to its largest value."""

    quantity: str
    relative: float


def take_lanes(arguments: Any, lanes: np.ndarray) -> Any:
    """Return the arguments at the lane indices `lanes`; scalars are returned unchanged."""
    return jax.tree.map(lambda x: np.take(x, lanes, axis=-1) if np.ndim(x) else x, arguments)


def first_difference(function: Callable[..., Any], kernel: Kernel, *arguments: Any) -> Difference | None:
    """Return the first result in which `kernel`, compiled from `function`, differs from XLA, or None if they agree."""
    lanes = max(np.shape(x)[-1] for x in jax.tree.leaves(arguments) if np.ndim(x))
    arguments = take_lanes(arguments, np.resize(np.arange(lanes), LANES))  # a trace has this many lanes
    by_kernel = jax.tree_util.tree_flatten_with_path(kernel(*arguments))[0]
    random = np.random.default_rng(0)
    changes = [np.zeros(value.shape) for _, value in by_kernel]
    for zeros, copies in ((False, PERTURBED_COPIES), (True, COPIES_WITH_ZEROS)):
        tiled = jax.tree.map(lambda x, copies=copies: np.tile(x, copies) if np.ndim(x) else x, arguments)
        perturbed = jax.tree.map(lambda x, zeros=zeros: _perturb(x, random, zeros), tiled)
        results = jax.tree.leaves(kernel(*perturbed))
        for k, ((path, value), result) in enumerate(zip(by_kernel, results, strict=True)):
            # At a zero, a derivative is that of one side.
            if not zeros or DERIVATIVE not in jax.tree_util.keystr(path):
                changes[k] = np.asarray(np.maximum(changes[k], _greatest_distance(value, result, copies)))
    traced = trace(function, *arguments).jaxpr
    variables = traced.jaxpr.invars
    leaves = [np.asarray(x, var.aval.dtype) for x, var in zip(jax.tree.leaves(arguments), variables, strict=True)]
    with jax.debug_nans(False):  # features of lanes without a section crossing are NaN
        by_xla = reference_values(traced, *leaves)
    for (path, value), other, change in zip(by_kernel, by_xla, changes, strict=True):
        relative = _relative_difference(value, np.asarray(other), change)
        if relative > 0:
            return Difference(jax.tree_util.keystr(path).strip("."), relative)
    return None


def _greatest_distance(value: np.ndarray, result: np.ndarray, copies: int) -> np.ndarray:
    """Return the greatest |result - value| in copies of the lanes, which follow one another in `result`."""
    if result.shape == value.shape:  # the same for all lanes
        return _distance(value, result)
    each = result.reshape(*value.shape[:-1], copies, value.shape[-1])
    return np.asarray(_distance(value[..., None, :], each).max(axis=-2))


def _perturb(x: Any, random: np.random.Generator, zeros: bool) -> Any:
    """Return numbers perturbed by a few units of rounding. Integer values are modes and counts and stay unchanged.

    `zeros`: whether a zero in a row of other values is perturbed too, by the rounding errors of these values, and a
    value as small as these errors, such as that of a motion that has come to rest.
    """
    x = np.asarray(x)
    if x.dtype.kind != "f" or not x.ndim:
        return x
    with np.errstate(invalid="ignore"):
        finite = np.isfinite(x)
        size = np.where(x == np.round(x), 0, PERTURBATION_ROUNDINGS * x)
        if zeros:
            row = np.where(finite, np.abs(x), 0).max(axis=-1, keepdims=True, initial=0)
            measured = (finite & (x != np.round(x))).any(axis=-1, keepdims=True)
            noise = np.abs(x) <= PERTURBATION_ROUNDINGS * np.finfo(x.dtype).eps * row
            size = np.where(noise, row * measured, size)
        off = x + size * np.finfo(x.dtype).eps * random.uniform(-1, 1, x.shape)
        return np.where(finite, off, x).astype(x.dtype)


def _relative_difference(value: np.ndarray, other: np.ndarray, change: np.ndarray) -> float:
    """Return the largest difference above its limit, relative to the largest value in its row, or 0 if there is none.

    **Arguments:**

    - `value`: result of the kernel.
    - `other`: result of XLA.
    - `change`: largest change of the kernel's result under perturbation of the arguments.
    """
    distance = _distance(value, other)
    if value.dtype.kind != "f":
        return float(np.max(np.where(change > 0, 0, distance), initial=0))
    limits, sizes = np.finfo(value.dtype), np.where(np.isfinite(value), np.abs(value), 0)
    least, axis = limits.tiny / limits.eps, -1 if value.ndim else None
    scale = np.max(sizes, axis=axis, keepdims=True, initial=least)
    usual = np.quantile(change, USUAL_QUANTILE, axis=axis, keepdims=True, method="higher")
    by_change = AMPLIFICATION_LIMIT * np.maximum(change, usual)
    accepted = np.maximum(AGREEMENT_TOLERANCE[value.dtype.name] * scale, by_change)
    with np.errstate(invalid="ignore", divide="ignore"):
        return float(np.max(np.where(distance > accepted, distance / scale, 0), initial=0))


def _distance(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return |x - y|.

    For floats: 0 if equal or both NaN, infinity if they differ and either is not finite. For other types: 0 if equal,
    else 1.
    """
    if x.dtype.kind != "f":
        return (x != y).astype(float)
    with np.errstate(invalid="ignore", over="ignore"):
        same = (x == y) | (np.isnan(x) & np.isnan(y))
        return np.where(same, 0, np.where(np.isfinite(x) & np.isfinite(y), np.abs(x - y), np.inf))


def reference_values(closed: Any, *arguments: Any) -> list[Any]:
    """Return the results of a closed jaxpr for arrays with the types of its arguments."""
    jaxpr = closed.jaxpr
    known = dict(zip((*jaxpr.constvars, *jaxpr.invars), (*closed.consts, *arguments), strict=True))
    for equation in jaxpr.eqns:
        name, rule = equation.primitive.name, EXACT_RULES.get(equation.primitive.name)
        values = [np.asarray(x.val, x.aval.dtype) if hasattr(x, "val") else known[x] for x in equation.invars]
        if name in CALLS:
            results = reference_values(called(equation), *values)
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
        results = reference_values(
            params["jaxpr"], *values[:fixed], *carry, *(np.asarray(x)[row] for x in values[last:])
        )
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
    if not EXACT_TYPES.issuperset(types):
        return False
    if name == "convert_element_type":
        return types[0].kind != "f" or types[-1].kind == "f"  # what becomes of NaN as an integer is undefined
    return types[0].kind != "i" or name not in NOT_OF_INTEGERS


EXACT_TYPES = {*map(np.dtype, ("float64", "float32", "int64", "int32", "bool"))}
"""Types with which numpy computes like XLA."""

NOT_OF_INTEGERS = (
    "div",
    "rem",
    "abs",
    "neg",
    "sqrt",
    "floor",
    "ceil",
    "is_finite",
    "select_n",
    "reduce_and",
    "reduce_or",
)
"""Primitives for whose integers, or choices by integers, numpy has other results or types."""


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


EXACT_RULES: dict[str, Callable[..., Any]] = {
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
    "stop_gradient": lambda params, x: x,
}
"""Rules that take the parameters and arguments of an equation, and return its result or the list of its results."""


ELEMENTARY_ROUNDINGS = 4
"""Error tolerance in units of machine epsilon times max(1, |value|). numpy's own functions err by up to one unit."""

Evaluate = Callable[..., Any]
"""`evaluate(function, *arrays)` compiles a function like any function of lanes and returns its results."""

Functions = tuple[Callable[..., Any], ...]
"""Elementary functions. Each is compared with numpy's function of the same name."""


@cache
def check(evaluate: Evaluate, functions: Functions, compiler: str, dtype: np.dtype, lanes: int) -> None:
    """Compare functions with numpy, `lanes` values at a time, once per process.

    **Raises:** `InputError` if a function is wrong. The message contains `compiler` (package and version).
    """
    wrong = wrong_functions(evaluate, functions, dtype, lanes)
    if wrong:
        raise InputError(
            f"{compiler} computes {' and '.join(wrong)} wrongly on this machine, {lanes} values of {dtype} at a time: "
            f"nothing was computed; install another version of {compiler.split()[0]}"
        )


def wrong_functions(evaluate: Evaluate, functions: Functions, dtype: np.dtype, lanes: int) -> list[str]:
    """Return the names of functions whose error exceeds `ELEMENTARY_ROUNDINGS`.

    Each function is evaluated at `lanes` numbers of both signs, with magnitudes from 2^-10 to 2^5. Its results are
    compared wherever numpy's value is finite.
    """
    x = np.geomspace(2.0**-10, 2.0**5, lanes).astype(dtype)
    x[: lanes // 2] *= -1
    arguments = (x, np.abs(x[::-1]))
    counts = {function.__name__: len(signature(function).parameters) for function in functions}

    def evaluate_all(*arrays: "Float[jax.Array, ' lanes']") -> "dict[str, jax.Array]":
        return {function.__name__: function(*arrays[: counts[function.__name__]]) for function in functions}

    values = evaluate(evaluate_all, *arguments)  # NaN where functions are undefined for negative numbers
    wrong = []
    for name, count in counts.items():
        with np.errstate(all="ignore"):
            exact = getattr(np, name)(*(array.astype(np.float64) for array in arguments[:count]))
        known = np.isfinite(exact)
        error = np.abs(np.asarray(values[name], np.float64) - exact)[known]
        accepted = ELEMENTARY_ROUNDINGS * np.finfo(x.dtype).eps * np.maximum(1, np.abs(exact[known]))
        if not np.all(error <= accepted):
            wrong.append(name)
    return wrong

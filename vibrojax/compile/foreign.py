"""Instructions of foreign code in a trace: whether the tests vouch for their translation.

Each instruction of a trace is translated by itself. The tests compare the translation of arithmetic, comparisons,
choices, elementary functions and arrangements of elements with XLA (`tests/kernels`). A foreign law or field that uses
nothing else therefore needs no comparison of its own. Indices that depend on values, sums over arrays, loops and
branches do: their translation depends on what surrounds them.

jax records the Python calls from which an instruction came. Its author is the innermost of them outside of jax.
"""

import functools
import os
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from vibrojax.lazy import jax

TESTED = frozenset(
    ("add", "sub", "mul", "div", "neg", "abs", "sign", "max", "min", "integer_pow", "square", "pow", "sqrt", "floor")
    + ("exp", "log", "sin", "cos", "tan", "tanh", "atan", "lt", "gt", "le", "ge", "eq", "ne", "and", "or", "not")
    + ("select_n", "convert_element_type", "is_finite", "stop_gradient", "copy", "add_any", "optimization_barrier")
    + ("broadcast_in_dim", "concatenate", "reshape", "slice", "squeeze", "stack", "transpose")
)
"""Primitives whose translation the tests compare with XLA, for numbers of `TESTED_TYPES`."""

TESTED_TYPES = frozenset(map(np.dtype, ("float64", "float32", "bool")))

CALLS = ("jit", "custom_jvp_call", "custom_vjp_call")
"""Primitives that call a function. jax caches the trace of a function, which may have had another caller."""


def needs_comparison(jaxpr: Any, foreign: bool = True) -> bool:
    """Return whether a trace has an instruction of foreign code that is not a tested one.

    `foreign`: whether instructions without an author are foreign. In a function that jax traces by itself, only its
    call has an author.
    """
    for equation in jaxpr.eqns:
        inner = _functions(equation)
        if _is_tested(equation, inner):
            continue
        author = _author(equation)
        others = not author.startswith(_folders()[0]) if author else foreign
        if (others and equation.primitive.name not in CALLS) or any(needs_comparison(x, others) for x in inner):
            return True
    return False


def _functions(equation: Any) -> list[Any]:
    """Return the traces of the functions that an equation calls."""
    parts = [x for value in equation.params.values() for x in (value if isinstance(value, tuple) else (value,))]
    return [getattr(x, "jaxpr", x) for x in parts if hasattr(getattr(x, "jaxpr", x), "eqns")]


def _is_tested(equation: Any, inner: list[Any]) -> bool:
    if equation.primitive.name in CALLS:
        return all(_is_tested(x, _functions(x)) for jaxpr in inner for x in jaxpr.eqns)
    numbers = all(x.aval.dtype in TESTED_TYPES for x in (*equation.invars, *equation.outvars))
    return numbers and equation.primitive.name in TESTED


def _author(equation: Any) -> str:
    """Return the file that wrote an equation, or an empty text if jax did not record it."""
    skipped = _folders()[1]
    frames = getattr(equation.source_info.traceback, "frames", ())
    return next((x.file_name for x in frames if not x.file_name.startswith(skipped)), "")


@cache
def _folders() -> tuple[str, tuple[str, ...]]:
    """Return this package's folder, and what may stand between an author and an instruction."""
    import jaxlib

    libraries = (str(Path(str(x.__file__)).parent) + os.sep for x in (jax, jaxlib))
    return str(Path(__file__).parents[1]) + os.sep, (*libraries, functools.__file__)

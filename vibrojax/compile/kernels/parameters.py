"""Parameters of jax's primitives that the translation knows, with the values it accepts.

A later jax may add a parameter, or a value of one, that changes a meaning. Both raise `Untranslatable`, so that XLA
runs the lanes.
"""

from collections.abc import Callable, Mapping
from typing import Any

from jax.lax import GatherScatterMode, RoundingMethod

from vibrojax.compile.kernels.operands import Untranslatable

Accepts = Callable[[Any], bool]
Table = dict[str, dict[str, Accepts]]


def _any(value: Any) -> bool:
    return True


def _none(value: Any) -> bool:
    return value is None


def _empty(value: Any) -> bool:
    return len(value) == 0


MODES = (GatherScatterMode.CLIP, GatherScatterMode.FILL_OR_DROP, GatherScatterMode.PROMISE_IN_BOUNDS)
TRANSCENDENTAL = ("cbrt", "cos", "erf", "erfc", "exp", "exp2", "expm1", "log", "log1p", "sin", "sqrt", "tan", "tanh")
INVERSE = ("acos", "acosh", "asin", "asinh", "atan", "atan2", "atanh", "cosh", "sinh")
REDUCTIONS = ("reduce_and", "reduce_max", "reduce_min", "reduce_or", "reduce_prod", "reduce_sum")

NEEDED: Table = {
    "bitcast_convert_type": {"new_dtype": _any},
    "broadcast_in_dim": {"shape": _any, "broadcast_dimensions": _any},
    "concatenate": {"dimension": _any},
    "cond": {"branches": _any},
    "convert_element_type": {"new_dtype": _any},
    "custom_jvp_call": {"call_jaxpr": _any},
    "custom_vjp_call": {"call_jaxpr": _any},
    "dynamic_slice": {"slice_sizes": _any},
    "gather": {"dimension_numbers": _any, "mode": lambda mode: mode in MODES, "fill_value": _any},
    "integer_pow": {"y": lambda y: isinstance(y, int)},
    "iota": {"dtype": _any, "shape": _any, "dimension": _any},
    "jit": {"jaxpr": _any},
    **{name: {"axes": _any} for name in REDUCTIONS},
    "reshape": {"new_sizes": _any, "dimensions": _none},
    "rev": {"dimensions": _any},
    "round": {"rounding_method": lambda how: how in (RoundingMethod.AWAY_FROM_ZERO, RoundingMethod.TO_NEAREST_EVEN)},
    "scan": {"jaxpr": _any, "length": _any, "reverse": lambda reverse: isinstance(reverse, bool)},
    "scatter": {
        "dimension_numbers": _any,
        "mode": lambda mode: mode in MODES,
        "update_jaxpr": _none,
        "update_consts": _empty,
    },
    "slice": {"start_indices": _any, "limit_indices": _any, "strides": _any},
    "sort": {"dimension": _any, "num_keys": _any},
    "split": {"sizes": _any, "axis": _any},
    "squeeze": {"dimensions": _any},
    "stack": {"axis": _any},
    "transpose": {"permutation": _any},
    "unstack": {"axis": _any},
    "while": {"cond_nconsts": _any, "cond_jaxpr": _any, "body_nconsts": _any, "body_jaxpr": _any},
}
"""Parameters that a rule reads: without one of them the rule does not know what to do."""

IRRELEVANT: Table = {
    **{name: {"accuracy": _none} for name in (*TRANSCENDENTAL, *INVERSE)},
    **{name: {"out_sharding": _none} for name in REDUCTIONS},
    "broadcast_in_dim": {"sharding": _none},
    "convert_element_type": {"sharding": _none, "weak_type": _any},
    "custom_jvp_call": dict.fromkeys(("jvp_jaxpr_fun", "num_consts", "symbolic_zeros"), _any),
    "custom_vjp_call": dict.fromkeys(("bwd", "fwd_jaxpr_thunk", "num_consts", "out_trees", "symbolic_zeros"), _any),
    "gather": dict.fromkeys(("indices_are_sorted", "slice_sizes", "unique_indices"), _any),
    "iota": {"sharding": _none},
    "jit": {
        **dict.fromkeys(("ctx_mesh", "donated_invars", "inline", "keep_unused", "name"), _any),
        **dict.fromkeys(("in_layouts", "in_shardings", "out_layouts", "out_shardings"), _any),
        "compiler_options_kvs": _empty,
    },
    "mul": {"out_dtype": _none},
    "reshape": {"sharding": _none},
    "scan": dict.fromkeys(("_split_transpose", "ft_in", "ft_out", "linear", "num_carry", "num_consts", "unroll"), _any),
    "scatter": dict.fromkeys(("indices_are_sorted", "unique_indices"), _any),
    "sort": {"is_stable": _any},
}
"""Parameters that change nothing in a kernel, as long as they have an accepted value. They may be absent."""


def check(primitive: str, params: Mapping[str, Any]) -> None:
    """Raise `Untranslatable` for a parameter that the translation does not know, and for a value it does not accept."""
    needed = NEEDED.get(primitive, {})
    known = IRRELEVANT.get(primitive, {}) | needed
    for name, value in params.items():
        if name not in known:
            raise Untranslatable(f"{primitive} with the unknown parameter {name}")
        if not known[name](value):
            raise Untranslatable(f"{primitive} with {name} = {value}")
    for name in needed:
        if name not in params:
            raise Untranslatable(f"{primitive} without the parameter {name}")

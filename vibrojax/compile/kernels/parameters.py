"""Parameters of jax's primitives that the translation supports, and their accepted values.

A later version of jax may add a parameter, or a value of a parameter, that changes the meaning of a primitive. Unknown
parameters and values raise `Untranslatable`, and XLA runs the lanes.
"""

from collections.abc import Callable, Mapping
from typing import Any

from jax.lax import GatherScatterMode

from vibrojax.compile.kernels.elementwise import INTRINSICS, LIBRARY, ROUNDING
from vibrojax.compile.kernels.operands import Untranslatable
from vibrojax.compile.kernels.selection import REDUCTIONS

JIT_OPTIONS = (
    "ctx_mesh donated_invars inline keep_unused name in_layouts in_shardings out_layouts out_shardings "
    "compiler_options_kvs"
)

PARAMETERS: dict[str, tuple[str, str]] = {
    **dict.fromkeys((*INTRINSICS, *LIBRARY), ("", "accuracy")),
    **dict.fromkeys(REDUCTIONS, ("axes", "out_sharding")),
    "bitcast_convert_type": ("new_dtype", ""),
    "broadcast_in_dim": ("shape broadcast_dimensions", "sharding"),
    "concatenate": ("dimension", ""),
    "cond": ("branches", ""),
    "convert_element_type": ("new_dtype", "sharding weak_type"),
    "custom_jvp_call": ("call_jaxpr", "jvp_jaxpr_fun num_consts symbolic_zeros"),
    "custom_vjp_call": ("call_jaxpr", "bwd fwd_jaxpr_thunk num_consts out_trees symbolic_zeros"),
    "dynamic_slice": ("slice_sizes", ""),
    "gather": ("dimension_numbers mode fill_value", "indices_are_sorted slice_sizes unique_indices"),
    "integer_pow": ("y", ""),
    "iota": ("dtype shape dimension", "sharding"),
    "jit": ("jaxpr", JIT_OPTIONS),
    "mul": ("", "out_dtype"),
    "reshape": ("new_sizes dimensions", "sharding"),
    "rev": ("dimensions", ""),
    "round": ("rounding_method", ""),
    "scan": ("jaxpr length reverse", "_split_transpose ft_in ft_out linear num_carry num_consts unroll"),
    "scatter": ("dimension_numbers mode update_jaxpr update_consts", "indices_are_sorted unique_indices"),
    "slice": ("start_indices limit_indices strides", ""),
    "sort": ("dimension num_keys", "is_stable"),
    "split": ("sizes axis", ""),
    "squeeze": ("dimensions", ""),
    "stack": ("axis", ""),
    "transpose": ("permutation", ""),
    "unstack": ("axis", ""),
    "while": ("cond_nconsts cond_jaxpr body_nconsts body_jaxpr", ""),
}
"""Two groups of parameters of each primitive. The first group is read by the rule and must be present. The second group
has no effect in a kernel, provided that the values are accepted, and may be absent."""

NONE = ("accuracy", "out_dtype", "out_sharding", "sharding", "update_jaxpr", "reshape.dimensions")
MODES = (GatherScatterMode.CLIP, GatherScatterMode.FILL_OR_DROP, GatherScatterMode.PROMISE_IN_BOUNDS)

ACCEPTED: dict[str, Callable[[Any], bool]] = {
    **dict.fromkeys(NONE, lambda value: value is None),
    **dict.fromkeys(("compiler_options_kvs", "update_consts"), lambda value: len(value) == 0),
    "mode": lambda mode: mode in MODES,
    "reverse": lambda reverse: isinstance(reverse, bool),
    "rounding_method": lambda method: method in ROUNDING,
    "y": lambda exponent: isinstance(exponent, int),
}
"""Predicates that accept a value, by `parameter` or `primitive.parameter`. Other parameters may have any value."""


def check(primitive: str, params: Mapping[str, Any]) -> None:
    """Raise `Untranslatable` if a parameter is unknown or missing, or if its value is not accepted."""
    needed, irrelevant = (names.split() for names in PARAMETERS.get(primitive, ("", "")))
    for name, value in params.items():
        if name not in needed and name not in irrelevant:
            raise Untranslatable(f"{primitive} with the unknown parameter {name}")
        accepts = ACCEPTED.get(f"{primitive}.{name}") or ACCEPTED.get(name)
        if accepts is not None and not accepts(value):
            raise Untranslatable(f"{primitive} with {name} = {value}")
    for name in needed:
        if name not in params:
            raise Untranslatable(f"{primitive} without the parameter {name}")

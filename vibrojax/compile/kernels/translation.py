"""Translation of a traced function to the LLVM IR of a kernel."""

from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import cache, partial
from typing import Any

import jax
import numpy as np
from jax.lax import GatherScatterMode

from vibrojax.compile.kernels import arrangement, control, elementwise, selection
from vibrojax.compile.kernels.assembly import (
    Assembly,
    Value,
    dtype_of,
    each,
    literals,
    refuse_if,
    varies,
    without_lanes,
)

TEMPLATE = """{declarations}

define internal void @group(ptr noalias %arrays, ptr noalias %workspace, i64 %count, i64 %lane) #0 {{
{body}
  ret void
}}

define void @lanes(ptr noalias %arrays, ptr noalias %workspace, i64 %count) #0 {{
  %any = icmp sgt i64 %count, 0
  br i1 %any, label %next, label %done
next:
  %lane = phi i64 [ 0, %0 ], [ %after, %next ]
  call void @group(ptr %arrays, ptr %workspace, i64 %count, i64 %lane)
  %after = add i64 %lane, {width}
  %more = icmp slt i64 %after, %count
  br i1 %more, label %next, label %done
done:
  ret void
}}

attributes #0 = {{ nounwind "prefer-vector-width"="512" "min-legal-vector-width"="512" }}
"""
"""IR text of a kernel. `lanes(arrays, workspace, count)` computes `count` lanes, a multiple of `width`. `arrays` is an
array of pointers to the arguments and results, whose last axis is the lane axis."""


def kernel_text(jaxpr: Any, width: int) -> tuple[str, int, int]:
    """Translate a closed jaxpr to a kernel for groups of `width` lanes.

    **Returns:** the kernel's IR text, and the size and alignment of its workspace [bytes].

    **Raises:** `Untranslatable` if the function has a construct that no kernel can express.
    """
    asm = Assembly(width)
    inner = jaxpr.jaxpr
    along = {var for equation in inner.eqns for var in control.scanned(equation)}
    arguments = [
        # An argument is loaded only once: its rows are far apart in memory.
        control.placeholder(var.aval) if var in along else each(asm.register, control.array_slots(asm, place, var.aval))
        for place, var in enumerate(inner.invars)
    ]
    asm.arrays = {var: place for place, var in enumerate((*inner.invars, *inner.outvars)) if not _is_literal(var)}
    results = _write(asm, jaxpr, arguments)
    for place, (var, value) in enumerate(zip(inner.outvars, results, strict=True), start=len(arguments)):
        if place not in asm.filled:
            asm.store_array(value, control.array_slots(asm, place, var.aval))
    body = "\n".join(asm.places + asm.lines)
    text = TEMPLATE.format(declarations="\n".join(sorted(asm.declared)), body=body, width=width)
    return text, asm.workspace, asm.alignment


def _write(asm: Assembly, closed: Any, values: Sequence[Value], owned: Collection[int] = ()) -> list[Value]:
    """Emit the instructions of a closed jaxpr and return its results.

    `owned`: `id` of each argument that nothing else reads, so that it may be overwritten.
    """
    jaxpr = closed.jaxpr
    known = dict(zip(jaxpr.constvars, map(literals, closed.consts), strict=True))
    known |= dict(zip(jaxpr.invars, values, strict=True))
    owned = set(owned)
    uses = _uses(jaxpr) if owned else {}

    def value(var: Any) -> Value:
        if not _is_literal(var):
            return known[var]
        number = np.asarray(var.val)
        return literals(number if number.dtype == jax.dtypes.float0 else number.astype(dtype_of(var.aval)))

    for equation in jaxpr.eqns:
        arguments = [value(var) for var in equation.invars]
        pairs = zip(arguments, equation.invars, strict=True)
        last = {id(x) for x, var in pairs if id(x) in owned and not _is_literal(var) and uses.get(var) == 1}
        results = _apply(asm, equation, arguments, last)
        if last and equation.primitive.name in arrangement.RULES:
            owned |= {id(x) for x in results}
        known |= dict(zip(equation.outvars, results, strict=True))
    return [value(var) for var in jaxpr.outvars]


def _uses(jaxpr: Any) -> Counter[Any]:
    """Return how many equations read each variable.

    A loop or function that takes a variable without using it does not count.
    """
    uses: Counter[Any] = Counter(var for var in jaxpr.outvars if not _is_literal(var))
    for equation in jaxpr.eqns:
        inner: Any = getattr(equation.params.get("jaxpr"), "jaxpr", None)
        used_inside = None if inner is None else _uses(inner)
        for place, var in enumerate(equation.invars):
            if not _is_literal(var) and (used_inside is None or inner.invars[place] in used_inside):
                uses[var] += 1
    return uses


def _is_literal(var: Any) -> bool:
    """Return whether an argument of an equation is a literal number, not a variable."""
    return hasattr(var, "val")


PARAMETERS: dict[str, tuple[str, str]] = {
    **dict.fromkeys((*elementwise.INTRINSICS, *elementwise.LIBRARY), ("", "accuracy")),
    **dict.fromkeys(selection.REDUCTIONS, ("axes", "out_sharding")),
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
    "jit": (
        "jaxpr",
        "ctx_mesh donated_invars inline keep_unused name in_layouts in_shardings out_layouts out_shardings "
        "compiler_options_kvs",
    ),
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

MODES = (GatherScatterMode.CLIP, GatherScatterMode.FILL_OR_DROP, GatherScatterMode.PROMISE_IN_BOUNDS)

ACCEPTED: dict[str, Callable[[Any], bool]] = {
    **dict.fromkeys(
        ("accuracy", "out_dtype", "out_sharding", "sharding", "update_jaxpr", "reshape.dimensions"),
        lambda value: value is None,
    ),
    **dict.fromkeys(("compiler_options_kvs", "update_consts"), lambda value: len(value) == 0),
    "mode": lambda mode: mode in MODES,
    "reverse": lambda reverse: isinstance(reverse, bool),
    "rounding_method": lambda method: method in elementwise.ROUNDING,
    "y": lambda exponent: isinstance(exponent, int),
}
"""Predicates that accept a value, by `parameter` or `primitive.parameter`. Other parameters may have any value."""


@cache
def primitives() -> set[str]:
    """Return the names of all supported primitives."""
    return {*arrangement.RULES, *selection.RULES, "scatter", *control.RULES, *elementwise.RULES, *elementwise.COMPOSED}


def _apply(asm: Assembly, equation: Any, values: list[Value], owned: Collection[int]) -> list[Value]:
    """Emit the instructions of an equation and return the equation's results."""
    name = equation.primitive.name
    refuse_if(name not in primitives(), f"the primitive {name}")
    check_parameters(name, equation.params)
    if name in arrangement.RULES:
        results = arrangement.arrange(equation, values)
    elif name in selection.RULES:
        results = selection.RULES[name](asm, equation, values)
    elif name == "scatter":
        results = selection.scatter(asm, equation, values, in_place=id(values[0]) in owned)
    elif name in control.RULES:
        results = control.RULES[name](asm, partial(_write, asm), equation, values, owned)
    else:
        gives = dtype_of(equation.outvars[0].aval)
        results = [selection.apply_to_arrays(asm, name, values, gives, equation.params)]
    for var, value in zip(equation.outvars, results, strict=True):
        mixed = not varies(var.aval) and any(x.varying for x in value.ravel().tolist())
        refuse_if(value.shape != without_lanes(var.aval.shape) or mixed, f"{name} that mixes lanes")
    return results


def check_parameters(primitive: str, params: Mapping[str, Any]) -> None:
    """Raise `Untranslatable` if a parameter is unknown or missing, or if its value is not accepted.

    A later version of jax may add a parameter, or a value of a parameter, that changes the meaning of a primitive.
    """
    needed, irrelevant = (names.split() for names in PARAMETERS.get(primitive, ("", "")))
    for name, value in params.items():
        known = name in needed or name in irrelevant
        refuse_if(not known, f"{primitive} with the unknown parameter {name}")
        accepts = ACCEPTED.get(f"{primitive}.{name}") or ACCEPTED.get(name)
        refuse_if(accepts is not None and not accepts(value), f"{primitive} with {name} = {value}")
    for name in needed:
        refuse_if(name not in params, f"{primitive} without the parameter {name}")

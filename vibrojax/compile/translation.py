"""Translation of a traced function to the LLVM IR of a kernel, one instruction at a time."""

from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import cache, partial
from math import prod
from typing import Any, NamedTuple

import numpy as np

from vibrojax.compile import control, elementwise, rows
from vibrojax.compile.assembly import (
    Assembly,
    Untranslatable,
    Value,
    dtype_of,
    each,
    literals,
    refuse_if,
    varies,
    without_lanes,
)
from vibrojax.lazy import jax

TEMPLATE = """{declarations}

define internal void @group(ptr noalias %arrays, ptr noalias %workspace, i64 %count, i64 %lane) #0 {{
{body}
  ret void
}}

{copies}

define void @lanes(ptr %arrays, ptr %workspace, ptr %index, i64 %count, i64 %length) #0 {{
  %any = icmp sgt i64 %count, 0
  br i1 %any, label %begin, label %done
begin:
{taken}
  br label %next
next:
  %lane = phi i64 [ 0, %begin ], [ %after, %next ]
  call void @group(ptr %packed, ptr %workspace, i64 %count, i64 %lane)
  %after = add i64 %lane, {width}
  %more = icmp slt i64 %after, %count
  br i1 %more, label %next, label %end
end:
{put}
  br label %done
done:
  ret void
}}

attributes #0 = {{ nounwind "prefer-vector-width"="512" "min-legal-vector-width"="512" }}
"""
"""IR text of a kernel. `lanes(arrays, workspace, index, count, length)` computes the lanes `index[0]` to
`index[count - 1]` of arrays with `length` lanes. `count` is a multiple of `width`. `arrays` is an array of pointers to
the arguments and results, whose last axis is the lane axis.

The lanes are copied to packed arrays of `count` lanes at the end of the workspace, and the results back. Copying row by
row keeps a row in the cache, which reading all rows of one group after another would not."""

COPY = """define internal void @{name}{bits}(
  ptr %packed, ptr %whole, ptr %index, i64 %count, i64 %length, i64 %rows
) #0 {{
  br label %row
row:
  %number = phi i64 [ 0, %0 ], [ %number1, %end ]
  %packed_start = mul i64 %number, %count
  %whole_start = mul i64 %number, %length
  %packed_row = getelementptr i{bits}, ptr %packed, i64 %packed_start
  %whole_row = getelementptr i{bits}, ptr %whole, i64 %whole_start
  br label %next
next:
  %k = phi i64 [ 0, %row ], [ %k1, %next ]
  %place = getelementptr i64, ptr %index, i64 %k
  %lane = load i64, ptr %place, align 8
  %in_packed = getelementptr i{bits}, ptr %packed_row, i64 %k
  %in_whole = getelementptr i{bits}, ptr %whole_row, i64 %lane
  %x = load i{bits}, ptr %{source}, align 1
  store i{bits} %x, ptr %{target}, align 1
  %k1 = add i64 %k, 1
  %more = icmp slt i64 %k1, %count
  br i1 %more, label %next, label %end
end:
  %number1 = add i64 %number, 1
  %again = icmp slt i64 %number1, %rows
  br i1 %again, label %row, label %done
done:
  ret void
}}"""
"""IR text of a function that copies the lanes in `index` from a whole to a packed array (`take`) or back (`put`)."""


class KernelText(NamedTuple):
    """A kernel's IR text, and the memory of its workspace [bytes]: `fixed` plus `per_lane`, at this `alignment`."""

    text: str
    fixed: int
    per_lane: int
    alignment: int


def kernel_text(jaxpr: Any, width: int) -> KernelText:
    """Translate a closed jaxpr to a kernel for groups of `width` lanes.

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
    avals = [var.aval for var in (*inner.invars, *inner.outvars)]
    taken, put, fixed, per_lane = _copies(avals, len(inner.invars), asm.workspace, asm.alignment)
    used = {bits for bits in (8, 16, 32, 64) if f"{bits}(" in taken + put}
    ways = (("take", "in_whole", "in_packed"), ("put", "in_packed", "in_whole"))
    copies = [COPY.format(name=name, source=x, target=y, bits=bits) for bits in sorted(used) for name, x, y in ways]
    text = TEMPLATE.format(
        declarations="\n".join(sorted(asm.declared)),
        body=body,
        copies="\n\n".join(copies),
        taken=taken,
        put=put,
        width=width,
    )
    return KernelText(text, fixed, per_lane, asm.alignment)


def _copies(avals: Sequence[Any], arguments: int, workspace: int, alignment: int) -> tuple[str, str, int, int]:
    """Return the instructions that copy lanes to packed arrays and back, and the workspace's `fixed` and `per_lane`.

    The workspace holds the slots of a group, the table of pointers to the packed arrays, and these arrays. `avals`: of
    all arrays, the first `arguments` of which are arguments.
    """
    table = -(-workspace // alignment) * alignment
    fixed = -(-(table + 8 * len(avals)) // alignment) * alignment
    taken = [f"  %packed = getelementptr i8, ptr %workspace, i64 {table}"]
    put: list[str] = []
    per_lane = 0
    # The widest numbers first, so that the rows of each array are aligned.
    for place, aval in sorted(enumerate(avals), key=lambda item: -dtype_of(item[1]).itemsize):
        size, count = dtype_of(aval).itemsize, prod(without_lanes(aval.shape))
        taken += [
            f"  %entry{place} = getelementptr ptr, ptr %arrays, i64 {place}",
            f"  %whole{place} = load ptr, ptr %entry{place}, align 8",
            f"  %offset{place} = mul i64 %count, {per_lane}",
            f"  %start{place} = add i64 %offset{place}, {fixed}",
            f"  %lanes{place} = getelementptr i8, ptr %workspace, i64 %start{place}",
            f"  %place{place} = getelementptr ptr, ptr %packed, i64 {place}",
            f"  store ptr %{'lanes' if varies(aval) else 'whole'}{place}, ptr %place{place}, align 8",
        ]
        if varies(aval) and count:
            call = f"ptr %lanes{place}, ptr %whole{place}, ptr %index, i64 %count, i64 %length, i64 {count}"
            name, calls = ("take", taken) if place < arguments else ("put", put)
            calls.append(f"  call void @{name}{8 * size}({call})")
            per_lane += size * count
    return "\n".join(taken), "\n".join(put), fixed, per_lane


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

    for equation in _needed(jaxpr):
        arguments = [value(var) for var in equation.invars]
        pairs = zip(arguments, equation.invars, strict=True)
        last = {id(x) for x, var in pairs if id(x) in owned and not _is_literal(var) and uses.get(var) == 1}
        results = _apply(asm, equation, arguments, last)
        if last and equation.primitive.name in rows.ARRANGEMENTS:
            owned |= {id(x) for x in results}
        known |= dict(zip(equation.outvars, results, strict=True))
    return [value(var) for var in jaxpr.outvars]


def _needed(jaxpr: Any) -> list[Any]:
    """Return the equations on which the results depend. A trace also has equations whose results nothing reads."""
    needed, equations = set(map(id, jaxpr.outvars)), []
    for equation in reversed(jaxpr.eqns):
        if not needed.isdisjoint(map(id, equation.outvars)):
            needed.update(map(id, equation.invars))
            equations.append(equation)
    return equations[::-1]


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
    **dict.fromkeys(rows.REDUCTIONS, ("axes", "out_sharding")),
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

MODES = ("CLIP", "FILL_OR_DROP", "PROMISE_IN_BOUNDS")
"""Accepted names of `jax.lax.GatherScatterMode`."""

ACCEPTED: dict[str, Callable[[Any], bool]] = {
    **dict.fromkeys(
        ("accuracy", "out_dtype", "out_sharding", "sharding", "update_jaxpr", "reshape.dimensions"),
        lambda value: value is None,
    ),
    **dict.fromkeys(("compiler_options_kvs", "update_consts"), lambda value: len(value) == 0),
    "mode": lambda mode: getattr(mode, "name", None) in MODES,
    "reverse": lambda reverse: isinstance(reverse, bool),
    "rounding_method": lambda method: getattr(method, "name", None) in elementwise.ROUNDING,
    "y": lambda exponent: isinstance(exponent, int),
}
"""Predicates that accept a value, by `parameter` or `primitive.parameter`. Other parameters may have any value."""


@cache
def primitives() -> set[str]:
    """Return the names of all supported primitives."""
    return {*rows.ARRANGEMENTS, *rows.RULES, "scatter", *control.RULES, *elementwise.RULES, *elementwise.COMPOSED}


def _apply(asm: Assembly, equation: Any, values: list[Value], owned: Collection[int]) -> list[Value]:
    """Emit the instructions of an equation and return the equation's results."""
    name = equation.primitive.name
    refuse_if(name not in primitives(), f"the primitive {name}")
    check_parameters(name, equation.params)
    if name in rows.ARRANGEMENTS:
        results = rows.arrange(equation, values)
    elif name in rows.RULES:
        results = rows.RULES[name](asm, equation, values)
    elif name == "scatter":
        results = rows.scatter(asm, equation, values, in_place=id(values[0]) in owned)
    elif name in control.RULES:
        results = control.RULES[name](asm, partial(_write, asm), equation, values, owned)
    else:
        gives = dtype_of(equation.outvars[0].aval)
        results = [rows.apply_to_arrays(asm, name, values, gives, equation.params)]
    for var, value in zip(equation.outvars, results, strict=True):
        mixed = not varies(var.aval) and any(x.varying for x in value.ravel().tolist())
        refuse_if(value.shape != without_lanes(var.aval.shape) or mixed, f"{name} that mixes lanes")
    return results


@cache
def _known_parameters(primitive: str) -> tuple[list[str], list[str]]:
    """Return the parameters of a primitive that must exist, and those without a meaning for kernels."""
    needed, irrelevant = PARAMETERS.get(primitive, ("", ""))
    return needed.split(), irrelevant.split()


def check_parameters(primitive: str, params: Mapping[str, Any]) -> None:
    """Raise `Untranslatable` if a parameter is unknown or missing, or if its value is not accepted.

    A later version of jax may add a parameter, or a value of a parameter, that changes the meaning of a primitive.
    """
    needed, irrelevant = _known_parameters(primitive)
    for name, value in params.items():
        if name not in needed and name not in irrelevant:
            raise Untranslatable(f"{primitive} with the unknown parameter {name}")
        accepts = ACCEPTED.get(f"{primitive}.{name}") or ACCEPTED.get(name)
        if accepts is not None and not accepts(value):
            raise Untranslatable(f"{primitive} with {name} = {value}")
    for name in needed:
        refuse_if(name not in params, f"{primitive} without the parameter {name}")

"""Translation of a traced function to the LLVM IR of a kernel."""

from collections import Counter
from collections.abc import Collection, Sequence
from functools import cache, partial
from typing import Any

import jax
import numpy as np

from vibrojax.compile.kernels import arrangement, control, elementwise, parameters, selection
from vibrojax.compile.kernels.assembly import Assembly, array_entries, array_slots, placeholder
from vibrojax.compile.kernels.operands import Untranslatable, Value, dtype_of, literals, varies, without_lanes

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
        placeholder(var.aval) if var in along else array_entries(asm, place, var.aval)
        for place, var in enumerate(inner.invars)
    ]
    asm.arrays = {var: place for place, var in enumerate((*inner.invars, *inner.outvars)) if not _is_literal(var)}
    results = _write(asm, jaxpr, arguments)
    for place, (var, value) in enumerate(zip(inner.outvars, results, strict=True), start=len(arguments)):
        if place in asm.filled:
            continue
        for entry, slot in zip(value.ravel().tolist(), array_slots(asm, place, var.aval).ravel().tolist(), strict=True):
            asm.store(entry, slot, alignment=1)
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
        return known[var] if not _is_literal(var) else literals(_number(var))

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


def _number(var: Any) -> np.ndarray:
    """Return the value of a literal argument of an equation, with the type that it has in the trace."""
    value = np.asarray(var.val)
    return value if value.dtype == jax.dtypes.float0 else value.astype(dtype_of(var.aval))


def _is_literal(var: Any) -> bool:
    """Return whether an argument of an equation is a literal number, not a variable."""
    return hasattr(var, "val")


@cache
def primitives() -> set[str]:
    """Return the names of all supported primitives."""
    return {*arrangement.RULES, *selection.RULES, "scatter", *control.RULES, *elementwise.RULES, *elementwise.COMPOSED}


def _apply(asm: Assembly, equation: Any, values: list[Value], owned: Collection[int]) -> list[Value]:
    """Emit the instructions of an equation and return the equation's results."""
    name = equation.primitive.name
    if name not in primitives():
        raise Untranslatable(f"the primitive {name}")
    parameters.check(name, equation.params)
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
        results = [selection.apply_to_arrays(asm, name, equation.params, values, gives)]
    for var, value in zip(equation.outvars, results, strict=True):
        mixed = not varies(var.aval) and any(x.varying for x in value.ravel().tolist())
        if value.shape != without_lanes(var.aval.shape) or mixed:
            raise Untranslatable(f"{name} that mixes lanes")
    return results

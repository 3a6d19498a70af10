"""From a traced function to the text of a kernel."""

from collections.abc import Collection, Sequence
from functools import cache, partial
from typing import Any

import jax
import numpy as np

from vibrojax.compile.kernels import arrangement, control, elementwise, parameters, selection
from vibrojax.compile.kernels.arrays import array_entries, array_slots, elsewhere
from vibrojax.compile.kernels.assembly import Assembly
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
"""`lanes(arrays, workspace, count)`: the function for `count` lanes, a whole number of groups. `arrays` points to the
pointers of arguments and results, whose last axis is the lanes'."""


def kernel_text(jaxpr: Any, width: int) -> tuple[str, int, int]:
    """(the text of a closed jaxpr as a kernel for groups of `width` lanes, the bytes of workspace that it wants, and
    the alignment [bytes] of that).

    **Raises:** `Untranslatable` where the function does what no kernel can do.
    """
    asm = Assembly(width)
    inner = jaxpr.jaxpr
    along = {var for equation in inner.eqns for var in control.scanned(equation)}
    given = [
        elsewhere(var.aval) if var in along else array_entries(asm, place, var.aval)
        for place, var in enumerate(inner.invars)
    ]
    asm.arrays = {var: place for place, var in enumerate((*inner.invars, *inner.outvars)) if not is_literal(var)}
    found = _written(asm, jaxpr, given)
    for place, (var, value) in enumerate(zip(inner.outvars, found, strict=True), start=len(given)):
        if place in asm.filled:
            continue
        for entry, slot in zip(value.ravel().tolist(), array_slots(asm, place, var.aval).ravel().tolist(), strict=True):
            asm.store(entry, slot, alignment=1)
    body = "\n".join(asm.places + asm.lines)
    text = TEMPLATE.format(declarations="\n".join(sorted(asm.declared)), body=body, width=width)
    return text, asm.workspace, asm.alignment


def _written(asm: Assembly, closed: Any, values: Sequence[Value], owned: Collection[int] = ()) -> list[Value]:
    """The results of a closed jaxpr, its instructions written.

    `owned`: identities of those of the values that nothing else wants, so that they may be overwritten.
    """
    jaxpr = closed.jaxpr
    known = dict(zip(jaxpr.constvars, map(literals, closed.consts), strict=True))
    known |= dict(zip(jaxpr.invars, values, strict=True))
    owned = set(owned)
    uses = _uses(jaxpr) if owned else {}

    def value(var: Any) -> Value:
        return known[var] if not is_literal(var) else literals(number(var))

    for equation in jaxpr.eqns:
        given = [value(var) for var in equation.invars]
        last = {id(x) for x, var in zip(given, equation.invars, strict=True) if id(x) in owned and uses.get(var) == 1}
        found = _applied(asm, equation, given, last)
        if last and equation.primitive.name in arrangement.RULES:
            owned |= {id(x) for x in found}
        known |= dict(zip(equation.outvars, found, strict=True))
    return [value(var) for var in jaxpr.outvars]


def _uses(jaxpr: Any) -> dict[Any, int]:
    """How often each variable is wanted; not where it only goes to a loop or function without use for it."""
    uses: dict[Any, int] = {}
    for var in jaxpr.outvars:
        if not is_literal(var):
            uses[var] = uses.get(var, 0) + 1
    for equation in jaxpr.eqns:
        inner = getattr(equation.params.get("jaxpr"), "jaxpr", None)
        wanted = None if inner is None else _uses(inner)
        for place, var in enumerate(equation.invars):
            if not is_literal(var) and (inner is None or wanted is None or inner.invars[place] in wanted):
                uses[var] = uses.get(var, 0) + 1
    return uses


def number(var: Any) -> np.ndarray:
    """The value of an argument that is a number; of a Python number the trace knows the type."""
    found = np.asarray(var.val)
    return found if found.dtype == jax.dtypes.float0 else found.astype(dtype_of(var.aval))


def is_literal(var: Any) -> bool:
    """Whether an argument of an equation is a number and no variable."""
    return hasattr(var, "val")


@cache
def primitives() -> set[str]:
    """Return the names of all primitives that the translation accepts."""
    return {*arrangement.RULES, *selection.RULES, "scatter", *control.RULES, *elementwise.RULES, *elementwise.COMPOSED}


def _applied(asm: Assembly, equation: Any, values: list[Value], owned: Collection[int]) -> list[Value]:
    name = equation.primitive.name
    if name not in primitives():
        raise Untranslatable(f"the primitive {name}")
    parameters.check(name, equation.params)
    results = _results(asm, name, equation, values, owned)
    for var, value in zip(equation.outvars, results, strict=True):
        aval = var.aval
        if value.shape != without_lanes(aval.shape) or (
            not varies(aval) and any(x.varying for x in value.ravel().tolist())
        ):
            raise Untranslatable(f"{name} that mixes lanes")
    return results


def _results(asm: Assembly, name: str, equation: Any, values: list[Value], owned: Collection[int]) -> list[Value]:
    if name in arrangement.RULES:
        return arrangement.RULES[name](equation, values)
    if name in selection.RULES:
        return selection.RULES[name](asm, equation, values)
    if name == "scatter":
        return selection.scattered(asm, equation, values, in_place=id(values[0]) in owned)
    if name in control.RULES:
        return control.RULES[name](asm, partial(_written, asm), equation, values, owned)
    return [selection.each(asm, name, equation.params, values, dtype_of(equation.outvars[0].aval))]

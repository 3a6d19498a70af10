"""The primitives of jax that work on each entry by itself: each has a rule that writes its instructions."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np

from vibrojax.compile.kernels import conversions
from vibrojax.compile.kernels.assembly import Assembly
from vibrojax.compile.kernels.operands import BOOL, Entry, Operand, Untranslatable, element
from vibrojax.compile.kernels.rules import ANY, FLOATS, INTEGERS, NUMBERS, Applied, Rule


def applied(asm: Assembly, name: str, params: Mapping[str, Any], entries: list[Entry], gives: np.dtype) -> Operand:
    """Write a primitive of one entry of each of its arguments; raise `Untranslatable` for types without a rule."""
    if name in COMPOSED:
        return COMPOSED[name](asm, entries)
    rule, op = RULES[name], Applied(asm, params, entries, gives)
    if op.dtype.kind not in rule.kinds or (len({operand.dtype for operand in op.operands}) > 1 and name != "pow"):
        raise Untranslatable(f"{name} of {' and '.join(str(operand.dtype) for operand in op.operands)}")
    return Operand(rule.write(op), np.dtype(gives), op.varying)


def _clamped(asm: Assembly, entries: list[Entry]) -> Operand:
    low, x, high = entries
    dtype = asm.register(x).dtype
    raised = applied(asm, "max", {}, [x, low], dtype)
    return applied(asm, "min", {}, [raised, high], dtype)


def _selected(asm: Assembly, entries: list[Entry]) -> Operand:
    which, *cases = (asm.register(entry) for entry in entries)
    if which.dtype != BOOL or len(cases) != 2:
        raise Untranslatable("a choice that is not between two by a boolean")
    no, yes = cases
    varying = any(operand.varying for operand in (which, no, yes))
    kind = asm.type(yes.dtype, varying)
    flags = asm.type(BOOL, which.varying)
    chosen = asm.let(f"select {flags} {which.text}, {kind} {asm.text(yes, varying)}, {kind} {asm.text(no, varying)}")
    return Operand(chosen, yes.dtype, varying)


def _arithmetic(of_floats: str, of_integers: str, op: Applied) -> str:
    instruction = of_floats if op.is_float else of_integers
    return op.asm.let(f"{instruction} {op.type} {op.x[0]}, {op.x[1]}")


def _tangents_added(op: Applied) -> str:
    """Write a sum; the tangents of integers, booleans here, are all false."""
    return _arithmetic("fadd contract", "or" if op.dtype == BOOL else "add", op)


def _divided(remainder: bool, op: Applied) -> str:
    """Write a quotient or remainder; of integers divided by 0, as XLA has it: -1 (all bits) or the dividend."""
    whole, by = op.x
    name = "rem" if remainder else "div"
    if op.is_float:
        return op.asm.let(f"f{name} {op.type} {whole}, {by}")
    zero, safe = op.compared("eq", by, op.constant(0)), by
    if op.order == "s":
        # The processor stops where the least number is divided by -1.
        minus = op.compared("eq", by, op.constant(-1))
        safe = op.chosen(minus, op.constant(1), by)
    safe = op.chosen(zero, op.constant(1), safe)
    result = op.asm.let(f"{op.order}{name} {op.type} {whole}, {safe}")
    if op.order == "s":
        negative = op.constant(0) if remainder else op.asm.let(f"sub {op.type} {op.constant(0)}, {whole}")
        result = op.chosen(minus, negative, result)
    return op.chosen(zero, whole if remainder else op.constant(-1), result)


def _shifted(instruction: str, op: Applied) -> str:
    """Write a shift. By the width or more, or by a negative number, it leaves 0, or the sign, as XLA has it."""
    bits, by = 8 * op.dtype.itemsize, op.operands[1].number
    shifted = op.asm.let(f"{instruction} {op.type} {op.x[0]}, {op.x[1]}")
    if by is not None and 0 <= by < bits:
        return shifted
    beyond = op.constant(0)
    if instruction == "ashr":
        beyond = op.asm.let(f"ashr {op.type} {op.x[0]}, {op.constant(bits - 1)}")
    return op.chosen(op.compared("ult", op.x[1], op.constant(bits)), shifted, beyond)


def _comparison(of_floats: str, of_integers: str, op: Applied) -> str:
    how = of_integers if of_integers in ("eq", "ne") else op.order + of_integers
    return op.compared(of_floats if op.is_float else how, *op.x)


def _extreme(name: str, op: Applied) -> str:
    """Write the maximum or minimum. Of floats it is NaN where either is, and +0 counts as greater than -0."""
    if op.dtype == BOOL:
        return op.asm.let(f"{'or' if name == 'max' else 'and'} {op.type} {op.x[0]}, {op.x[1]}")
    if not op.is_float:
        return op.intrinsic(op.order + name)
    first, second = op.x
    positive = [operand.text in op.asm.positive or _is_positive(operand.number) for operand in op.operands]
    wins_ties = [_wins_ties(name, *known) for known in zip(op.operands, positive, strict=True)]
    if not any(wins_ties) and not all(positive):
        return op.intrinsic(f"{name}imum")
    if not wins_ties[1]:
        first, second = second, first
    # A comparison with NaN, or of equals, gives the second; a NaN of the first is put back.
    chosen = op.chosen(op.compared("ogt" if name == "max" else "olt", first, second), first, second)
    result = op.chosen(op.compared("uno", first, first), first, chosen)
    if all(positive) or (name == "max" and any(positive)):
        op.asm.positive.add(result)
    return result


def _is_positive(number: float | None) -> bool:
    return number is not None and not np.isnan(number) and not np.signbit(number)


def _wins_ties(name: str, operand: Operand, positive: bool) -> bool:
    """Return whether an operand is the extreme of two equal numbers: if its zero, or no zero, is the right one."""
    if operand.number is None or operand.number == 0:
        return positive if name == "max" else operand.number is not None and not positive
    return True


def _from_the_library(name: str, op: Applied) -> str:
    """Write calls of the C library's function, lane by lane."""
    kind = element(op.dtype)
    function = name + ("f" if op.dtype.itemsize == 4 else "")
    if not op.varying:
        return op.asm.call(function, op.x, kind)
    result = "poison"
    for lane in range(op.asm.width):
        taken = [op.asm.let(f"extractelement {op.type} {argument}, i64 {lane}") for argument in op.x]
        called = op.asm.call(function, taken, kind)
        result = op.asm.let(f"insertelement {op.type} {result}, {kind} {called}, i64 {lane}")
    return result


def _power(op: Applied) -> str:
    """Write a power of floats; an exponent that is an integer becomes a float first, as in jax."""
    base, exponent = op.operands
    if exponent.dtype != base.dtype:
        exponent = applied(op.asm, "convert_element_type", {}, [exponent], base.dtype)
    texts = [op.asm.text(operand, op.varying) for operand in (base, exponent)]
    return op.asm.intrinsic("pow", texts, op.dtype, op.varying)


def _negative(op: Applied) -> str:
    if op.is_float:
        return op.asm.let(f"fneg {op.type} {op.x[0]}")
    return op.asm.let(f"sub {op.type} {op.constant(0)}, {op.x[0]}")


def _absolute(op: Applied) -> str:
    if op.is_float:
        result = op.intrinsic("fabs")
        op.asm.positive.add(result)
        return result
    return op.chosen(op.compared("slt", op.x[0], op.constant(0)), _negative(op), op.x[0])


def _not(op: Applied) -> str:
    every = op.constant(True if op.dtype == BOOL else -1)
    return op.asm.let(f"xor {op.type} {op.x[0]}, {every}")


def _sign(op: Applied) -> str:
    """Write the sign: 1, -1, or the number itself where it is 0 or NaN."""
    number, zero = op.x[0], op.constant(0)
    below, above = ("olt", "ogt") if op.is_float else (f"{op.order}lt", f"{op.order}gt")
    result = op.chosen(op.compared(below, number, zero), op.constant(-1), number)
    return op.chosen(op.compared(above, number, zero), op.constant(1), result)


def _is_finite(op: Applied) -> str:
    return op.compared("olt", op.intrinsic("fabs"), op.constant(np.inf))


def _square(op: Applied) -> str:
    return _arithmetic("fmul", "mul", Applied(op.asm, {}, [op.operands[0]] * 2, op.gives))


def _integer_power(op: Applied) -> str:
    """Write a power by squaring, in jax's order, so that it is rounded alike."""
    exponent, multiply = op.params["y"], "fmul" if op.is_float else "mul"
    if exponent < 0 and not op.is_float:
        raise Untranslatable("a negative power of integers")
    power, result, left = op.x[0], None, abs(exponent)
    while left:
        if left % 2:
            result = power if result is None else op.asm.let(f"{multiply} {op.type} {result}, {power}")
        left //= 2
        if left:
            power = op.asm.let(f"{multiply} {op.type} {power}, {power}")
    if result is None:
        return op.constant(1)
    return result if exponent > 0 else op.asm.let(f"fdiv {op.type} {op.constant(1)}, {result}")


def _rounded(op: Applied) -> str:
    return op.intrinsic("roundeven" if int(op.params["rounding_method"]) == 1 else "round")


COMPOSED: dict[str, Callable[[Assembly, list[Entry]], Operand]] = {"clamp": _clamped, "select_n": _selected}
"""Primitives made of others, or of arguments of several types."""

INTRINSICS = ("sqrt", "floor", "ceil", "exp", "exp2", "log", "sin", "cos")
CIRCULAR = ("tan", "tanh", "sinh", "cosh", "asin", "acos", "atan", "asinh", "acosh", "atanh", "atan2")
LIBRARY = (*CIRCULAR, "expm1", "log1p", "cbrt", "erf", "erfc")

# A product that is added may be rounded once with the sum (`contract`): no more is left to the compiler.
RULES: dict[str, Rule] = {
    "add": Rule(partial(_arithmetic, "fadd contract", "add"), NUMBERS),
    "add_any": Rule(_tangents_added, ANY),
    "sub": Rule(partial(_arithmetic, "fsub contract", "sub"), NUMBERS),
    "mul": Rule(partial(_arithmetic, "fmul contract", "mul"), NUMBERS),
    "div": Rule(partial(_divided, False), NUMBERS),
    "rem": Rule(partial(_divided, True), NUMBERS),
    **{name: Rule(partial(_arithmetic, "", name), INTEGERS + "b") for name in ("and", "or", "xor")},
    "shift_left": Rule(partial(_shifted, "shl"), INTEGERS),
    "shift_right_logical": Rule(partial(_shifted, "lshr"), INTEGERS),
    "shift_right_arithmetic": Rule(partial(_shifted, "ashr"), INTEGERS),
    **{name: Rule(partial(_comparison, f"o{name}", name), ANY) for name in ("lt", "gt", "le", "ge", "eq")},
    "ne": Rule(partial(_comparison, "une", "ne"), ANY),
    **{name: Rule(partial(_extreme, name), ANY) for name in ("max", "min")},
    "neg": Rule(_negative, NUMBERS),
    "abs": Rule(_absolute, "fi"),
    "not": Rule(_not, INTEGERS + "b"),
    "sign": Rule(_sign, NUMBERS),
    "is_finite": Rule(_is_finite, FLOATS),
    "integer_pow": Rule(_integer_power, NUMBERS),
    "square": Rule(_square, NUMBERS),
    "round": Rule(_rounded, FLOATS),
    "pow": Rule(_power, FLOATS),
    **conversions.RULES,
    **{name: Rule(lambda op: op.x[0], ANY) for name in ("stop_gradient", "copy")},
    **{name: Rule(lambda op, name=name: op.intrinsic(name), FLOATS) for name in INTRINSICS},  # type: ignore[misc]
    **{name: Rule(partial(_from_the_library, name), FLOATS) for name in LIBRARY},
}

"""Translation rules for elementwise primitives: arithmetic, comparisons, functions, conversions."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np
from jax.lax import RoundingMethod

from vibrojax.compile.kernels.assembly import Assembly
from vibrojax.compile.kernels.operands import BOOL, Entry, Operand, Untranslatable, element
from vibrojax.compile.kernels.rules import ANY, FLOATS, INTEGERS, NUMBERS, Application, Rule


def apply(asm: Assembly, name: str, params: Mapping[str, Any], entries: list[Entry], gives: np.dtype) -> Operand:
    """Emit a primitive for one array element of each argument.

    **Raises:** `Untranslatable` for types without a rule.
    """
    if name in COMPOSED:
        return COMPOSED[name](asm, entries)
    rule, op = RULES[name], Application(asm, params, entries, gives)
    if op.dtype.kind not in rule.kinds or (len({operand.dtype for operand in op.operands}) > 1 and name != "pow"):
        raise Untranslatable(f"{name} of {' and '.join(str(operand.dtype) for operand in op.operands)}")
    return Operand(rule.write(op), np.dtype(gives), op.varying)


def _clamp(asm: Assembly, entries: list[Entry]) -> Operand:
    low, x, high = entries
    dtype = asm.register(x).dtype
    return apply(asm, "min", {}, [apply(asm, "max", {}, [x, low], dtype), high], dtype)


def _select(asm: Assembly, entries: list[Entry]) -> Operand:
    which, *cases = (asm.register(entry) for entry in entries)
    if which.dtype != BOOL or len(cases) != 2:
        raise Untranslatable("a choice that is not between two by a boolean")
    no, yes = cases
    varying = any(operand.varying for operand in (which, no, yes))
    kind = asm.type(yes.dtype, varying)
    flags = asm.type(BOOL, which.varying)
    chosen = asm.let(f"select {flags} {which.text}, {kind} {asm.text(yes, varying)}, {kind} {asm.text(no, varying)}")
    return Operand(chosen, yes.dtype, varying)


def _arithmetic(of_floats: str, of_integers: str, op: Application) -> str:
    instruction = of_floats if op.is_float else of_integers
    return op.asm.let(f"{instruction} {op.type} {op.x[0]}, {op.x[1]}")


def _divide(remainder: bool, op: Application) -> str:
    """Emit a quotient or remainder.

    An integer division by 0 gives, as in XLA, the quotient -1 (all bits set) and the dividend as remainder.
    """
    dividend, divisor = op.x
    name = "rem" if remainder else "div"
    if op.is_float:
        return op.asm.let(f"f{name} {op.type} {dividend}, {divisor}")
    zero, safe = op.compare("eq", divisor, op.constant(0)), divisor
    if op.order == "s":
        # The least signed integer divided by -1 overflows, which kills the process (SIGFPE).
        minus = op.compare("eq", divisor, op.constant(-1))
        safe = op.select(minus, op.constant(1), divisor)
    safe = op.select(zero, op.constant(1), safe)
    result = op.asm.let(f"{op.order}{name} {op.type} {dividend}, {safe}")
    if op.order == "s":
        negative = op.constant(0) if remainder else op.asm.let(f"sub {op.type} {op.constant(0)}, {dividend}")
        result = op.select(minus, negative, result)
    return op.select(zero, dividend if remainder else op.constant(-1), result)


def _shift(instruction: str, op: Application) -> str:
    """Emit a shift.

    If the number of bits to shift is negative or not less than the width, the result is, as in XLA, 0 or, for an
    arithmetic shift to the right, all sign bits.
    """
    bits, by = 8 * op.dtype.itemsize, op.operands[1].number
    shifted = op.asm.let(f"{instruction} {op.type} {op.x[0]}, {op.x[1]}")
    if by is not None and 0 <= by < bits:
        return shifted
    beyond = op.constant(0)
    if instruction == "ashr":
        beyond = op.asm.let(f"ashr {op.type} {op.x[0]}, {op.constant(bits - 1)}")
    return op.select(op.compare("ult", op.x[1], op.constant(bits)), shifted, beyond)


def _compare(of_floats: str, of_integers: str, op: Application) -> str:
    how = of_integers if of_integers in ("eq", "ne") else op.order + of_integers
    return op.compare(of_floats if op.is_float else how, *op.x)


def _extremum(name: str, op: Application) -> str:
    """Emit a maximum or minimum. For floats, it is NaN if either operand is, and +0 counts as greater than -0."""
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
    # For NaN or equal operands, the comparison selects the second. If the first is NaN, it is selected afterwards.
    extremum = op.select(op.compare("ogt" if name == "max" else "olt", first, second), first, second)
    result = op.select(op.compare("uno", first, first), first, extremum)
    if all(positive) or (name == "max" and any(positive)):
        op.asm.positive.add(result)
    return result


def _is_positive(number: float | None) -> bool:
    return number is not None and not np.isnan(number) and not np.signbit(number)


def _wins_ties(name: str, operand: Operand, positive: bool) -> bool:
    """Return whether an operand may be taken as the extremum if both operands are equal.

    True if the operand is the zero with the right sign, or is known not to be zero.
    """
    if operand.number is None or operand.number == 0:
        return positive if name == "max" else operand.number is not None and not positive
    return True


def _library_function(name: str, op: Application) -> str:
    """Emit calls of a function of the C library, one for each lane."""
    kind = element(op.dtype)
    function = name + ("f" if op.dtype.itemsize == 4 else "")
    if not op.varying:
        return op.asm.call(function, op.x, kind)
    result = "poison"
    for lane in range(op.asm.width):
        arguments = [op.asm.let(f"extractelement {op.type} {argument}, i64 {lane}") for argument in op.x]
        value = op.asm.call(function, arguments, kind)
        result = op.asm.let(f"insertelement {op.type} {result}, {kind} {value}, i64 {lane}")
    return result


def _power(op: Application) -> str:
    """Emit a power of floats. An integer exponent is converted to a float first, as in jax."""
    base, exponent = op.operands
    if exponent.dtype != base.dtype:
        exponent = apply(op.asm, "convert_element_type", {}, [exponent], base.dtype)
    texts = [op.asm.text(operand, op.varying) for operand in (base, exponent)]
    return op.asm.intrinsic("pow", texts, op.dtype, op.varying)


def _negate(op: Application) -> str:
    if op.is_float:
        return op.asm.let(f"fneg {op.type} {op.x[0]}")
    return op.asm.let(f"sub {op.type} {op.constant(0)}, {op.x[0]}")


def _absolute(op: Application) -> str:
    if op.is_float:
        result = op.intrinsic("fabs")
        op.asm.positive.add(result)
        return result
    return op.select(op.compare("slt", op.x[0], op.constant(0)), _negate(op), op.x[0])


def _sign(op: Application) -> str:
    """Emit the sign of a number: 1, -1, or the number itself if it is 0 or NaN."""
    number, zero = op.x[0], op.constant(0)
    below, above = ("olt", "ogt") if op.is_float else (f"{op.order}lt", f"{op.order}gt")
    result = op.select(op.compare(below, number, zero), op.constant(-1), number)
    return op.select(op.compare(above, number, zero), op.constant(1), result)


def _integer_power(op: Application) -> str:
    """Emit a power by repeated squaring, in the same order as jax so that rounding errors are the same."""
    exponent, multiply = op.params["y"], "fmul" if op.is_float else "mul"
    if exponent < 0 and not op.is_float:
        raise Untranslatable("a negative power of integers")
    power, result, remaining = op.x[0], None, abs(exponent)
    while remaining:
        if remaining % 2:
            result = power if result is None else op.asm.let(f"{multiply} {op.type} {result}, {power}")
        remaining //= 2
        if remaining:
            power = op.asm.let(f"{multiply} {op.type} {power}, {power}")
    if result is None:
        return op.constant(1)
    return result if exponent > 0 else op.asm.let(f"fdiv {op.type} {op.constant(1)}, {result}")


def _reinterpret(op: Application) -> str:
    """Emit a reinterpretation of the bits of a number as another type."""
    if op.gives == op.dtype:
        return op.x[0]
    if op.gives.itemsize != op.dtype.itemsize or op.gives == BOOL:
        raise Untranslatable(f"the bits of {op.dtype} as {op.gives}")
    return op.asm.let(f"bitcast {op.type} {op.x[0]} to {op.asm.type(op.gives, op.varying)}")


def _convert(op: Application) -> str:
    if op.gives == op.dtype:
        return op.x[0]
    if op.gives == BOOL:
        return op.compare("une" if op.is_float else "ne", op.x[0], op.constant(0))
    if op.is_float and op.gives.kind != "f":
        return _saturate(op)
    wider = op.gives.itemsize > op.dtype.itemsize
    if op.is_float:
        how = "fpext" if wider else "fptrunc"
    elif op.gives.kind == "f":
        how = "sitofp" if op.order == "s" else "uitofp"
    elif wider or op.dtype == BOOL:
        how = "sext" if op.order == "s" else "zext"
    elif op.gives.itemsize < op.dtype.itemsize:
        how = "trunc"
    else:
        return op.x[0]
    return op.asm.let(f"{how} {op.type} {op.x[0]} to {op.asm.type(op.gives, op.varying)}")


def _saturate(op: Application) -> str:
    """Emit a conversion of a float to an integer type that clips to the range of the type. NaN becomes 0."""
    asm, lanes = op.asm, f"v{op.asm.width}" if op.varying else ""
    name = f"llvm.fpto{'s' if op.gives.kind == 'i' else 'u'}i.sat"
    name += f".{lanes}{asm.suffix(op.gives)}.{lanes}{asm.suffix(op.dtype)}"
    return asm.call(name, op.x, asm.type(op.gives, op.varying), takes=op.type)


COMPOSED: dict[str, Callable[[Assembly, list[Entry]], Operand]] = {"clamp": _clamp, "select_n": _select}
"""Rules of primitives that are composed of others or that take arguments of several types."""

ROUNDING = {RoundingMethod.AWAY_FROM_ZERO: "round", RoundingMethod.TO_NEAREST_EVEN: "roundeven"}
INTRINSICS = ("sqrt", "floor", "ceil", "exp", "exp2", "log", "sin", "cos")
CIRCULAR = ("tan", "tanh", "sinh", "cosh", "asin", "acos", "atan", "asinh", "acosh", "atanh", "atan2")
LIBRARY = (*CIRCULAR, "expm1", "log1p", "cbrt", "erf", "erfc")

# `contract` lets LLVM fuse a product and a sum, which are then rounded once. It may not reorder operations.
RULES: dict[str, Rule] = {
    "add": Rule(partial(_arithmetic, "fadd contract", "add"), NUMBERS),
    # Tangents of integers are represented as booleans, all of which are false.
    "add_any": Rule(lambda op: _arithmetic("fadd contract", "or" if op.dtype == BOOL else "add", op), ANY),
    "sub": Rule(partial(_arithmetic, "fsub contract", "sub"), NUMBERS),
    "mul": Rule(partial(_arithmetic, "fmul contract", "mul"), NUMBERS),
    "div": Rule(partial(_divide, False), NUMBERS),
    "rem": Rule(partial(_divide, True), NUMBERS),
    **{name: Rule(partial(_arithmetic, "", name), INTEGERS + "b") for name in ("and", "or", "xor")},
    "shift_left": Rule(partial(_shift, "shl"), INTEGERS),
    "shift_right_logical": Rule(partial(_shift, "lshr"), INTEGERS),
    "shift_right_arithmetic": Rule(partial(_shift, "ashr"), INTEGERS),
    **{name: Rule(partial(_compare, f"o{name}", name), ANY) for name in ("lt", "gt", "le", "ge", "eq")},
    "ne": Rule(partial(_compare, "une", "ne"), ANY),
    **{name: Rule(partial(_extremum, name), ANY) for name in ("max", "min")},
    "neg": Rule(_negate, NUMBERS),
    "abs": Rule(_absolute, "fi"),
    "not": Rule(
        lambda op: op.asm.let(f"xor {op.type} {op.x[0]}, {op.constant(op.dtype == BOOL or -1)}"), INTEGERS + "b"
    ),
    "sign": Rule(_sign, NUMBERS),
    "is_finite": Rule(lambda op: op.compare("olt", op.intrinsic("fabs"), op.constant(np.inf)), FLOATS),
    "integer_pow": Rule(_integer_power, NUMBERS),
    "square": Rule(
        lambda op: _arithmetic("fmul", "mul", Application(op.asm, {}, [op.operands[0]] * 2, op.gives)), NUMBERS
    ),
    "round": Rule(lambda op: op.intrinsic(ROUNDING[op.params["rounding_method"]]), FLOATS),
    "pow": Rule(_power, FLOATS),
    "bitcast_convert_type": Rule(_reinterpret, ANY),
    "convert_element_type": Rule(_convert, ANY),
    **{name: Rule(lambda op: op.x[0], ANY) for name in ("stop_gradient", "copy")},
    **{name: Rule(lambda op, name=name: op.intrinsic(name), FLOATS) for name in INTRINSICS},  # type: ignore[misc]
    **{name: Rule(partial(_library_function, name), FLOATS) for name in LIBRARY},
}

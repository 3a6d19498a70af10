"""Translation rules for elementwise primitives: arithmetic, comparisons, functions, conversions."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from vibrojax.compile.assembly import BOOL, Assembly, Entry, Operand, Untranslatable, element, literal, refuse_if

FLOATS, INTEGERS, NUMBERS, ANY = "f", "iu", "fiu", "fiub"
"""Kinds of operands, as numpy's kind codes: floats, signed and unsigned integers, booleans."""


class Application:
    """A primitive applied to one array element of each of its arguments.

    - `x`: IR texts of the arguments. If one argument is a vector, `varying` is True and all are vectors.
    - `dtype`: type of the first argument. `gives`: type of the result.
    """

    def __init__(self, asm: Assembly, operands: Sequence[Operand], gives: np.dtype | None, params: Any) -> None:
        self.asm, self.params, self.operands = asm, params or {}, operands
        self.varying = any(operand.varying for operand in operands)
        self.x = [asm.text(operand, self.varying) for operand in operands]
        self.dtype = operands[0].dtype
        self.gives = self.dtype if gives is None else np.dtype(gives)
        self.is_float, self.type = self.dtype.kind == "f", asm.type(self.dtype, self.varying)

    @property
    def order(self) -> str:
        """Prefix of LLVM's integer instructions: `s` for signed integers, `u` for unsigned integers and booleans."""
        return "s" if self.dtype.kind == "i" else "u"

    def constant(self, number: Any) -> str:
        """Return the IR text of a constant that has the type of the arguments."""
        return self.asm.text(literal(number, self.dtype), self.varying)

    def emit(self, instruction: str, *operands: str) -> str:
        """Emit an instruction whose operands have the type of the arguments."""
        return self.asm.let(f"{instruction} {self.type} {', '.join(operands)}")

    def negative(self, number: str) -> str:
        return self.emit("sub", self.constant(0), number)

    def cast(self, instruction: str) -> str:
        """Emit a conversion of the argument to the type of the result."""
        return self.emit(instruction, f"{self.x[0]} to {self.asm.type(self.gives, self.varying)}")

    def compare(self, how: str, first: str, second: str) -> str:
        """Emit LLVM's comparison `how` of two numbers that have the type of the arguments."""
        return self.emit(f"{'fcmp' if self.is_float else 'icmp'} {how}", first, second)

    def select(self, flag: str, yes: str, no: str) -> str:
        return self.asm.let(f"select {self.asm.type(BOOL, self.varying)} {flag}, {self.type} {yes}, {self.type} {no}")

    def intrinsic(self, name: str) -> str:
        return self.asm.intrinsic(name, self.x, self.dtype, self.varying)


class Rule(NamedTuple):
    """Rule of a primitive: `write` emits an application and returns its result; `kinds` of operands are supported."""

    write: Callable[[Application], str]
    kinds: str


def apply(asm: Assembly, name: str, entries: Sequence[Entry], gives: Any = None, params: Any = None) -> Operand:
    """Emit a primitive for one array element of each argument. The result has the first argument's type or `gives`.

    **Raises:** `Untranslatable` for types without a rule.
    """
    if name in COMPOSED:
        return COMPOSED[name](asm, entries)
    operands = [asm.register(entry) for entry in entries]
    rule, op = RULES[name], Application(asm, operands, gives, params)
    unlike = any(operand.dtype != op.dtype for operand in operands) and name != "pow"
    if op.dtype.kind not in rule.kinds or unlike:
        raise Untranslatable(f"{name} of {' and '.join(str(operand.dtype) for operand in operands)}")
    return Operand(rule.write(op), op.gives, op.varying)


def _clamp(asm: Assembly, entries: Sequence[Entry]) -> Operand:
    low, x, high = entries
    return apply(asm, "min", [apply(asm, "max", [x, low]), high])


def _select(asm: Assembly, entries: Sequence[Entry]) -> Operand:
    which, *cases = (asm.register(entry) for entry in entries)
    refuse_if(which.dtype != BOOL or len(cases) != 2, "a choice that is not between two by a boolean")
    no, yes = cases
    varying = any(operand.varying for operand in (which, no, yes))
    kind = asm.type(yes.dtype, varying)
    flags = asm.type(BOOL, which.varying)
    chosen = asm.let(f"select {flags} {which.text}, {kind} {asm.text(yes, varying)}, {kind} {asm.text(no, varying)}")
    return Operand(chosen, yes.dtype, varying)


def _arithmetic(of_floats: str, of_integers: str, op: Application) -> str:
    return op.emit(of_floats if op.is_float else of_integers, *op.x)


def _divide(remainder: bool, op: Application) -> str:
    """Emit a quotient or remainder.

    An integer division by 0 gives, as in XLA, the quotient -1 (all bits set) and the dividend as remainder.
    """
    dividend, divisor = op.x
    name = "rem" if remainder else "div"
    if op.is_float:
        return op.emit(f"f{name}", dividend, divisor)
    zero, safe = op.compare("eq", divisor, op.constant(0)), divisor
    if op.order == "s":
        # The least signed integer divided by -1 overflows, which kills the process (SIGFPE).
        minus = op.compare("eq", divisor, op.constant(-1))
        safe = op.select(minus, op.constant(1), divisor)
    safe = op.select(zero, op.constant(1), safe)
    result = op.emit(f"{op.order}{name}", dividend, safe)
    if op.order == "s":
        negative = op.constant(0) if remainder else op.negative(dividend)
        result = op.select(minus, negative, result)
    return op.select(zero, dividend if remainder else op.constant(-1), result)


def _shift(instruction: str, op: Application) -> str:
    """Emit a shift.

    If the number of bits to shift is negative or not less than the width, the result is, as in XLA, 0 or, for an
    arithmetic shift to the right, all sign bits.
    """
    bits, by = 8 * op.dtype.itemsize, op.operands[1].number
    shifted = op.emit(instruction, *op.x)
    if by is not None and 0 <= by < bits:
        return shifted
    beyond = op.emit("ashr", op.x[0], op.constant(bits - 1)) if instruction == "ashr" else op.constant(0)
    return op.select(op.compare("ult", op.x[1], op.constant(bits)), shifted, beyond)


def _compare(of_floats: str, of_integers: str, op: Application) -> str:
    how = of_integers if of_integers in ("eq", "ne") else op.order + of_integers
    return op.compare(of_floats if op.is_float else how, *op.x)


def _extremum(name: str, op: Application) -> str:
    """Emit a maximum or minimum. For floats, it is NaN if either operand is, and +0 counts as greater than -0."""
    if op.dtype == BOOL:
        return op.emit("or" if name == "max" else "and", *op.x)
    if not op.is_float:
        return op.intrinsic(op.order + name)
    first, second = op.x
    positive, wins_ties = zip(*(_signs(name, op.asm, operand) for operand in op.operands), strict=True)
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


def _signs(name: str, asm: Assembly, operand: Operand) -> tuple[bool, bool]:
    """Return whether an operand is known to be positive or +0, and whether it is right if both operands are equal.

    It is right if it is the zero with the right sign, or is known not to be zero.
    """
    number = operand.number
    if number is None:
        return operand.text in asm.positive, name == "max" and operand.text in asm.positive
    positive = not np.isnan(number) and not np.signbit(number)
    return positive, number != 0 or positive == (name == "max")


def _library_function(name: str, op: Application) -> str:
    """Emit calls of a function of the C library, one for each lane."""
    kind = element(op.dtype)
    function = name + ("f" if op.dtype.itemsize == 4 else "")
    if not op.varying:
        return op.asm.call(function, op.x, kind)
    result = "poison"
    for lane in range(op.asm.width):
        arguments = [op.emit("extractelement", argument, f"i64 {lane}") for argument in op.x]
        value = op.asm.call(function, arguments, kind)
        result = op.emit("insertelement", result, f"{kind} {value}", f"i64 {lane}")
    return result


def _power(op: Application) -> str:
    """Emit a power of floats. An integer exponent is converted to a float first, as in jax."""
    base, exponent = op.operands
    if exponent.dtype != base.dtype:
        exponent = apply(op.asm, "convert_element_type", [exponent], base.dtype)
    texts = [op.asm.text(operand, op.varying) for operand in (base, exponent)]
    return op.asm.intrinsic("pow", texts, op.dtype, op.varying)


def _absolute(op: Application) -> str:
    if not op.is_float:
        return op.select(op.compare("slt", op.x[0], op.constant(0)), op.negative(op.x[0]), op.x[0])
    result = op.intrinsic("fabs")
    op.asm.positive.add(result)
    return result


def _sign(op: Application) -> str:
    """Emit the sign of a number: 1, -1, or the number itself if it is 0 or NaN."""
    number, zero = op.x[0], op.constant(0)
    below, above = ("olt", "ogt") if op.is_float else (f"{op.order}lt", f"{op.order}gt")
    result = op.select(op.compare(below, number, zero), op.constant(-1), number)
    return op.select(op.compare(above, number, zero), op.constant(1), result)


def _integer_power(op: Application) -> str:
    """Emit a power by repeated squaring, in the same order as jax so that rounding errors are the same."""
    exponent, multiply = op.params["y"], "fmul" if op.is_float else "mul"
    refuse_if(exponent < 0 and not op.is_float, "a negative power of integers")
    power, result, remaining = op.x[0], None, abs(exponent)
    while remaining:
        if remaining % 2:
            result = power if result is None else op.emit(multiply, result, power)
        remaining //= 2
        if remaining:
            power = op.emit(multiply, power, power)
    if result is None:
        return op.constant(1)
    return result if exponent > 0 else op.emit("fdiv", op.constant(1), result)


def _reinterpret(op: Application) -> str:
    """Emit a reinterpretation of the bits of a number as another type."""
    unlike = op.gives.itemsize != op.dtype.itemsize or BOOL in (op.gives, op.dtype)
    refuse_if(unlike and op.gives != op.dtype, f"the bits of {op.dtype} as {op.gives}")
    # After a conversion of a type to itself, LLVM 22 omits a store.
    return op.x[0] if element(op.gives) == element(op.dtype) else op.cast("bitcast")


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
    return op.cast(how)


def _saturate(op: Application) -> str:
    """Emit a conversion of a float to an integer type that clips to the range of the type. NaN becomes 0."""
    asm, kind = op.asm, op.asm.type(op.gives, op.varying)  # raises `Untranslatable` for a type that LLVM lacks
    if op.gives.kind == "u":
        lanes = f"v{asm.width}" if op.varying else ""
        name = f"llvm.fptoui.sat.{lanes}{asm.suffix(op.gives)}.{lanes}{asm.suffix(op.dtype)}"
        return asm.call(name, op.x, kind, takes=op.type)
    # LLVM's saturating conversion would convert each lane separately. A power of two, the bound is exact as a float.
    limits, flags = np.iinfo(op.gives), asm.type(BOOL, op.varying)
    beyond = op.constant(-float(limits.min))
    inside = op.compare("olt", op.intrinsic("fabs"), beyond)
    result = asm.let(f"fptosi {op.type} {op.select(inside, op.x[0], op.constant(0))} to {kind}")
    for how, bound, limit in (("oge", beyond, limits.max), ("ole", op.constant(float(limits.min)), limits.min)):
        extreme = asm.text(literal(limit, op.gives), op.varying)
        result = asm.let(f"select {flags} {op.compare(how, op.x[0], bound)}, {kind} {extreme}, {kind} {result}")
    return result


COMPOSED: dict[str, Callable[[Assembly, Sequence[Entry]], Operand]] = {"clamp": _clamp, "select_n": _select}
"""Rules of primitives that are composed of others or that take arguments of several types."""

ROUNDING = {"AWAY_FROM_ZERO": "round", "TO_NEAREST_EVEN": "roundeven"}
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
    "neg": Rule(lambda op: op.emit("fneg", op.x[0]) if op.is_float else op.negative(op.x[0]), NUMBERS),
    "abs": Rule(_absolute, "fi"),
    "not": Rule(lambda op: op.emit("xor", op.x[0], op.constant(op.dtype == BOOL or -1)), INTEGERS + "b"),
    "sign": Rule(_sign, NUMBERS),
    "is_finite": Rule(lambda op: op.compare("olt", op.intrinsic("fabs"), op.constant(np.inf)), FLOATS),
    "integer_pow": Rule(_integer_power, NUMBERS),
    "square": Rule(lambda op: op.emit("fmul" if op.is_float else "mul", op.x[0], op.x[0]), NUMBERS),
    "round": Rule(lambda op: op.intrinsic(ROUNDING[op.params["rounding_method"].name]), FLOATS),
    "pow": Rule(_power, FLOATS),
    "bitcast_convert_type": Rule(_reinterpret, ANY),
    "convert_element_type": Rule(_convert, ANY),
    **{name: Rule(lambda op: op.x[0], ANY) for name in ("stop_gradient", "copy")},
    **{name: Rule(lambda op, name=name: op.intrinsic(name), FLOATS) for name in INTRINSICS},  # type: ignore[misc]
    **{name: Rule(partial(_library_function, name), FLOATS) for name in LIBRARY},
}

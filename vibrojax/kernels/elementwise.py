"""The primitives of jax that work on each entry by itself: each a rule that writes the instructions."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np

from vibrojax.kernels.assembly import Assembly
from vibrojax.kernels.operands import BOOL, Entry, Operand, Untranslatable, element, literal

Rule = Callable[["Applied"], str]


class Applied:
    """A primitive applied to one entry of each of its arguments: what a rule goes by.

    - `x`: texts of the arguments, all of them vectors where one is (`varying`).
    - `dtype`: type of the last argument; `gives`: of the result.
    """

    def __init__(self, asm: Assembly, params: Mapping[str, Any], entries: list[Entry], gives: np.dtype) -> None:
        operands = [asm.register(entry) for entry in entries]
        self.asm, self.params, self.gives, self.operands = asm, params, gives, operands
        self.varying = any(operand.varying for operand in operands)
        self.x = [asm.text(operand, self.varying) for operand in operands]
        self.dtype = operands[-1].dtype

    @property
    def type(self) -> str:
        return self.asm.type(self.dtype, self.varying)

    @property
    def is_float(self) -> bool:
        return self.dtype.kind == "f"

    def constant(self, number: Any) -> str:
        """A number of the arguments' type."""
        return self.asm.text(literal(number, self.dtype), self.varying)

    def compared(self, how: str, one: str, two: str) -> str:
        """A truth value by LLVM's comparison `how` of two numbers of the arguments' type."""
        return self.asm.let(f"{'fcmp' if self.is_float else 'icmp'} {how} {self.type} {one}, {two}")

    def chosen(self, flag: str, one: str, other: str) -> str:
        """`one` where the flag is set, else `other`."""
        return self.asm.let(
            f"select {self.asm.type(BOOL, self.varying)} {flag}, {self.type} {one}, {self.type} {other}"
        )


def applied(asm: Assembly, name: str, params: Mapping[str, Any], entries: list[Entry], gives: np.dtype) -> Operand:
    """What a primitive gives of one entry of each of its arguments; raises `Untranslatable` for one without a rule."""
    if name == "clamp":
        low, x, high = entries
        return applied(asm, "min", {}, [applied(asm, "max", {}, [x, low], gives), high], gives)
    if name == "select_n":
        return _selected(asm, entries)
    at = Applied(asm, params, entries, gives)
    if name not in RULES:
        raise Untranslatable(f"{name} of {at.dtype}")
    return Operand(RULES[name](at), np.dtype(gives), at.varying)


def _selected(asm: Assembly, entries: list[Entry]) -> Operand:
    which, *cases = (asm.register(entry) for entry in entries)
    if which.dtype != BOOL:
        raise Untranslatable("a choice between more than two")
    no, yes = cases
    varying = any(operand.varying for operand in (which, no, yes))
    kind = asm.type(yes.dtype, varying)
    flags = asm.type(BOOL, which.varying)
    chosen = asm.let(f"select {flags} {which.text}, {kind} {asm.text(yes, varying)}, {kind} {asm.text(no, varying)}")
    return Operand(chosen, yes.dtype, varying)


def _arithmetic(of_floats: str | None, of_integers: str | None, at: Applied) -> str:
    instruction = of_floats if at.is_float else of_integers
    if instruction is None:
        raise Untranslatable(f"arithmetic of {at.dtype}")
    return at.asm.let(f"{instruction} {at.type} {at.x[0]}, {at.x[1]}")


def _divided(remainder: bool, at: Applied) -> str:
    """Of integers with what jax has for a divisor of 0 (-1; the dividend), where the processor would stop."""
    x, by = at.x
    if at.is_float:
        return at.asm.let(f"{'frem' if remainder else 'fdiv'} {at.type} {x}, {by}")
    zero, minus = (at.compared("eq", by, at.constant(n)) for n in (0, -1))
    safe = at.chosen(zero, at.constant(1), at.chosen(minus, at.constant(1), by))
    found = at.asm.let(f"{'srem' if remainder else 'sdiv'} {at.type} {x}, {safe}")
    negative = at.constant(0) if remainder else at.asm.let(f"sub {at.type} {at.constant(0)}, {x}")
    return at.chosen(zero, x if remainder else at.constant(-1), at.chosen(minus, negative, found))


def _comparison(of_floats: str, of_integers: str, at: Applied) -> str:
    return at.compared(of_floats if at.is_float else of_integers, *at.x)


def _extreme(of_floats: str, of_integers: str, at: Applied) -> str:
    """The greater or the smaller; of floats NaN where either is."""
    if at.dtype == BOOL:
        return at.asm.let(f"{'or' if of_integers == 'smax' else 'and'} {at.type} {at.x[0]}, {at.x[1]}")
    if not at.is_float:
        return at.asm.intrinsic(of_integers, at.x, at.dtype, at.varying)
    one, two = at.x
    # Where either is NaN the comparison fails and gives the second; the first's own is put back.
    found = at.chosen(at.compared(of_floats, one, two), one, two)
    return at.chosen(at.compared("uno", one, one), one, found)


def _intrinsic(name: str, at: Applied) -> str:
    return at.asm.intrinsic(name, at.x, at.dtype, at.varying)


def _from_the_library(name: str, at: Applied) -> str:
    """By the C library's function, lane by lane."""
    kind = element(at.dtype)
    function = name + ("f" if at.dtype.itemsize == 4 else "")
    if not at.varying:
        return at.asm.call(function, at.x, kind)
    found = "poison"
    for lane in range(at.asm.width):
        taken = [at.asm.let(f"extractelement {at.type} {x}, i64 {lane}") for x in at.x]
        found = at.asm.let(f"insertelement {at.type} {found}, {kind} {at.asm.call(function, taken, kind)}, i64 {lane}")
    return found


def _negative(at: Applied) -> str:
    if at.is_float:
        return at.asm.let(f"fneg {at.type} {at.x[0]}")
    return at.asm.let(f"sub {at.type} {at.constant(0)}, {at.x[0]}")


def _absolute(at: Applied) -> str:
    if at.is_float:
        return _intrinsic("fabs", at)
    return at.chosen(at.compared("slt", at.x[0], at.constant(0)), _negative(at), at.x[0])


def _not(at: Applied) -> str:
    every = at.constant(True if at.dtype == BOOL else -1)
    return at.asm.let(f"xor {at.type} {at.x[0]}, {every}")


def _sign(at: Applied) -> str:
    """1, -1, or the number itself where it is 0 or NaN."""
    x, zero = at.x[0], at.constant(0)
    below, above = ("olt", "ogt") if at.is_float else ("slt", "sgt")
    found = at.chosen(at.compared(below, x, zero), at.constant(-1), x)
    return at.chosen(at.compared(above, x, zero), at.constant(1), found)


def _is_finite(at: Applied) -> str:
    return at.compared("olt", _intrinsic("fabs", at), at.constant(np.inf))


def _integer_power(at: Applied) -> str:
    def product(exponent: int) -> str:
        if exponent == 1:
            return at.x[0]
        half = product(exponent // 2)
        even = at.asm.let(f"fmul {at.type} {half}, {half}")
        return at.asm.let(f"fmul {at.type} {even}, {at.x[0]}") if exponent % 2 else even

    exponent = at.params["y"]
    if not at.is_float:
        raise Untranslatable("a power of integers")
    if exponent == 0:
        return at.constant(1)
    found = product(abs(exponent))
    return found if exponent > 0 else at.asm.let(f"fdiv {at.type} {at.constant(1)}, {found}")


def _rounded(at: Applied) -> str:
    return _intrinsic("roundeven" if int(at.params["rounding_method"]) == 1 else "round", at)


def _same_bits(at: Applied) -> str:
    if at.gives.itemsize != at.dtype.itemsize:
        raise Untranslatable("bits of another width")
    return at.asm.let(f"bitcast {at.type} {at.x[0]} to {at.asm.type(at.gives, at.varying)}")


def _converted(at: Applied) -> str:
    x, gives = at.x[0], at.gives
    to = at.asm.type(gives, at.varying)
    if gives == at.dtype:
        return x
    if gives == BOOL:
        return at.compared("une" if at.is_float else "ne", x, at.constant(0))
    wider = gives.itemsize > at.dtype.itemsize
    if at.dtype == BOOL or at.dtype.kind == "u":
        how = "uitofp" if gives.kind == "f" else "zext" if wider or at.dtype == BOOL else "trunc"
    elif at.is_float and gives.kind == "f":
        how = "fpext" if wider else "fptrunc"
    elif at.is_float:
        # Of a number that is too large LLVM has no value at all; frozen, it is some value.
        return at.asm.let(f"freeze {to} {at.asm.let(f'fptosi {at.type} {x} to {to}')}")
    else:
        how = "sitofp" if gives.kind == "f" else "sext" if wider else "trunc"
    if gives.itemsize == at.dtype.itemsize and gives.kind != "f" and not at.is_float and at.dtype != BOOL:
        return x
    return at.asm.let(f"{how} {at.type} {x} to {to}")


def _itself(at: Applied) -> str:
    return at.x[0]


# A product that is added may be rounded once with the sum (`contract`): no more is left to the compiler.
RULES: dict[str, Rule] = {
    "add": partial(_arithmetic, "fadd contract", "add"),
    "add_any": partial(_arithmetic, "fadd contract", "add"),
    "sub": partial(_arithmetic, "fsub contract", "sub"),
    "mul": partial(_arithmetic, "fmul contract", "mul"),
    "div": partial(_divided, False),
    "rem": partial(_divided, True),
    "and": partial(_arithmetic, None, "and"),
    "or": partial(_arithmetic, None, "or"),
    "xor": partial(_arithmetic, None, "xor"),
    "shift_left": partial(_arithmetic, None, "shl"),
    "shift_right_logical": partial(_arithmetic, None, "lshr"),
    "shift_right_arithmetic": partial(_arithmetic, None, "ashr"),
    "lt": partial(_comparison, "olt", "slt"),
    "gt": partial(_comparison, "ogt", "sgt"),
    "le": partial(_comparison, "ole", "sle"),
    "ge": partial(_comparison, "oge", "sge"),
    "eq": partial(_comparison, "oeq", "eq"),
    "ne": partial(_comparison, "une", "ne"),
    "max": partial(_extreme, "ogt", "smax"),
    "min": partial(_extreme, "olt", "smin"),
    "neg": _negative,
    "abs": _absolute,
    "not": _not,
    "sign": _sign,
    "is_finite": _is_finite,
    "integer_pow": _integer_power,
    "square": lambda at: at.asm.let(f"fmul {at.type} {at.x[0]}, {at.x[0]}"),
    "round": _rounded,
    "bitcast_convert_type": _same_bits,
    "convert_element_type": _converted,
    "stop_gradient": _itself,
    "copy": _itself,
    "copy_p": _itself,
    "pow": partial(_intrinsic, "pow"),
    **{name: partial(_intrinsic, name) for name in ("sqrt", "floor", "ceil", "exp", "exp2", "log", "sin", "cos")},
    **{
        name: partial(_from_the_library, name)
        for name in ("tan", "tanh", "sinh", "cosh", "asin", "acos", "atan", "asinh", "acosh", "atanh", "atan2")
        + ("expm1", "log1p", "cbrt", "erf", "erfc")
    },
}

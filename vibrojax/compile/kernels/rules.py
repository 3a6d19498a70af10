"""Operands of an elementwise rule, and the instructions that many rules share."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from vibrojax.compile.kernels.assembly import Assembly
from vibrojax.compile.kernels.operands import BOOL, Entry, literal

FLOATS, INTEGERS, NUMBERS, ANY = "f", "iu", "fiu", "fiub"
"""Kinds of operands, by numpy's letters: floats, signed and unsigned integers, booleans."""


class Application:
    """A primitive applied to one entry of each of its arguments.

    - `x`: texts of the arguments, all of them vectors if one is (`varying`).
    - `dtype`: type of the first argument; `gives`: of the result.
    """

    def __init__(self, asm: Assembly, params: Mapping[str, Any], entries: list[Entry], gives: np.dtype) -> None:
        operands = [asm.register(entry) for entry in entries]
        self.asm, self.params, self.gives, self.operands = asm, params, gives, operands
        self.varying = any(operand.varying for operand in operands)
        self.x = [asm.text(operand, self.varying) for operand in operands]
        self.dtype = operands[0].dtype

    @property
    def type(self) -> str:
        return self.asm.type(self.dtype, self.varying)

    @property
    def is_float(self) -> bool:
        return self.dtype.kind == "f"

    @property
    def order(self) -> str:
        """The prefix of LLVM's instructions for integers: `s` for signed ones, `u` for unsigned ones and booleans."""
        return "s" if self.dtype.kind == "i" else "u"

    def constant(self, number: Any) -> str:
        """Return a number of the arguments' type."""
        return self.asm.text(literal(number, self.dtype), self.varying)

    def compare(self, how: str, first: str, second: str) -> str:
        """Write LLVM's comparison `how` of two numbers of the arguments' type."""
        return self.asm.let(f"{'fcmp' if self.is_float else 'icmp'} {how} {self.type} {first}, {second}")

    def select(self, flag: str, yes: str, no: str) -> str:
        """Write a choice: `yes` if the flag is set, else `no`."""
        return self.asm.let(f"select {self.asm.type(BOOL, self.varying)} {flag}, {self.type} {yes}, {self.type} {no}")

    def intrinsic(self, name: str) -> str:
        """Write a call of one of LLVM's intrinsic functions."""
        return self.asm.intrinsic(name, self.x, self.dtype, self.varying)


class Rule(NamedTuple):
    """Writes the instructions of a primitive, and returns the register of the result; `kinds` are the operands'."""

    write: Callable[[Application], str]
    kinds: str

"""Elementwise translation rules: their operands, and the instructions that many of them share."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from vibrojax.compile.kernels.assembly import Assembly
from vibrojax.compile.kernels.operands import BOOL, Entry, literal

FLOATS, INTEGERS, NUMBERS, ANY = "f", "iu", "fiu", "fiub"
"""Kinds of operands, as numpy's kind codes: floats, signed and unsigned integers, booleans."""


class Application:
    """A primitive applied to one array element of each of its arguments.

    - `x`: IR texts of the arguments. If one argument is a vector, `varying` is True and all are vectors.
    - `dtype`: type of the first argument. `gives`: type of the result.
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
        """Prefix of LLVM's integer instructions: `s` for signed integers, `u` for unsigned integers and booleans."""
        return "s" if self.dtype.kind == "i" else "u"

    def constant(self, number: Any) -> str:
        """Return the IR text of a constant that has the type of the arguments."""
        return self.asm.text(literal(number, self.dtype), self.varying)

    def compare(self, how: str, first: str, second: str) -> str:
        """Emit LLVM's comparison `how` of two numbers that have the type of the arguments."""
        return self.asm.let(f"{'fcmp' if self.is_float else 'icmp'} {how} {self.type} {first}, {second}")

    def select(self, flag: str, yes: str, no: str) -> str:
        """Emit a selection: `yes` if the flag is set, else `no`."""
        return self.asm.let(f"select {self.asm.type(BOOL, self.varying)} {flag}, {self.type} {yes}, {self.type} {no}")

    def intrinsic(self, name: str) -> str:
        """Emit a call of an intrinsic function of LLVM with the arguments."""
        return self.asm.intrinsic(name, self.x, self.dtype, self.varying)


class Rule(NamedTuple):
    """Translation rule of an elementwise primitive.

    - `write`: emits the instructions of an application and returns the register of the result.
    - `kinds`: supported kinds of operands.
    """

    write: Callable[[Application], str]
    kinds: str

"""Faults that kernels once had, which the property test plants again and must find."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest

from vibrojax.compile import assembly, control, elementwise, selection
from vibrojax.compile.assembly import literal
from vibrojax.compile.elementwise import FLOATS, INTEGERS, NUMBERS, Application, Rule


def _loop_without_turns(patch: pytest.MonkeyPatch) -> None:
    right = assembly.Assembly.repeat
    patch.setattr(assembly.Assembly, "repeat", lambda asm, turns, turn: right(asm, max(turns, 1), turn))


def _booleans_compared(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(Application, "order", property(lambda op: "s" if op.dtype.kind in "ib" else "u"))


def _unsigned_compared(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(Application, "order", property(lambda op: "s" if op.dtype.kind in "iu" else "u"))


def _scan_from_the_end(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(control, "_row_of_turn", lambda asm, turn, params: turn)


def _fill_value(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(selection, "fill_value", lambda dtype, value: literal(np.nan if dtype.kind == "f" else 0, dtype))


def _wide_shift(patch: pytest.MonkeyPatch) -> None:
    """Shift by the lowest bits of the distance, as processors do. LLVM leaves such a shift undefined."""

    def shifted(instruction: str, op: Application) -> str:
        lowest = op.asm.let(f"and {op.type} {op.x[1]}, {op.constant(8 * op.dtype.itemsize - 1)}")
        return op.asm.let(f"{instruction} {op.type} {op.x[0]}, {lowest}")

    for name, instruction in (("left", "shl"), ("right_logical", "lshr"), ("right_arithmetic", "ashr")):
        patch.setitem(elementwise.RULES, f"shift_{name}", Rule(partial(shifted, instruction), INTEGERS))


def _float_to_integer(patch: pytest.MonkeyPatch) -> None:
    def frozen(op: Application) -> str:
        to = op.asm.type(op.gives, op.varying)
        return op.asm.let(f"freeze {to} {op.asm.let(f'fptosi {op.type} {op.x[0]} to {to}')}")

    patch.setattr(elementwise, "_saturate", frozen)


def _power_by_an_integer(patch: pytest.MonkeyPatch) -> None:
    patch.setitem(elementwise.RULES, "pow", Rule(lambda op: op.intrinsic("pow"), FLOATS))


def _square_of_integers(patch: pytest.MonkeyPatch) -> None:
    patch.setitem(
        elementwise.RULES,
        "square",
        Rule(lambda op: op.asm.let(f"fmul {op.type} {op.x[0]}, {op.x[0]}"), NUMBERS),
    )


COMPARED = ("lt", "gt", "le", "ge", "max", "min", "sort")

FAULTS: dict[str, tuple[Callable[[pytest.MonkeyPatch], Any], tuple[str, ...]]] = {
    "a loop without turns": (_loop_without_turns, ("scan", "while")),
    "booleans compared as signed": (_booleans_compared, COMPARED),
    "unsigned integers compared as signed": (_unsigned_compared, COMPARED),
    "a scan from the end runs forward": (_scan_from_the_end, ("scan",)),
    "rows that do not exist": (_fill_value, ("gather",)),
    "a shift by the width or more": (_wide_shift, ("shift_left", "shift_right_logical", "shift_right_arithmetic")),
    "a float beyond the integers": (_float_to_integer, ("convert_element_type",)),
    "an integer as an exponent": (_power_by_an_integer, ("pow",)),
    "a square of integers": (_square_of_integers, ("square",)),
}
"""How each fault is planted, and the primitives that contain it."""

"""Blocks of source for random functions: their values, and how a block chooses among them."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from hypothesis import strategies as st

DTYPES = {
    "f": ("float32", "float64"),
    "i": ("int8", "int16", "int32", "int64"),
    "u": ("uint8", "uint16", "uint32", "uint64"),
    "b": ("bool_",),
}
ANY = "fiub"
ROWS = ((), (), (1,), (2,), (3,))

EXACT, PRODUCT, ROUNDED = 0, 1, 2
"""Agreement of a kernel and XLA in a value. EXACT: to the last bit. PRODUCT: likewise, but a compiler may round it
together with a sum that follows. ROUNDED: to some roundings, because libraries round their functions differently.
Only rules that move numbers may follow an inexact value."""


def edges(dtype: str) -> list[Any]:
    """Return the numbers of a type at which rules tend to fail, with a few usual ones."""
    if dtype == "bool_":
        return [False, True]
    if dtype in DTYPES["f"]:
        limits = np.finfo(dtype)
        special = 0.0, -0.0, np.inf, -np.inf, np.nan, limits.max, limits.min
        special += limits.tiny, limits.tiny / 4, -limits.tiny / 2
        return [*map(float, special), 1.0, -1.0, 0.5, -2.5, 3.0, 7.25, 100.0, -300.0, 0.1, 1e10, -1e20]
    low, high = int(np.iinfo(dtype).min), int(np.iinfo(dtype).max)
    return [0, 1, 2, 3, 5, 7, 8, 31, 64, low, low + 1, high, high - 1, high // 2 + 1] + [-1, -2, -7, -100] * (low < 0)


def constants(dtype: str) -> list[Any]:
    """Return numbers for constants.

    XLA computes with them in advance, so none may lead to subnormal numbers. It replaces x + 0 by x, even for -0. For
    sinh of a constant NaN it returns meaningless numbers; arguments include NaN.
    """
    return [1.0, 0.5, -2.5, 3.0, -np.inf, np.inf] if dtype in DTYPES["f"] else edges(dtype)


@dataclass(frozen=True)
class Value:
    """A name in the source, and the properties of its value. `lanes`: whether lanes are its last axis."""

    name: str
    dtype: str
    rows: tuple[int, ...] = ()
    lanes: bool = True
    accuracy: int = EXACT

    @property
    def kind(self) -> str:
        return next(kind for kind, dtypes in DTYPES.items() if self.dtype in dtypes)

    @property
    def shape(self) -> str:
        sizes = [str(size) for size in self.rows] + ["L"] * self.lanes
        return f"({', '.join(sizes)}{',' * (len(sizes) == 1)})"


@dataclass
class Scope:
    """A block of source under construction. In a nested function (`depth` > 0) all values are exact."""

    draw: Callable[[Any], Any]
    write: Callable[["Scope"], None]
    values: list[Value]
    names: list[int]
    depth: int = 0
    lines: list[str] = field(default_factory=list)

    def fresh(self) -> str:
        self.names[0] += 1
        return f"v{self.names[0]}"

    def number(self, limit: int) -> int:
        """Return a random number below `limit`.

        It is made of bits, because hypothesis mixes constants of the loaded modules into draws of all other types.
        """
        bits = [self.draw(st.booleans()) for _ in range(limit.bit_length() + 3 if limit > 1 else 0)]
        return sum(bit << place for place, bit in enumerate(bits)) % limit

    def pick(self, options: Any) -> Any:
        options = list(options)
        return options[self.number(len(options))]

    def often(self, parts: int) -> bool:
        """Return True, except once in `parts` times."""
        return self.pick([True] * (parts - 1) + [False])

    def dtype(self, kinds: str) -> str:
        return self.pick([dtype for kind in kinds for dtype in DTYPES[kind]])

    def let(self, source: str, like: Value, **changes: Any) -> Value:
        """Write an assignment. The result has the properties of `like`, but is exact, and has the changes."""
        value = replace(like, **({"name": self.fresh(), "accuracy": EXACT} | changes))
        self.lines.append(f"{value.name} = {source}")
        self.values.append(value)
        return value

    def unpack(self, source: str, like: list[Value]) -> None:
        """Write several results of one expression."""
        results = [replace(value, name=self.fresh(), accuracy=EXACT) for value in like]
        self.lines.append(f"({tuple_of(results)}) = {source}")
        self.values += results

    def any(self, kinds: str = ANY, apart: bool = False, least: int = 0, lanes: bool | None = None) -> Value:
        """Return a value of some kinds, most often an existing one.

        `apart`: exact; `least`: with an axis of at least this many rows; `lanes`: with lanes, or without.
        """
        fitting = [value for value in self.values if value.kind in kinds and lanes in (None, value.lanes)]
        fitting = [value for value in fitting if not apart or value.accuracy == EXACT]
        fitting = [value for value in fitting if not least or (value.rows and value.rows[0] >= least)]
        if fitting and self.often(5):
            return self.pick(fitting)
        lanes = self.often(4) if lanes is None else lanes
        rows = (self.pick(range(least, 4)),) if least else self.pick(ROWS)
        return self.value(self.dtype(kinds), rows, lanes, apart)

    def same(self, like: Value, apart: bool = False, **changes: Any) -> Value:
        """Return a value of the same type and shape as another one, preferably not that one."""
        target = replace(like, **changes)
        return self.value(target.dtype, target.rows, target.lanes, apart, unlike=like)

    def value(
        self, dtype: str, rows: tuple[int, ...], lanes: bool, apart: bool = False, unlike: Value | None = None
    ) -> Value:
        """Return a value of a type and shape: an existing one, one made of another, or a constant."""
        usable = [value for value in self.values if value != unlike and (value.accuracy == EXACT or not apart)]
        same = [value for value in usable if (value.dtype, value.rows, value.lanes) == (dtype, rows, lanes)]
        if same and self.often(10):
            return self.pick(same)
        others = [value for value in usable if value.accuracy == EXACT and value.lanes <= lanes]
        others = [value for value in others if value.dtype == dtype] or others
        if not others or not self.often(6):
            return self._constant(Value("", dtype, rows, lanes))
        x = self.pick(others)
        if x.dtype != dtype:
            x = self.let(f"lax.convert_element_type({x.name}, jnp.{dtype})", x, dtype=dtype)
        return x if (x.rows, x.lanes) == (rows, lanes) else self._reshaped(x, replace(x, rows=rows, lanes=lanes))

    def _constant(self, blank: Value) -> Value:
        number = self.pick(constants(blank.dtype))
        text = f"float('{number}')" if blank.kind == "f" else repr(number)
        return self.let(f"jnp.full({blank.shape}, {text}, jnp.{blank.dtype})", blank)

    def _reshaped(self, x: Value, target: Value) -> Value:
        """Write one row of a value as every row of another one."""
        source = f"{x.name}[{self.pick(range(x.rows[0]))}]" if x.rows else x.name
        return self.let(f"lax.broadcast_in_dim({source}, {target.shape}, {(len(target.rows),) * x.lanes})", target)

    def carried(self) -> tuple[list[Value], list[Value]]:
        """Return some exact values for a nested function, and values like them for its arguments."""
        given = [self.any(apart=True) for _ in range(self.pick([1, 2, 3]))]
        return given, [replace(value, name=self.fresh()) for value in given]

    def inner(self, values: list[Value], closed: bool = False) -> "Scope":
        """Return the scope of a nested function; it sees the exact values around it, unless it is `closed`."""
        seen = [] if closed else [value for value in self.values if value.accuracy == EXACT]
        inner = Scope(self.draw, self.write, [*seen, *values], self.names, self.depth + 1)
        for _ in range(self.pick([0, 1, 2, 3])):
            self.write(inner)
        return inner

    def result(self, like: Value) -> Value:
        """Return a result like an argument, most often a change of it."""
        other = self.same(like, apart=True)
        if not self.often(4):
            return other
        calls = {"f": ["add", "sub", "max"], "b": ["bitwise_xor"]}.get(like.kind, ["add", "sub", "bitwise_xor"])
        return self.let(f"lax.{self.pick(calls)}({like.name}, {other.name})", like)

    def define(self, head: str, lines: list[str], result: str) -> None:
        """Write a nested function."""
        self.lines += [f"{head}:", *[f"    {line}" for line in [*lines, f"return {result}"]]]


def tuple_of(values: list[Value]) -> str:
    return "".join(f"{value.name}, " for value in values)

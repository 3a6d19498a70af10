"""The primitives of jax that bring entries of an array together: reductions, rows by their number, sorting."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jax.lax import GatherScatterMode

from vibrojax.compile.kernels.assembly import Assembly
from vibrojax.compile.kernels.elementwise import applied
from vibrojax.compile.kernels.operands import (
    BOOL,
    LANES,
    Entry,
    Operand,
    Slot,
    Untranslatable,
    Value,
    dtype_of,
    literal,
    literals,
    varies,
    without_lanes,
)

INT64 = np.dtype(np.int64)

Selected = Callable[[Assembly, Any, Sequence[Value]], list[Value]]
"""A rule: it writes an equation of a jaxpr for its arguments, and gives the results."""


def each(asm: Assembly, name: str, params: Any, values: Sequence[Value], gives: np.dtype) -> Value:
    """An elementwise primitive of whole arrays; what has no axes goes with every entry."""
    shape = np.broadcast_shapes(*(value.shape for value in values))
    spread = [np.broadcast_to(value, shape) for value in values]
    found = np.empty(shape, object)
    for index in np.ndindex(shape):
        found[index] = applied(asm, name, params, [value.item(index) for value in spread], gives)
    return found


def _reduction(name: str) -> Selected:
    def reduced(asm: Assembly, equation: Any, values: Sequence[Value]) -> list[Value]:
        [x], aval = values, equation.invars[0].aval
        for axis in sorted(equation.params["axes"], reverse=True):
            if aval.shape[axis] == LANES:
                across = np.empty(x.shape, object)
                for index in np.ndindex(x.shape):
                    across[index] = _across(asm, name, x.item(index))
                x = across.squeeze(axis)
                continue
            rows = np.moveaxis(x, axis, 0)
            if not len(rows):
                raise Untranslatable(f"reduce_{name} of no rows")
            x = rows[:1].squeeze(0)
            for row in range(1, len(rows)):
                x = each(asm, name, {}, [x, rows[row : row + 1].squeeze(0)], dtype_of(aval))
        return [x]

    return reduced


def _across(asm: Assembly, name: str, entry: Entry) -> Operand:
    """Whether any, or all, of the lanes of a vector."""
    x = asm.register(entry)
    if name not in ("or", "and") or x.dtype != BOOL:
        raise Untranslatable(f"{name} over lanes")
    if not x.varying:
        return x
    function = f"llvm.vector.reduce.{name}.v{asm.width}i1"
    return Operand(asm.call(function, [x.text], "i1", takes=asm.type(BOOL, True)), BOOL, False)


def _row_numbers(asm: Assembly, wanted: Value, rows: int, clipped: bool) -> Value:
    """Return row numbers as int64; where they are `clipped`, those beyond the ends become the first and the last."""
    if wanted.size and wanted.flat[0].dtype == np.uint64:
        raise Untranslatable("row numbers of type uint64")
    wanted = each(asm, "convert_element_type", {}, [wanted], INT64)
    if not clipped:
        return wanted
    ends = [literals(np.asarray(row, INT64)) for row in (0, rows - 1)]
    return each(asm, "clamp", {}, [ends[0], wanted, ends[1]], INT64)


def _in_memory(asm: Assembly, rows: Value) -> Value:
    """The rows of a column where a row's number tells where it lies: as they are, or copied there."""
    if _stride(rows) is not None:
        return rows
    slots = np.empty(rows.shape, object)
    for index in np.ndindex(rows.shape):
        slots[index] = asm.slot(rows[index].dtype, True, in_registers=False)
        asm.store(rows.item(index), slots.item(index))
    return slots


def _stride(rows: Value) -> int | None:
    """Bytes between the rows (first axis) of slots in the workspace; None where they are no such slots."""
    if not all(isinstance(entry, Slot) and entry.varying and entry.offset is not None for entry in rows.flat):
        return None
    offsets = np.vectorize(lambda slot: slot.offset, otypes=[int])(rows)
    strides = np.unique(np.diff(offsets, axis=0))
    return int(strides[0]) if len(strides) == 1 else 0 if len(rows) == 1 else None


class _Rows:
    """The rows that lanes ask for by their `number` (int64), of slots in the workspace.

    `there` tells which lanes ask for a row that exists.
    """

    def __init__(self, asm: Assembly, number: Entry, rows: Value) -> None:
        stride, lanes = _stride(rows), range(asm.width)
        assert stride is not None
        self.asm = asm
        above = applied(asm, "ge", {}, [number, literal(0, INT64)], BOOL)
        below = applied(asm, "lt", {}, [number, literal(len(rows), INT64)], BOOL)
        self.there = applied(asm, "and", {}, [above, below], BOOL)
        self._moved = applied(asm, "mul", {}, [number, literal(stride, INT64)], INT64)
        self._lanes = f"<{', '.join(f'i64 {lane}' for lane in lanes)}>"

    def places(self, first: Slot) -> str:
        """Write the pointers to the lanes' own numbers, where row 0 lies in `first`."""
        asm, many = self.asm, f"<{self.asm.width} x ptr>"
        kind = asm.type_in_memory(first.dtype, False)
        start = f"getelementptr i8, ptr {first.pointer}, <{asm.width} x i64> {asm.vector(self._moved)}"
        return asm.let(f"getelementptr {kind}, {many} {asm.let(start)}, <{asm.width} x i64> {self._lanes}")


def _gathered(asm: Assembly, equation: Any, values: Sequence[Value]) -> list[Value]:
    """Write for each lane the row that it asks for by number (`take_along_axis`).

    For a row that does not exist it is the fill value, or the nearest row, according to the mode.
    """
    rows, wanted = values
    numbers, mode = equation.params["dimension_numbers"], equation.params["mode"]
    [axis] = numbers.collapsed_slice_dims if len(numbers.collapsed_slice_dims) == 1 else [None]
    batched = getattr(numbers, "operand_batching_dims", ())
    if axis is None or numbers.start_index_map != (axis,) or numbers.offset_dims or len(batched) != rows.ndim - 1:
        raise Untranslatable("a gather that takes no rows along one axis")
    if equation.invars[0].aval.shape[axis] == LANES:
        raise Untranslatable("lanes by their number")
    rows = np.moveaxis(rows, axis, 0)
    if rows.size != len(rows) or not len(rows) or rows.flat[0].dtype == BOOL:
        raise Untranslatable("a gather of no rows, of rows beside lanes, or of booleans")
    rows = _in_memory(asm, rows.reshape(-1))
    first, varying = rows[0], varies(equation.outvars[0].aval)
    none = fill_value(first.dtype, equation.params["fill_value"])
    wanted = _row_numbers(asm, wanted, len(rows), clipped=mode != GatherScatterMode.FILL_OR_DROP)
    kind, flags = asm.type(first.dtype, True), asm.type(BOOL, True)
    function = f"llvm.masked.gather.v{asm.width}{asm.suffix(first.dtype)}.v{asm.width}p0"
    asm.declared.add(f"declare {kind} @{function}(<{asm.width} x ptr>, i32, {flags}, {kind})")
    taken = np.empty(wanted.shape[:-1], object)
    for index in np.ndindex(taken.shape):
        row = _Rows(asm, wanted[(*index, 0)], rows)
        given = f"<{asm.width} x ptr> {row.places(first)}, i32 {first.dtype.itemsize}, {flags} {asm.vector(row.there)}"
        x = asm.let(f"call {kind} @{function}({given}, {kind} {asm.vector(none)})")
        if not varying:
            x = asm.let(f"extractelement {kind} {x}, i64 0")
        taken[index] = Operand(x, first.dtype, varying)
    return [taken]


def fill_value(dtype: np.dtype, given: Any) -> Operand:
    """Return the number for rows that do not exist: the given one, or NaN, the least or the greatest integer."""
    if given is None:
        return literal(np.nan if dtype.kind == "f" else _limit(dtype), dtype)
    if not np.array_equal(np.asarray(given).astype(dtype), given, equal_nan=dtype.kind == "f"):
        raise Untranslatable(f"rows of type {dtype} filled with {given}")
    return literal(given, dtype)


def _limit(dtype: np.dtype) -> int:
    return int(np.iinfo(dtype).min if dtype.kind == "i" else np.iinfo(dtype).max)


def scattered(asm: Assembly, equation: Any, values: Sequence[Value], in_place: bool) -> list[Value]:
    """Write for each lane a new row in place of the one with its number; leave the rows if that does not exist.

    `in_place`: nothing else reads the rows as they were.
    """
    rows, wanted, new = values
    numbers, mode = equation.params["dimension_numbers"], equation.params["mode"]
    axes = numbers.scatter_dims_to_operand_dims
    if len(axes) != 1 or tuple(numbers.inserted_window_dims) != tuple(axes) or wanted.size != 1:
        raise Untranslatable("a scatter that replaces no row")
    [axis], shape = axes, equation.invars[0].aval.shape
    if LANES not in shape or shape[axis] == LANES:
        raise Untranslatable("a scatter into what lanes share")
    if varies(equation.invars[1].aval) and shape.index(LANES) not in numbers.operand_batching_dims:
        raise Untranslatable("a scatter into rows of other lanes")
    by_row = np.moveaxis(rows, axis, 0)
    if not by_row.size or new.size != by_row[0].size or by_row.flat[0].dtype == BOOL:
        raise Untranslatable("a scatter of no rows, of parts of rows, or of booleans")
    if not in_place or _stride(by_row) is None or not _are_distinct(by_row):
        by_row = _in_memory(asm, _in_registers(asm, by_row))
    wanted = _row_numbers(asm, wanted, len(by_row), clipped=mode == GatherScatterMode.CLIP)
    row, new = _Rows(asm, wanted.reshape(-1)[0], by_row), new.reshape(by_row.shape[1:])
    dtype = by_row.flat[0].dtype
    kind, flags = asm.type(dtype, True), asm.type(BOOL, True)
    function = f"llvm.masked.scatter.v{asm.width}{asm.suffix(dtype)}.v{asm.width}p0"
    asm.declared.add(f"declare void @{function}({kind}, <{asm.width} x ptr>, i32, {flags})")
    for index in np.ndindex(new.shape):
        places = row.places(by_row[(0, *index)])
        given = f"{kind} {asm.vector(new.item(index))}, <{asm.width} x ptr> {places}, i32 {dtype.itemsize}"
        asm.do(f"call void @{function}({given}, {flags} {asm.vector(row.there)})")
    asm.forget()
    return [np.moveaxis(by_row, 0, axis)]


def _are_distinct(slots: Value) -> bool:
    """Return whether no two entries share their memory, as those of a broadcast array do."""
    return len({slot.pointer for slot in slots.ravel().tolist()}) == slots.size


def _in_registers(asm: Assembly, entries: Value) -> Value:
    found = np.empty(entries.shape, object)
    for index in np.ndindex(found.shape):
        found[index] = asm.register(entries.item(index))
    return found


def _sorted(asm: Assembly, equation: Any, values: Sequence[Value]) -> list[Value]:
    """Rows in the order of the first array, NaN last; those alike stay as they are (odd-even transposition).

    The rows lie in memory and one loop goes over them, so that the text stays short.
    """
    axis, keys = equation.params["dimension"], equation.params["num_keys"]
    columns = [np.moveaxis(value, axis, 0) for value in values]
    count = len(columns[0])
    if keys != 1 or columns[0].size != count or equation.invars[0].aval.shape[axis] == LANES:
        raise Untranslatable("a sort by several keys, or beside lanes")
    dtypes = [dtype_of(var.aval) for var in equation.invars]
    varying = varies(equation.invars[0].aval)
    slots = [[asm.slot(dtype, varying, in_registers=False) for _ in range(count)] for dtype in dtypes]
    for places, column in zip(slots, columns, strict=True):
        for slot, entry in zip(places, column.reshape(-1), strict=True):
            asm.store(entry, slot)

    def swap(row: int) -> None:
        above, below = slots[0][row], slots[0][row + 1]
        wrong = applied(asm, "gt", {}, [above, below], BOOL)
        if above.dtype.kind == "f":
            last = applied(asm, "ne", {}, [above, above], BOOL)
            number = applied(asm, "eq", {}, [below, below], BOOL)
            wrong = applied(asm, "or", {}, [wrong, applied(asm, "and", {}, [last, number], BOOL)], BOOL)
        for places in slots:
            one, two = asm.register(places[row]), asm.register(places[row + 1])
            asm.store(applied(asm, "select_n", {}, [wrong, one, two], one.dtype), places[row])
            asm.store(applied(asm, "select_n", {}, [wrong, two, one], one.dtype), places[row + 1])

    def turn(number: str) -> None:
        for first in (0, 1):
            for row in range(first, count - 1, 2):
                swap(row)
            asm.forget()

    asm.repeated(-(-count // 2), turn)
    found = []
    for places, column in zip(slots, columns, strict=True):
        entries = np.empty(count, object)
        entries[:] = places
        found.append(np.moveaxis(entries.reshape(column.shape), 0, axis))
    return found


def _dynamic_slice(asm: Assembly, equation: Any, values: Sequence[Value]) -> list[Value]:
    """Rows from a number on that is known while the kernel is written."""
    x, *starts = values
    if (LANES in equation.invars[0].aval.shape) != (LANES in equation.params["slice_sizes"]):
        raise Untranslatable("some of the lanes")
    shape, sizes = without_lanes(equation.invars[0].aval.shape), without_lanes(equation.params["slice_sizes"])
    parts = []
    for length, size, start in zip(shape, sizes, starts, strict=True):
        entry = start.reshape(-1)[0]
        if size == length:
            parts.append(slice(None))
        elif isinstance(entry, Operand) and entry.is_literal:
            first = min(max(int(entry.text), 0), length - size)
            parts.append(slice(first, first + size))
        else:
            raise Untranslatable("rows from a number on that is not known beforehand")
    return [x[tuple(parts)]]


RULES: dict[str, Selected] = {
    "reduce_or": _reduction("or"),
    "reduce_and": _reduction("and"),
    "reduce_max": _reduction("max"),
    "reduce_min": _reduction("min"),
    "reduce_sum": _reduction("add"),
    "reduce_prod": _reduction("mul"),
    "gather": _gathered,
    "sort": _sorted,
    "dynamic_slice": _dynamic_slice,
}

"""Translation rules for primitives that combine array elements: reductions, row selection, sorting."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from jax.lax import GatherScatterMode

from vibrojax.compile.kernels.assembly import Assembly
from vibrojax.compile.kernels.elementwise import apply
from vibrojax.compile.kernels.operands import (
    BOOL,
    LANES,
    Entry,
    Operand,
    Slot,
    Untranslatable,
    Value,
    build,
    dtype_of,
    literal,
    literals,
    varies,
    without_lanes,
)

INT64 = np.dtype(np.int64)

SelectionRule = Callable[[Assembly, Any, Sequence[Value]], list[Value]]
"""A rule that emits an equation of a jaxpr for the equation's arguments and returns the equation's results."""


def apply_to_arrays(asm: Assembly, name: str, params: Any, values: Sequence[Value], gives: np.dtype) -> Value:
    """Emit an elementwise primitive of arrays, which are broadcast against each other."""
    spread = np.broadcast_arrays(*values)
    return build(
        spread[0].shape, lambda index: apply(asm, name, params, [value.item(index) for value in spread], gives)
    )


def _reduce(name: str, asm: Assembly, equation: Any, values: Sequence[Value]) -> list[Value]:
    [x], aval = values, equation.invars[0].aval
    for axis in sorted(equation.params["axes"], reverse=True):
        if aval.shape[axis] == LANES:
            x = build(x.shape, lambda index, x=x: _reduce_lanes(asm, name, x.item(index))).squeeze(axis)  # type: ignore[misc]
            continue
        rows = np.moveaxis(x, axis, 0)
        if not len(rows):
            raise Untranslatable(f"reduce_{name} of no rows")
        x = rows[:1].squeeze(0)
        for row in range(1, len(rows)):
            x = apply_to_arrays(asm, name, {}, [x, rows[row : row + 1].squeeze(0)], dtype_of(aval))
    return [x]


def _reduce_lanes(asm: Assembly, name: str, entry: Entry) -> Operand:
    """Emit a reduction ("or" or "and") of a boolean over all lanes of a group."""
    x = asm.register(entry)
    if name not in ("or", "and") or x.dtype != BOOL:
        raise Untranslatable(f"{name} over lanes")
    if not x.varying:
        return x
    function = f"llvm.vector.reduce.{name}.v{asm.width}i1"
    return Operand(asm.call(function, [x.text], "i1", takes=asm.type(BOOL, True)), BOOL, False)


def _row_numbers(asm: Assembly, numbers: Value, rows: int, clipped: bool) -> Value:
    """Return row numbers as int64; if `clipped`, they are clipped to the first and the last row."""
    if numbers.size and numbers.flat[0].dtype == np.uint64:
        raise Untranslatable("row numbers of type uint64")
    numbers = apply_to_arrays(asm, "convert_element_type", {}, [numbers], INT64)
    if not clipped:
        return numbers
    ends = [literals(np.asarray(row, INT64)) for row in (0, rows - 1)]
    return apply_to_arrays(asm, "clamp", {}, [ends[0], numbers, ends[1]], INT64)


def _in_memory(asm: Assembly, rows: Value) -> Value:
    """Return rows at equal distances in the workspace: the rows themselves if they are, otherwise copies."""
    if _stride(rows) is not None:
        return rows

    def copy(index: tuple[int, ...]) -> Slot:
        slot = asm.slot(rows[index].dtype, True, in_registers=False)
        asm.store(rows.item(index), slot)
        return slot

    return build(rows.shape, copy)


def _stride(rows: Value) -> int | None:
    """Return the distance of rows (first axis) in the workspace [bytes].

    Return None if array elements are not in the workspace or their distances are not all equal.
    """
    if not all(isinstance(entry, Slot) and entry.varying and entry.offset is not None for entry in rows.flat):
        return None
    offsets = np.vectorize(lambda slot: slot.offset, otypes=[int])(rows)
    strides = np.unique(np.diff(offsets, axis=0))
    return int(strides[0]) if len(strides) == 1 else 0 if len(rows) == 1 else None


class _RowSelection:
    """Selection of one row per lane by its `number` (int64). The rows are slots in the workspace.

    `exists` is a boolean vector: True in lanes whose row number is valid.
    """

    def __init__(self, asm: Assembly, number: Entry, rows: Value) -> None:
        stride = _stride(rows)
        assert stride is not None
        self._asm = asm
        above = apply(asm, "ge", {}, [number, literal(0, INT64)], BOOL)
        below = apply(asm, "lt", {}, [number, literal(len(rows), INT64)], BOOL)
        self.exists = apply(asm, "and", {}, [above, below], BOOL)
        self._bytes = apply(asm, "mul", {}, [number, literal(stride, INT64)], INT64)
        self._lanes = f"<{', '.join(f'i64 {lane}' for lane in range(asm.width))}>"

    def pointers(self, first: Slot) -> str:
        """Emit pointers to the selected value of each lane; `first` is the slot of row 0."""
        asm = self._asm
        kind = asm.type_in_memory(first.dtype, False)
        start = f"getelementptr i8, ptr {first.pointer}, <{asm.width} x i64> {asm.vector(self._bytes)}"
        return asm.let(f"getelementptr {kind}, <{asm.width} x ptr> {asm.let(start)}, <{asm.width} x i64> {self._lanes}")


def _gather(asm: Assembly, equation: Any, values: Sequence[Value]) -> list[Value]:
    """Emit the selection of one row per lane by its number (`take_along_axis`).

    For a number without a row, the result is the fill value or the nearest row, depending on the gather mode.
    """
    rows, numbers = values
    dims, mode = equation.params["dimension_numbers"], equation.params["mode"]
    [axis] = dims.collapsed_slice_dims if len(dims.collapsed_slice_dims) == 1 else [None]
    batched = getattr(dims, "operand_batching_dims", ())
    if axis is None or dims.start_index_map != (axis,) or dims.offset_dims or len(batched) != rows.ndim - 1:
        raise Untranslatable("a gather that takes no rows along one axis")
    if equation.invars[0].aval.shape[axis] == LANES:
        raise Untranslatable("lanes by their number")
    rows = np.moveaxis(rows, axis, 0)
    if rows.size != len(rows) or not len(rows) or rows.flat[0].dtype == BOOL:
        raise Untranslatable("a gather of no rows, of rows beside lanes, or of booleans")
    rows = _in_memory(asm, rows.reshape(-1))
    first, varying = rows[0], varies(equation.outvars[0].aval)
    fill = fill_value(first.dtype, equation.params["fill_value"])
    numbers = _row_numbers(asm, numbers, len(rows), clipped=mode != GatherScatterMode.FILL_OR_DROP)
    kind, flags = asm.type(first.dtype, True), asm.type(BOOL, True)
    function = f"llvm.masked.gather.v{asm.width}{asm.suffix(first.dtype)}.v{asm.width}p0"
    asm.declared.add(f"declare {kind} @{function}(<{asm.width} x ptr>, i32, {flags}, {kind})")

    def row_entry(index: tuple[int, ...]) -> Operand:
        row = _RowSelection(asm, numbers[(*index, 0)], rows)
        pointers = f"<{asm.width} x ptr> {row.pointers(first)}, i32 {first.dtype.itemsize}"
        mask = f"{flags} {asm.vector(row.exists)}"
        x = asm.let(f"call {kind} @{function}({pointers}, {mask}, {kind} {asm.vector(fill)})")
        if not varying:
            x = asm.let(f"extractelement {kind} {x}, i64 0")
        return Operand(x, first.dtype, varying)

    return [build(numbers.shape[:-1], row_entry)]


def fill_value(dtype: np.dtype, value: Any) -> Operand:
    """Return the fill value for rows that do not exist.

    If `value` is None, return NaN for floats, the least signed integer, or the greatest unsigned integer.
    """
    if value is None:
        if dtype.kind == "f":
            return literal(np.nan, dtype)
        return literal(np.iinfo(dtype).min if dtype.kind == "i" else np.iinfo(dtype).max, dtype)
    if not np.array_equal(np.asarray(value).astype(dtype), value, equal_nan=dtype.kind == "f"):
        raise Untranslatable(f"rows of type {dtype} filled with {value}")
    return literal(value, dtype)


def scatter(asm: Assembly, equation: Any, values: Sequence[Value], in_place: bool) -> list[Value]:
    """Emit the replacement of one row per lane, selected by its number. If no row has this number, nothing is replaced.

    `in_place`: True if no other equation reads the old rows, so that they may be overwritten.
    """
    rows, numbers, new = values
    dims, mode = equation.params["dimension_numbers"], equation.params["mode"]
    axes = dims.scatter_dims_to_operand_dims
    if len(axes) != 1 or tuple(dims.inserted_window_dims) != tuple(axes) or numbers.size != 1:
        raise Untranslatable("a scatter that replaces no row")
    [axis], shape = axes, equation.invars[0].aval.shape
    if LANES not in shape or shape[axis] == LANES:
        raise Untranslatable("a scatter into what lanes share")
    if varies(equation.invars[1].aval) and shape.index(LANES) not in dims.operand_batching_dims:
        raise Untranslatable("a scatter into rows of other lanes")
    by_row = np.moveaxis(rows, axis, 0)
    if not by_row.size or new.size != by_row[0].size or by_row.flat[0].dtype == BOOL:
        raise Untranslatable("a scatter of no rows, of parts of rows, or of booleans")
    slots = [entry for entry in by_row.ravel().tolist() if isinstance(entry, Slot)]
    shared = len({slot.pointer for slot in slots}) < by_row.size  # elements of a broadcast array share memory
    if not in_place or _stride(by_row) is None or shared:
        old = by_row
        by_row = _in_memory(asm, build(old.shape, lambda index: asm.register(old.item(index))))
    numbers = _row_numbers(asm, numbers, len(by_row), clipped=mode == GatherScatterMode.CLIP)
    row, new = _RowSelection(asm, numbers.reshape(-1)[0], by_row), new.reshape(by_row.shape[1:])
    dtype = by_row.flat[0].dtype
    kind, flags = asm.type(dtype, True), asm.type(BOOL, True)
    function = f"llvm.masked.scatter.v{asm.width}{asm.suffix(dtype)}.v{asm.width}p0"
    asm.declared.add(f"declare void @{function}({kind}, <{asm.width} x ptr>, i32, {flags})")
    for index in np.ndindex(new.shape):
        pointers = row.pointers(by_row[(0, *index)])
        values_and_pointers = f"{kind} {asm.vector(new.item(index))}, <{asm.width} x ptr> {pointers}"
        asm.do(f"call void @{function}({values_and_pointers}, i32 {dtype.itemsize}, {flags} {asm.vector(row.exists)})")
    asm.forget()
    return [np.moveaxis(by_row, 0, axis)]


def _sort(asm: Assembly, equation: Any, values: Sequence[Value]) -> list[Value]:
    """Emit a stable sort of the rows of arrays by the first array, with NaN last (odd-even transposition).

    The rows are in memory and the passes form one loop, so that the IR stays short.
    """
    axis, keys = equation.params["dimension"], equation.params["num_keys"]
    columns = [np.moveaxis(value, axis, 0) for value in values]
    count = len(columns[0])
    if keys != 1 or columns[0].size != count or equation.invars[0].aval.shape[axis] == LANES:
        raise Untranslatable("a sort by several keys, or beside lanes")
    dtypes = [dtype_of(var.aval) for var in equation.invars]
    varying = varies(equation.invars[0].aval)
    slots = [
        build((count,), lambda _, dtype=dtype: asm.slot(dtype, varying, in_registers=False))  # type: ignore[misc]
        for dtype in dtypes
    ]
    for places, column in zip(slots, columns, strict=True):
        for slot, entry in zip(places, column.reshape(-1), strict=True):
            asm.store(entry, slot)

    def swap(row: int) -> None:
        above, below = slots[0][row], slots[0][row + 1]
        wrong = apply(asm, "gt", {}, [above, below], BOOL)
        if above.dtype.kind == "f":
            last = apply(asm, "ne", {}, [above, above], BOOL)
            number = apply(asm, "eq", {}, [below, below], BOOL)
            wrong = apply(asm, "or", {}, [wrong, apply(asm, "and", {}, [last, number], BOOL)], BOOL)
        for places in slots:
            upper, lower = asm.register(places[row]), asm.register(places[row + 1])
            asm.store(apply(asm, "select_n", {}, [wrong, upper, lower], upper.dtype), places[row])
            asm.store(apply(asm, "select_n", {}, [wrong, lower, upper], upper.dtype), places[row + 1])

    def turn(number: str) -> None:
        for first in (0, 1):
            for row in range(first, count - 1, 2):
                swap(row)
            asm.forget()

    asm.repeat(-(-count // 2), turn)
    return [np.moveaxis(places.reshape(column.shape), 0, axis) for places, column in zip(slots, columns, strict=True)]


def _dynamic_slice(asm: Assembly, equation: Any, values: Sequence[Value]) -> list[Value]:
    """Return consecutive rows. The number of the first row must be a compile-time constant."""
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


REDUCTIONS = {
    "reduce_or": "or",
    "reduce_and": "and",
    "reduce_max": "max",
    "reduce_min": "min",
    "reduce_sum": "add",
    "reduce_prod": "mul",
}

RULES: dict[str, SelectionRule] = {
    **{name: partial(_reduce, of_two) for name, of_two in REDUCTIONS.items()},
    "gather": _gather,
    "sort": _sort,
    "dynamic_slice": _dynamic_slice,
}

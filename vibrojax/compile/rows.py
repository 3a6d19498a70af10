"""Translation rules for primitives that rearrange or combine array elements: reductions, row selection, sorting."""

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from vibrojax.compile.assembly import (
    BOOL,
    LANES,
    Assembly,
    Entry,
    Operand,
    Slot,
    Value,
    build,
    each,
    literal,
    literals,
    refuse_if,
    varies,
    without_lanes,
)
from vibrojax.compile.elementwise import apply


def _broadcast(equation: Any, x: Value) -> Value:
    shape = without_lanes(equation.params["shape"])
    spread = [1] * len(shape)
    for axis, length in zip(equation.params["broadcast_dimensions"], x.shape, strict=True):
        spread[axis] = length
    return np.broadcast_to(x.reshape(spread), shape)


def _reshape(equation: Any, x: Value) -> Value:
    before, after = equation.invars[0].aval.shape, equation.outvars[0].aval.shape
    # The array elements along the axes before the lane axis; None without a lane axis.
    rows = [math.prod(shape[: shape.index(LANES)]) if LANES in shape else None for shape in (before, after)]
    refuse_if(rows[0] != rows[1], "a shape that mixes lanes")
    return x.reshape(without_lanes(after))


def _slice(equation: Any, x: Value) -> Value:
    params, shape = equation.params, equation.invars[0].aval.shape
    ranges = zip(params["start_indices"], params["limit_indices"], params["strides"] or [1] * len(shape), strict=True)
    parts = []
    for length, (start, end, stride) in zip(shape, ranges, strict=True):
        refuse_if(length == LANES and (start, end, stride) != (0, LANES, 1), "some of the lanes")
        parts.append(slice(start, end, stride) if length != LANES else slice(None))
    return x[tuple(parts)]


def _dynamic_slice(equation: Any, x: Value, *starts: Value) -> Value:
    """Return consecutive rows. The number of the first row must be a compile-time constant."""
    shapes = equation.invars[0].aval.shape, equation.params["slice_sizes"]
    refuse_if((LANES in shapes[0]) != (LANES in shapes[1]), "some of the lanes")
    parts = []
    for length, size, start in zip(*map(without_lanes, shapes), starts, strict=True):
        entry, first = start.item(), 0
        if size != length:
            known = isinstance(entry, Operand) and entry.is_literal
            refuse_if(not known, "rows from a number on that is not known beforehand")
            first = min(max(int(entry.text), 0), length - size)
        parts.append(slice(first, first + size))
    return x[tuple(parts)]


def _iota(equation: Any) -> Value:
    shape, axis, dtype = (equation.params[name] for name in ("shape", "dimension", "dtype"))
    refuse_if(shape[axis] == LANES, "the numbers of lanes")
    numbers = np.arange(shape[axis]).astype(dtype).reshape([-1 if other == axis else 1 for other in range(len(shape))])
    return literals(np.broadcast_to(numbers, without_lanes(shape)))


def _unstack(equation: Any, x: Value) -> list[Value]:
    axis = equation.params["axis"]
    return [np.take(x, [index], axis).squeeze(axis) for index in range(x.shape[axis])]


def arrange(equation: Any, values: Sequence[Value]) -> list[Value]:
    """Return the results of an equation, or raise `Untranslatable` if the equation moves lanes."""
    name, params = equation.primitive.name, equation.params
    axes = np.atleast_1d(params[MOVED_AXES[name]]) if name in MOVED_AXES else ()
    moved = any(var.aval.shape[axis] == LANES for var in equation.invars for axis in axes)
    refuse_if(moved, f"{name} along the lanes")
    results = ARRANGEMENTS[name](equation, *values)
    return results if isinstance(results, list) else [results]


MOVED_AXES = {"concatenate": "dimension", "unstack": "axis", "split": "axis", "rev": "dimensions"}
"""Parameter of each primitive that holds the axes along which array elements move."""

ARRANGEMENTS: dict[str, Callable[..., Value | list[Value]]] = {
    "broadcast_in_dim": _broadcast,
    "reshape": _reshape,
    "squeeze": _reshape,
    "slice": _slice,
    "dynamic_slice": _dynamic_slice,
    "concatenate": lambda equation, *values: np.concatenate(values, equation.params["dimension"]),
    "stack": lambda equation, *values: np.stack(values, equation.params["axis"]),
    "unstack": _unstack,
    "split": lambda equation, x: np.split(x, np.cumsum(equation.params["sizes"])[:-1], equation.params["axis"]),
    "transpose": lambda equation, x: x.transpose(equation.params["permutation"]),
    "rev": lambda equation, x: np.flip(x, equation.params["dimensions"]),
    "iota": _iota,
    "optimization_barrier": lambda equation, *values: list(values),
}
"""Rules that take an equation and its arguments, return its result or the list of its results, and emit nothing."""

INT64 = np.dtype(np.int64)


def apply_to_arrays(
    asm: Assembly, name: str, values: Sequence[Value], gives: np.dtype | None = None, params: Any = None
) -> Value:
    """Emit an elementwise primitive of arrays, which are broadcast against each other."""
    return each(lambda *entries: apply(asm, name, entries, gives, params), *values)


def _reduce(name: str, asm: Assembly, equation: Any, values: Sequence[Value]) -> list[Value]:
    [x], aval = values, equation.invars[0].aval
    for axis in sorted(equation.params["axes"], reverse=True):
        if aval.shape[axis] == LANES:
            x = each(partial(_reduce_lanes, asm, name), x).squeeze(axis)
            continue
        rows = np.moveaxis(x, axis, 0)
        refuse_if(not len(rows), f"reduce_{name} of no rows")
        x = rows[:1].squeeze(0)
        for row in range(1, len(rows)):
            x = apply_to_arrays(asm, name, [x, rows[row : row + 1].squeeze(0)])
    return [x]


def _reduce_lanes(asm: Assembly, name: str, entry: Entry) -> Operand:
    """Emit a reduction ("or" or "and") of a boolean over all lanes of a group."""
    x = asm.register(entry)
    refuse_if(name not in ("or", "and") or x.dtype != BOOL, f"{name} over lanes")
    if not x.varying:
        return x
    function = f"llvm.vector.reduce.{name}.v{asm.width}i1"
    return Operand(asm.call(function, [x.text], "i1", takes=asm.type(BOOL, True)), BOOL, False)


def _row_numbers(asm: Assembly, numbers: Value, rows: int, clipped: bool) -> Value:
    """Return row numbers as int64; if `clipped`, they are clipped to the first and the last row."""
    refuse_if(numbers.size and numbers.flat[0].dtype == np.uint64, "row numbers of type uint64")
    numbers = apply_to_arrays(asm, "convert_element_type", [numbers], INT64)
    if not clipped:
        return numbers
    first, last = (literals(np.asarray(row, INT64)) for row in (0, rows - 1))
    return apply_to_arrays(asm, "clamp", [first, numbers, last])


def _in_memory(asm: Assembly, rows: Value) -> Value:
    """Return rows at equal distances in the workspace: the rows themselves if they are, otherwise copies."""
    if _stride(rows) is not None:
        return rows

    def copy(entry: Entry) -> Slot:
        slot = asm.slot(entry.dtype, True, in_registers=False)
        asm.store(entry, slot)
        return slot

    return each(copy, rows)


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
        above = apply(asm, "ge", [number, literal(0, INT64)], BOOL)
        below = apply(asm, "lt", [number, literal(len(rows), INT64)], BOOL)
        self.exists = apply(asm, "and", [above, below])
        self._bytes = apply(asm, "mul", [number, literal(stride, INT64)])
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
    axes, batched = dims.collapsed_slice_dims, getattr(dims, "operand_batching_dims", ())
    along_one = len(axes) == 1 and dims.start_index_map == axes and not dims.offset_dims
    refuse_if(not along_one or len(batched) != rows.ndim - 1, "a gather that takes no rows along one axis")
    refuse_if(equation.invars[0].aval.shape[axes[0]] == LANES, "lanes by their number")
    rows = np.moveaxis(rows, axes[0], 0)
    unsuitable = rows.size != len(rows) or not len(rows) or rows.flat[0].dtype == BOOL
    refuse_if(unsuitable, "a gather of no rows, of rows beside lanes, or of booleans")
    rows = _in_memory(asm, rows.reshape(-1))
    first, varying = rows[0], varies(equation.outvars[0].aval)
    fill = fill_value(first.dtype, equation.params["fill_value"])
    numbers = _row_numbers(asm, numbers, len(rows), clipped=mode.name != "FILL_OR_DROP")
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
    same = np.array_equal(np.asarray(value).astype(dtype), value, equal_nan=dtype.kind == "f")
    refuse_if(not same, f"rows of type {dtype} filled with {value}")
    return literal(value, dtype)


def scatter(asm: Assembly, equation: Any, values: Sequence[Value], in_place: bool) -> list[Value]:
    """Emit the replacement of one row per lane, selected by its number. If no row has this number, nothing is replaced.

    `in_place`: True if no other equation reads the old rows, so that they may be overwritten.
    """
    rows, numbers, new = values
    dims, mode = equation.params["dimension_numbers"], equation.params["mode"]
    axes, shape = dims.scatter_dims_to_operand_dims, equation.invars[0].aval.shape
    replaces = len(axes) == 1 and tuple(dims.inserted_window_dims) == tuple(axes) and numbers.size == 1
    refuse_if(not replaces, "a scatter that replaces no row")
    refuse_if(LANES not in shape or shape[axes[0]] == LANES, "a scatter into what lanes share")
    across = varies(equation.invars[1].aval) and shape.index(LANES) not in dims.operand_batching_dims
    refuse_if(across, "a scatter into rows of other lanes")
    by_row = np.moveaxis(rows, axes[0], 0)
    unsuitable = not by_row.size or new.size != by_row[0].size or by_row.flat[0].dtype == BOOL
    refuse_if(unsuitable, "a scatter of no rows, of parts of rows, or of booleans")
    slots = [entry for entry in by_row.ravel().tolist() if isinstance(entry, Slot)]
    shared = len({slot.pointer for slot in slots}) < by_row.size  # elements of a broadcast array share memory
    if not in_place or _stride(by_row) is None or shared:
        by_row = _in_memory(asm, each(asm.register, by_row))
    numbers = _row_numbers(asm, numbers, len(by_row), clipped=mode.name == "CLIP")
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
    return [np.moveaxis(by_row, 0, axes[0])]


def _sort(asm: Assembly, equation: Any, values: Sequence[Value]) -> list[Value]:
    """Emit a stable sort of the rows of arrays by the first array, with NaN last (odd-even transposition).

    The rows are in memory and the passes form one loop, so that the IR stays short.
    """
    axis, keys = equation.params["dimension"], equation.params["num_keys"]
    columns = [np.moveaxis(value, axis, 0) for value in values]
    count = len(columns[0])
    beside = columns[0].size != count or equation.invars[0].aval.shape[axis] == LANES
    refuse_if(keys != 1 or beside, "a sort by several keys, or beside lanes")
    slots = [asm.slots(var.aval, in_registers=False) for var in equation.invars]
    rows = [np.moveaxis(value, axis, 0).ravel() for value in slots]
    for column, places in zip(columns, rows, strict=True):
        asm.store_array(column, places)

    def swap(row: int) -> None:
        above, below = rows[0][row], rows[0][row + 1]
        wrong = apply(asm, "gt", [above, below], BOOL)
        if above.dtype.kind == "f":
            last, number = apply(asm, "ne", [above, above], BOOL), apply(asm, "eq", [below, below], BOOL)
            wrong = apply(asm, "or", [wrong, apply(asm, "and", [last, number])])
        for places in rows:
            upper, lower = asm.register(places[row]), asm.register(places[row + 1])
            asm.store(apply(asm, "select_n", [wrong, upper, lower]), places[row])
            asm.store(apply(asm, "select_n", [wrong, lower, upper]), places[row + 1])

    def turn(number: str) -> None:
        for first in (0, 1):
            for row in range(first, count - 1, 2):
                swap(row)
            asm.forget()

    asm.repeat(-(-count // 2), turn)
    return slots


REDUCTIONS = {
    "reduce_or": "or",
    "reduce_and": "and",
    "reduce_max": "max",
    "reduce_min": "min",
    "reduce_sum": "add",
    "reduce_prod": "mul",
}

RULES: dict[str, Callable[[Assembly, Any, Sequence[Value]], list[Value]]] = {
    **{name: partial(_reduce, of_two) for name, of_two in REDUCTIONS.items()},
    "gather": _gather,
    "sort": _sort,
}
"""Rules that emit an equation of a jaxpr for the equation's arguments and return the equation's results."""

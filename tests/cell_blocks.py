"""A reader of blocks of cells, the Python counterpart of `decodeCells` in the page."""

import json
import struct
from collections.abc import Sequence

import numpy as np

from vibrojax.explorer.encoding import STATE_LEVELS, TIME_LEVELS, Cell, StateColumn


def decode(block: bytes) -> list[Cell]:
    """Return the cells of a block. Numbers are exact to half a level."""
    (length,) = struct.unpack_from("<I", block)
    header = json.loads(block[4 : 4 + length])
    columns, section, headers = tuple(StateColumn(**c) for c in header["columns"]), header["section"], header["cells"]
    shapes = [s for h in headers for s in ((1 + len(columns), h["samples"]), (len(section), h["passed"]))]
    total = sum(rows * size for rows, size in shapes)
    payload = np.frombuffer(block, np.uint8, offset=4 + length)
    numbers = payload[:total].astype(np.uint16) | payload[total : 2 * total].astype(np.uint16) << 8
    parts = iter(np.split(numbers, np.cumsum([rows * size for rows, size in shapes], dtype=int)))
    tables = iter([next(parts).reshape(shape) for shape in shapes])
    flags = np.split(payload[2 * total :], np.cumsum([h["samples"] for h in headers], dtype=int))
    cells = []
    for own, own_flags in zip(headers, flags, strict=False):
        levels = np.cumsum(np.cumsum(next(tables), axis=1, dtype=np.uint16), axis=1, dtype=np.uint16).astype(float)
        returns = next(tables).astype(float)
        scales = own["scales"] or [[0.0, 0.0]] * len(columns)
        multipliers = own["multipliers"]
        cells.append(
            Cell(
                *(own[name] for name in ("lane", "kind", "note", "returns", "duration")),
                columns,
                levels[0] / TIME_LEVELS * own["duration"],
                {c.name: _scaled(row, scale) for c, row, scale in zip(columns, levels[1:], scales, strict=True)},
                own_flags.copy(),
                None if multipliers is None else np.array(multipliers, float).reshape(-1, 2),
                {n: _scaled(row, s) for n, row, s in zip(section, returns, own["section_scales"], strict=False)},
                own.get("numbers"),
                own.get("point"),
            )
        )
    return cells


def _scaled(levels: np.ndarray, scale: Sequence[float]) -> np.ndarray:
    least, greatest = scale
    return least + levels * ((greatest - least) / STATE_LEVELS)

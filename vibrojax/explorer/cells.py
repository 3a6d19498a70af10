"""A cell: what the page shows of one motion beyond its numbers; and cells as bytes, for page, server and widget alike.

**The form.** `encode(cells)` gives bytes, which the page's `decodeCells(buffer)` reads; a page embeds blocks of cells
so (deflated, in base64), a server answers with a block of one, a widget sends the same bytes over its channel.

    block   = uint32 (little-endian): length of the header in bytes
            | header: JSON in UTF-8
            | payload: low bytes of all numbers, high bytes of all numbers, flags of all samples

    header  = {"format": 1,
               "columns": [{"name", "units", "long_name"}, ...],     the states along time, in this order
               "section": ["x1", ...],                               the states at returns
               "cells": [{"lane":         number of the lane, row by row over the axes; -1 for what was simulated live
                          "kind":         "orbit" (it repeats), "motion" (so many returns of it) or "none"
                          "note":         what there is to say, as why there is none
                          "returns":      returns (pulses) in it
                          "duration":     s
                          "samples":      how many
                          "scales":       [least, greatest] of each column
                          "multipliers":  [[modulus, argument], ...] or null
                          "passed":       returns in the section's columns
                          "section_scales": [least, greatest] of each of them
                          "numbers":      {variable: value}, only of what was simulated live}]}

    numbers = of each cell its times, its columns, its section's columns, each a 16-bit integer: times from 0 to 16,383
              over the duration, states from 0 to `LEVELS` between least and greatest. Times and columns are stored as
              second differences (modulo 2^16), section columns as they are.
    flags   = one byte a sample: bits 0 to 2 the event at it (an index into `EVENTS`), bit 3 whether the bit sticks,
              bit 4 whether the striker touches it.

A cell of a lane that repeats has one repeat, from section to section, its last sample where its first one is.
"""

import json
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8

EVENTS = ("none", "stick", "slip", "impact", "release", "section")
"""Meaning of the event's number in a flag; as in `event_kind` of a trajectory."""

STUCK, TOUCHING = 8, 16
"""Bits of a flag."""

LEVELS = 2047
"""Steps between the least and the greatest value of a column: finer than any screen shows it."""

_TIMES = 16383

Samples = Float[np.ndarray, " samples"]


@dataclass(frozen=True)
class Column:
    """A state along time: its name, unit and meaning."""

    name: str
    units: str
    long_name: str


@dataclass(frozen=True)
class Cell:
    """One motion as the page shows it; see the module for what the fields mean.

    `time` [s] (samples,), from 0; `states` by name (samples,); `flags` (samples,); `section` by name (returns,).
    """

    lane: int
    kind: str
    note: str = ""
    returns: int = 0
    duration: float = 0.0
    columns: tuple[Column, ...] = ()
    time: Samples = field(default_factory=lambda: np.zeros(0))
    states: Mapping[str, Samples] = field(default_factory=dict)
    flags: UInt8[np.ndarray, " samples"] = field(default_factory=lambda: np.zeros(0, np.uint8))
    multipliers: Float[np.ndarray, "multipliers 2"] | None = None
    section: Mapping[str, Float[np.ndarray, " returns"]] = field(default_factory=dict)
    numbers: Mapping[str, Any] | None = None


def encode(cells: Sequence[Cell]) -> bytes:
    """Cells of one scene as a block."""
    columns = next((cell.columns for cell in cells if cell.columns), ())
    section = next((tuple(cell.section) for cell in cells if cell.section), ())
    headers, numbers, flags = [], [], []
    for cell in cells:
        empty = np.zeros(0)
        times = np.round(cell.time / (cell.duration or 1.0) * _TIMES).astype(np.uint16)
        states = [_levels(cell.states.get(one.name, empty)) for one in columns]
        passed = [_levels(cell.section.get(name, empty)) for name in section]
        numbers += [_differences(times), *(_differences(x) for x, _ in states), *(x for x, _ in passed)]
        flags.append(cell.flags)
        headers.append(
            {
                "lane": cell.lane,
                "kind": cell.kind,
                "note": cell.note,
                "returns": cell.returns,
                "duration": _short(cell.duration),
                "samples": len(cell.time),
                "scales": [scale for _, scale in states] if len(cell.time) else [],
                "multipliers": None
                if cell.multipliers is None
                else [[_short(x) for x in row] for row in cell.multipliers.tolist()],
                "passed": len(next(iter(cell.section.values()), empty)),
                "section_scales": [scale for _, scale in passed] if cell.section else [],
            }
            | ({} if cell.numbers is None else {"numbers": cell.numbers})
        )
    about = [{"name": one.name, "units": one.units, "long_name": one.long_name} for one in columns]
    whole = {"format": 1, "columns": about, "section": list(section), "cells": headers}
    header = json.dumps(whole, separators=(",", ":"), allow_nan=False).encode()
    every = np.concatenate(numbers) if numbers else np.zeros(0, np.uint16)
    payload = (every & 0xFF).astype(np.uint8).tobytes() + (every >> 8).astype(np.uint8).tobytes()
    return struct.pack("<I", len(header)) + header + payload + b"".join(x.astype(np.uint8).tobytes() for x in flags)


def decode(block: bytes) -> list[Cell]:
    """The cells of a block, their numbers as near as the levels are."""
    (length,) = struct.unpack_from("<I", block)
    header = json.loads(block[4 : 4 + length])
    columns = tuple(Column(**one) for one in header["columns"])
    section, wide = header["section"], 1 + len(columns)
    total = sum(wide * one["samples"] + len(section) * one["passed"] for one in header["cells"])
    payload = np.frombuffer(block, np.uint8, offset=4 + length)
    every = payload[:total].astype(np.uint16) | payload[total : 2 * total].astype(np.uint16) << 8
    flags, at, flag_at = payload[2 * total :], 0, 0
    cells = []
    for one in header["cells"]:
        n, passed = one["samples"], one["passed"]
        rows = every[at : at + wide * n].reshape(wide, n)
        at += wide * n
        rows = np.cumsum(np.cumsum(rows, axis=1, dtype=np.uint16), axis=1, dtype=np.uint16).astype(float)
        returns = every[at : at + len(section) * passed].reshape(len(section), passed).astype(float)
        at += len(section) * passed
        numbers = one.pop("numbers", None)
        scales = one["scales"] or [[0.0, 0.0]] * len(columns)
        states = {c.name: _read(row, s) for c, row, s in zip(columns, rows[1:], scales, strict=True)}
        cells.append(
            Cell(
                one["lane"],
                one["kind"],
                one["note"],
                one["returns"],
                one["duration"],
                columns,
                rows[0] / _TIMES * one["duration"],
                states,
                flags[flag_at : flag_at + n].copy(),
                None if one["multipliers"] is None else np.array(one["multipliers"], float).reshape(-1, 2),
                {name: _read(row, s) for name, row, s in zip(section, returns, one["section_scales"], strict=False)},
                numbers,
            )
        )
        flag_at += n
    return cells


def _levels(values: np.ndarray) -> tuple[np.ndarray, list[float]]:
    """Values as levels, and what the least and the greatest of them stand for."""
    if not values.size:
        return np.zeros(0, np.uint16), [0.0, 0.0]
    least, greatest = float(values.min()), float(values.max())
    step = (greatest - least) / LEVELS
    levels = np.round((values - least) / step) if step > 0 else np.zeros(values.shape)
    return levels.astype(np.uint16), [_short(least), _short(greatest)]


def _read(levels: np.ndarray, scale: Sequence[float]) -> np.ndarray:
    least, greatest = scale
    return least + levels * ((greatest - least) / LEVELS)


def _differences(levels: np.ndarray) -> np.ndarray:
    """Second differences modulo 2^16, of which two running sums give the levels again."""
    zero = np.zeros(1, np.uint16)
    return np.diff(np.diff(levels, prepend=zero), prepend=zero)


def _short(value: float) -> float:
    """The value to seven digits, as a header has it."""
    return float(f"{value:.7g}")

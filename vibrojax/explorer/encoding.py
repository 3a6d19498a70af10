"""Binary encoding of motions and arrays for the explorer page, its server and the widget.

`encode(cells)` returns a block of bytes, which `decodeCells(buffer)` in the page decodes. An HTML file embeds its
blocks deflated and in base64; a server or a widget sends a block of one `Cell`.

    block   = uint32 (little-endian): length of the header in bytes
            | header: JSON in UTF-8
            | payload: low bytes of all numbers, high bytes of all numbers, flags of all samples

    header  = {"format": 1,
               "columns": [{"name", "units", "long_name"}, ...],     the states along time, in this order
               "section": ["x1", ...],                               the states at section crossings
               "cells": [{"lane":         number of the lane, row by row over the axes; -1 if simulated live
                          "kind":         "orbit" (one period), "motion" (several crossings) or "none"
                          "note":         a remark, or the reason why there is no motion
                          "returns":      number of section crossings (pulses) in the motion
                          "duration":     s
                          "samples":      number of samples
                          "scales":       [least, greatest] of each column
                          "multipliers":  [[modulus, argument], ...] or null
                          "passed":       number of crossings in the section's columns
                          "section_scales": [least, greatest] of each section column
                          "numbers":      {variable: value}, only if simulated live
                          "point":        {"parameters": by name, "start"} of a lane, only if simulated live}]}

    numbers = for each `Cell` the times, columns and section columns, all as 16-bit integers. Times span 0 to
              `TIME_LEVELS` over the duration. States span 0 to `STATE_LEVELS` between least and greatest. Times and
              columns are stored as second differences (modulo 2^16), section columns without differences.
    flags   = one byte per sample. Bits 0 to 2: the event, an index into `EVENTS`. Bit 3: the bit sticks. Bit 4: the
              striker touches the bit.

The motion of a periodic lane is one period from section to section; its last sample coincides with its first.
"""

import base64
import json
import struct
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8

from vibrojax.errors import InputError

EVENTS = ("none", "stick", "slip", "impact", "release", "section", "switch", "slide")
"""Meanings of the event number in a sample's flag; the same as in `event_kind` of a trajectory."""

STUCK, TOUCHING = 8, 16  # bits of a sample's flag: the bit sticks, and the striker touches the bit
STATE_LEVELS = 2047  # intervals between the least and the greatest value of a column: finer than the pixels of a screen
TIME_LEVELS = 16383  # number of time intervals over the duration of a motion
MANTISSA_BITS = 16  # stored bits of a float's mantissa: five decimal digits

Samples = Float[np.ndarray, " samples"]


@dataclass(frozen=True)
class StateColumn:
    """Name, unit and meaning of a state along time."""

    name: str
    units: str
    long_name: str


@dataclass(frozen=True)
class Cell:
    """The motion that the page shows for one map cell; the module's docstring explains the fields.

    `time` [s] (samples,) starts at 0; `states` by name (samples,); `flags` (samples,); `section` by name (returns,).
    """

    lane: int
    kind: str
    note: str = ""
    returns: int = 0
    duration: float = 0.0
    columns: tuple[StateColumn, ...] = ()
    time: Samples = field(default_factory=lambda: np.zeros(0))
    states: Mapping[str, Samples] = field(default_factory=dict)
    flags: UInt8[np.ndarray, " samples"] = field(default_factory=lambda: np.zeros(0, np.uint8))
    multipliers: Float[np.ndarray, "multipliers 2"] | None = None
    section: Mapping[str, Float[np.ndarray, " returns"]] = field(default_factory=dict)
    numbers: Mapping[str, Any] | None = None
    point: Mapping[str, Any] | None = None


def encode(cells: Sequence[Cell]) -> bytes:
    """Return the motions of one scene, encoded as a block of bytes."""
    columns = next((cell.columns for cell in cells if cell.columns), ())
    section = next((tuple(cell.section) for cell in cells if cell.section), ())
    headers, words = [], [np.zeros(0, np.uint16)]
    for cell in cells:
        empty = np.zeros(0)
        times = np.round(cell.time / (cell.duration or 1.0) * TIME_LEVELS).astype(np.uint16)
        states = [_quantised(cell.states.get(column.name, empty)) for column in columns]
        returns = [_quantised(cell.section.get(name, empty)) for name in section]
        # Two cumulative sums modulo 2^16 restore the levels.
        words += [np.diff(x, 2, prepend=np.zeros(2, np.uint16)) for x in (times, *(levels for levels, _ in states))]
        words += [levels for levels, _ in returns]
        multipliers = cell.multipliers
        headers.append(
            {name: getattr(cell, name) for name in ("lane", "kind", "note", "returns")}
            | {
                "duration": _rounded(cell.duration),
                "samples": len(cell.time),
                "scales": [scale for _, scale in states] if len(cell.time) else [],
                "multipliers": None if multipliers is None else [[_rounded(x) for x in row] for row in multipliers],
                "passed": len(next(iter(cell.section.values()), empty)),
                "section_scales": [scale for _, scale in returns] if cell.section else [],
            }
            | {name: x for name in ("numbers", "point") if (x := getattr(cell, name)) is not None}
        )
    block_header = {"format": 1, "columns": [vars(c) for c in columns], "section": list(section), "cells": headers}
    header = json.dumps(block_header, separators=(",", ":"), allow_nan=False).encode()
    numbers = np.concatenate(words)
    low, high = (numbers & 0xFF).astype(np.uint8).tobytes(), (numbers >> 8).astype(np.uint8).tobytes()
    flags = b"".join(cell.flags.astype(np.uint8).tobytes() for cell in cells)
    return struct.pack("<I", len(header)) + header + low + high + flags


def pack(values: np.ndarray) -> dict[str, object]:
    """Return an array as {"dtype": "f4", "i1" or "i4", "shape", "data"}, which `unpack` in the page decodes.

    The bytes of all values are stored plane by plane (all first bytes, all second ones, ...), little-endian. Floats are
    rounded to a short mantissa, so that they deflate better.
    """
    limits = np.iinfo(np.int32)
    if values.dtype.kind == "f" or (values.size and not limits.min <= values.min() <= values.max() <= limits.max):
        dropped = 23 - MANTISSA_BITS
        with np.errstate(over="ignore"):  # a value beyond the range of 32 bits becomes infinite
            bits = np.ascontiguousarray(values, np.float32).view(np.uint32)
            bits = (bits + np.uint32(1 << (dropped - 1))) >> np.uint32(dropped) << np.uint32(dropped)
            array = np.where(np.isfinite(values), bits.view(np.float32), values).astype("<f4")
    else:
        is_small = values.size == 0 or (int(values.min()) >= -128 and int(values.max()) <= 127)
        array = values.astype("<i1" if is_small else "<i4")
    content = np.frombuffer(np.ascontiguousarray(array).tobytes(), np.uint8)
    planes = content.reshape(-1, array.itemsize).T.tobytes()
    return {"dtype": array.dtype.str[1:], "shape": list(values.shape), "data": deflate(planes)}


def deflate(content: bytes) -> str:
    """Return bytes deflated in the format of zlib, in base64. Level 9 takes six times as long, and saves 1 %."""
    return base64.b64encode(zlib.compress(content, 7)).decode()


def _quantised(values: np.ndarray) -> tuple[np.ndarray, list[float]]:
    """Return values quantised to integer levels, and the values of the lowest and the highest level."""
    if not values.size:
        return np.zeros(0, np.uint16), [0.0, 0.0]
    if not np.isfinite(values).all():
        raise InputError("explore: the motion has values that are not finite")
    least, greatest = float(values.min()), float(values.max())
    step = (greatest - least) / STATE_LEVELS
    levels = np.round((values - least) / step) if step > 0 else np.zeros(values.shape)
    return levels.astype(np.uint16), [_rounded(least), _rounded(greatest)]


def _rounded(value: float) -> float:
    return float(f"{value:.7g}")

"""Dialects of rig logs: the column names of each exporting software, and the units that the names leave out.

| dialect   | names like | units |
|-----------|------------|-------|
| pason     | `Hole Depth (feet)`, `ROP(1 ft)`, `YYYY/MM/DD` | in brackets |
| rigcloud  | `Total Depth`, `ROP Depth/Hour` | US field units, which the names leave out |
| usrop     | `Weight on Bit kkgf` | at the end of the name |
| witsml    | `DMEA`, `ROPA`, `SURF_RPM` | SI, with rev/s |
| las       | the mnemonics of a LAS 2.0 file | in its section ~Curve |
| semicolon | any of these with a unit, columns separated by semicolons | with the name |
| generic   | any of these with a unit | with the name |
| plain     | the names of the quantities, or those that the user gives | SI |
"""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from vibrojax.errors import InputError, shown, suggestion
from vibrojax.io.log_columns import BIT_DEPTH, DEPTH, RATE, ROTATION_SPEED, STICK_SLIP, TIME, WEIGHT, split_unit

_LEAST_SIGNS = 2
"""Least number of names of a dialect in a header, for the dialect to be detected."""

DATE = "date"
"""The day of a row, in a column of its own beside the time of the day."""

ALIASES = {
    DEPTH: "depth, hole depth, measured depth, total depth, dmea, dept, md",
    BIT_DEPTH: "bit depth, dbtm",
    RATE: "rop, rate of penetration, rop 1 ft, rop 1 m, rop depth hour, rop avg, ropa",
    WEIGHT: "weight on bit, wob, woba, wob avg",
    ROTATION_SPEED: "rotary speed, rotary rpm, top drive rpm, surf rpm, rpmx, rpma, rpm",
    "torque": "surface torque, top drive torque, rotary torque, torque, trq, tqa, tqx",
    "flow": "flow in, mud flow in, total pump output, mfia",
    "pressure": "pump press, pump pressure, standpipe pressure, sppa",
    "bit_diameter": "diameter, bit diameter, bit size, bs",
    STICK_SLIP: "surface stick slip index, stick slip index",
    TIME: "time, hh mm ss, date time, datetime",
    DATE: "yyyy mm dd, date",
}
_QUANTITIES = {alias: name for name, text in ALIASES.items() for alias in text.split(", ")}
_UNITS_IN_NAMES = {"rop 1 ft": "ft/h", "rop 1 m": "m/h", "stick slip index": "1", "surface stick slip index": "1"}


@dataclass(frozen=True)
class Dialect:
    """The names that only this dialect has (`signs`), and `units` by quantity for names without a unit."""

    name: str
    signs: frozenset[str] = frozenset()
    units: Mapping[str, str] | None = None


def _dialect(name: str, signs: str = "", **units: str) -> Dialect:
    return Dialect(name, frozenset(signs.split(", ")) - {""}, units)


DIALECTS = {
    dialect.name: dialect
    for dialect in (
        _dialect(
            "pason",
            "yyyy mm dd, hh mm ss, hole depth, rotary rpm, rotary torque, total pump output, hook load, rop 1 ft, "
            "rop 1 m, surface torque, pump press, temp out, differential pressure, surface stick slip index",
            time="s",
        ),
        _dialect(
            "rigcloud",
            "total depth, rop depth hour, top drive rpm, pump pressure",
            depth="ft",
            bit_depth="ft",
            rate_of_penetration="ft/h",
            weight_on_bit="klbf",
            rotary_speed="rpm",
            torque="ft lbf",
            flow="gal/min",
            pressure="psi",
            bit_diameter="in",
            time="s",
        ),
        _dialect("usrop", "measured depth, diameter, mud flow in, hookload, mud density in, average, kkgf", time="s"),
        _dialect(
            "witsml",
            "dmea, wob, rop avg, ropa, surf rpm, rpmx, rpma, trq, tqa, tqx, sppa, mfia, dbtm, woba",
            depth="m",
            bit_depth="m",
            rate_of_penetration="m/s",
            weight_on_bit="N",
            rotary_speed="rev/s",
            torque="N m",
            flow="m3/s",
            pressure="Pa",
            bit_diameter="m",
            time="s",
        ),
        _dialect("las", time="s"),
        _dialect("semicolon", time="s"),
        _dialect("generic", time="s"),
        _dialect("plain"),
    )
}


def normalised(name: str) -> str:
    """Return a column name in small letters, with one blank for all else than letters and digits."""
    return " ".join(re.findall(r"[a-z0-9]+", name.casefold())).removeprefix("average ")


def is_alias(name: str) -> bool:
    """Return whether a column name without a unit is known: "Rotary RPM" is, although it ends in a unit."""
    return normalised(name) in _QUANTITIES


def recognise(cell: str, dialect: Dialect) -> tuple[str, str | None, bool] | None:
    """Return the quantity and unit of a column by its name, and whether the unit is the dialect's; None if unknown.

    The unit is None if neither the name nor the dialect has one.
    """
    if dialect.name == "plain":
        return None
    whole = normalised(cell)
    if name := _QUANTITIES.get(whole):  # first: "SURF_RPM" is a name, not "SURF" in rpm
        return name, _UNITS_IN_NAMES.get(whole, (dialect.units or {}).get(name)), True
    base, unit = split_unit(cell)
    name = _QUANTITIES.get(normalised(base))
    return (name, unit, False) if name and unit else None


def detect_dialect(header: Iterable[str], separator: str) -> tuple[Dialect, str]:
    """Return the dialect of a header, and the reason as text; `separator` is that of the columns."""
    signs: dict[str, list[str]] = {name: [] for name, dialect in DIALECTS.items() if dialect.signs}
    known: list[str] = []
    for cell in header:
        base, unit = split_unit(cell)
        words = {normalised(cell), normalised(base), "average" if base.startswith("Average ") else "", str(unit)}
        for name, found in signs.items():
            if words & DIALECTS[name].signs:
                found.append(cell)
        if recognise(cell, DIALECTS["generic"]) and unit:
            known.append(cell)
    best = max(signs, key=lambda name: len(signs[name]))
    if separator == ";" and known:
        return DIALECTS["semicolon"], "semicolons separate its columns"
    if len(signs[best]) >= _LEAST_SIGNS:
        return DIALECTS[best], f"{len(signs[best])} of its names are there, such as {shown(signs[best][0])}"
    if known:
        return DIALECTS["generic"], f"{shown(known[0])} is a known name with a unit"
    return DIALECTS["plain"], "no name of another dialect is there"


def dialect_named(name: object) -> Dialect:
    """Return a dialect by its name; raise `InputError` if there is none."""
    if not isinstance(name, str) or name not in DIALECTS:
        raise InputError(f"dialect: {shown(name)} is unknown; {suggestion(str(name), DIALECTS)}")
    return DIALECTS[name]

"""Which column of rig data is what, and in which unit: by its name, or as the user says.

rate_of_penetration="ROP (m/h)"    the column ROP (m/h), ROP [m/h] or ROP_m/h; or ROP, whose numbers are in m/h
threshold="150 kN"                 no column: one value for all rows
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass

import xarray as xr

from vibrojax.errors import InputError, Place, nearest, shell_assignment, shown
from vibrojax.io.attributes import table_of
from vibrojax.models.physics.parameters import BIT_AND_STRIKER, CONTACT, ROTATION, Parameter, not_negative, table
from vibrojax.models.physics.pulses import PULSES
from vibrojax.models.physics.rock import ROCK
from vibrojax.models.physics.units import UNITS, factor, is_unit

RATE, RELIEF, FORCE, THRESHOLD = "rate_of_penetration", "relief", "mean_force", "threshold"

LAW = table(
    not_negative(RATE, 1e-3, "m s-1", "rate of penetration", "ROP", (1e-5, 1e-2)),
    not_negative(RELIEF, 1.0, "1", "mean force over threshold, P/D", "P/D", (0.05, 2.0)),
    not_negative(FORCE, 20e3, "N", "mean force on the bit", "P", (10e3, 500e3)),
    ROCK[THRESHOLD],
)
"""What the law is fitted to."""

KNOWN: Mapping[str, Parameter] = BIT_AND_STRIKER | CONTACT | ROTATION | PULSES | ROCK | LAW

_CALLED = {"rop": RATE, "penetration": RATE, "wob": FORCE, "weight": FORCE, "force": FORCE, "p/d": RELIEF}
"""What drillers call them."""
_NUMBER = re.compile(r"\s*([-+]?[\d.]+(?:[eE][-+]?\d+)?)\s*(.*?)\s*")
_IN_BRACKETS = re.compile(r"\s*(.*?)\s*[\[(]\s*([^\[\]()]*?)\s*[\])]\s*")


@dataclass(frozen=True)
class Column:
    """Where the values of one of our names come from.

    - `header`: of the file's column; `index`: which it is, None for a `value` [SI] that all rows have.
    - `unit`: what its numbers are in, which `factor` turns into SI; `assumed`: whether the file does not say so.
    """

    header: str
    index: int | None
    unit: str
    factor: float
    assumed: bool = False
    value: float | None = None

    def described(self) -> dict[str, object]:
        """What was taken, as JSON values: `column` of the file with its `unit`, or `value` [SI] that was `given_in`
        another; and whether that is `assumed`."""
        if self.index is None:
            return {"value": self.value, "given_in": self.unit, "assumed": self.assumed}
        return {"column": self.header, "unit": self.unit, "assumed": self.assumed}


def columns_lines(data: xr.Dataset) -> list[str]:
    """Return in words which column was taken for what, by the attribute `columns`; no lines without it."""
    return [_in_words(name, about) for name, about in table_of(data, "columns").items()]


def _in_words(name: str, about: Mapping[str, object]) -> str:
    named = about.get("unit", about.get("given_in"))
    unit = f"taken as {named}, since it names no unit" if about["assumed"] else f"in {named}"
    if "value" in about:
        si = next(iter(UNITS[KNOWN[name].unit])) if name in KNOWN else ""
        return f"{name}: {about['value']:g} {si} for all rows" + (f", {unit}" if about["assumed"] else "")
    return f"{name}: column {shown(about['column'])}, {unit}"


def choose(place: Place, header: list[str], columns: Mapping[str, str]) -> dict[str, Column]:
    """The columns by our names: those that the user says, and those that are called so, with a unit or without.

    **Arguments:** `place`: where the header stands; `header`: the names in the file; `columns`: what the user says.

    **Raises:** `InputError`.
    """
    chosen = {name: _said(Place("columns", name), header, name, text) for name, text in columns.items()}
    taken = {column.index: name for name, column in reversed(chosen.items()) if column.index is not None}
    for name, column in chosen.items():
        if column.index is not None and taken[column.index] != name:
            raise Place("columns", name).error(
                f"column {shown(column.header)} is {taken[column.index]} already; give another"
            )
    for index, cell in enumerate(header):
        name, unit = split_unit(cell)
        if cell in LAW:
            name, unit = cell, None
        if name not in KNOWN or (unit is None and name not in LAW) or index in taken:
            continue
        if name in columns:
            raise Place("columns", name).error(f"the file has a column {shown(cell)} too; rename that, or take it")
        if name in chosen:
            raise place.error(
                f"column {name} is there {sum(split_unit(h)[0] == name for h in header)} times; give it once"
            )
        chosen[name] = _in_unit(place.at(f"column {cell}"), name, cell, index, unit)
    return chosen


def needed(place: Place, header: list[str], chosen: Mapping[str, Column], columns: Mapping[str, str]) -> list[str]:
    """The names that the law needs, of those `chosen`; relief goes before force and threshold, unless these are said.

    **Raises:** `InputError` where one is missing.
    """
    by_force = RELIEF not in chosen or (RELIEF not in columns and bool({FORCE, THRESHOLD} & set(columns)))
    names = [RATE, FORCE, THRESHOLD] if by_force else [RATE, RELIEF]
    missing = [name for name in names if name not in chosen]
    if RATE in missing:
        raise place.error(f"column {RATE} [m/s] is missing; {_meant(RATE, header, chosen)}")
    if len(missing) == 2:
        meant = _meant(RELIEF if nearest(RELIEF, _free(header, chosen)) else FORCE, header, chosen)
        raise place.error(f"column {RELIEF} is missing, or {FORCE} and {THRESHOLD}; {meant}")
    if missing:
        meant = _meant(missing[0], header, chosen)
        fixed = f', or for all rows: --columns {THRESHOLD}="150 kN"' if missing[0] == THRESHOLD else ""
        raise place.error(f"column {missing[0]} [N] is missing, or {RELIEF}; {meant}{fixed}")
    return names


def split_unit(header: str) -> tuple[str, str | None]:
    """A column's name without its unit, and the unit: of "ROP (m/h)", "ROP [m/h]", "ROP, m/h" and "WOB_kN"."""
    found = _IN_BRACKETS.fullmatch(header)
    if found and found[1]:
        return found[1], found[2]
    for mark in ("_", ",", " "):
        name, _, unit = header.strip().rpartition(mark)
        if name.strip(" ,_") and unit.strip() not in ("1", "-") and is_unit(unit):
            return name.strip(" ,_"), unit.strip()
    return header.strip(), None


def _said(place: Place, header: list[str], name: str, text: str) -> Column:
    """The column that the user says for `name`."""
    if name not in KNOWN:
        raise place.error(f"is nothing that data have; choose from {', '.join(LAW)}, or a parameter of the scenes")
    same = _alike(header, text)
    base, unit = split_unit(text)
    if len(same) == 1:
        return _in_unit(place, name, header[same[0]], same[0], unit)
    if not same and unit is not None:
        same = _alike(header, base) or [
            i for i, cell in enumerate(header) if _plain(split_unit(cell)[0]) == _plain(base)
        ]
    elif not same:
        same = [i for i, cell in enumerate(header) if _plain(split_unit(cell)[0]) == _plain(text)]
    if len(same) > 1:
        alike = ", ".join(shown(header[i]) for i in same)
        raise place.error(f"{shown(text)} may be {alike}; give each column a name of its own, and that one here")
    if same:
        return _by_base(place, name, header[same[0]], same[0], unit)
    if (constant := _constant(place, name, text)) is not None:
        return constant
    like = nearest(base, header)
    hint = f"did you mean {shown(like)}?" if like else f"the file has {', '.join(map(shown, header))}"
    raise place.error(f"the file has no column {shown(text)}; {hint}")


def _by_base(place: Place, name: str, header: str, index: int, unit: str | None) -> Column:
    """A column said by its name alone, or by that and a unit of the user's own."""
    own = split_unit(header)[1]
    si = KNOWN[name].unit
    given = None if unit is None else factor(unit, si)
    if own is not None and given is not None and factor(own, si) not in (None, given):
        raise place.error(f"column {shown(header)} is in {own} by its name, not in {unit}; give one of them")
    return _in_unit(place, name, header, index, unit or own)


def _in_unit(place: Place, name: str, header: str, index: int, unit: str | None) -> Column:
    si = KNOWN[name].unit
    usual = next(iter(UNITS[si]))
    if unit is None:
        return Column(header, index, usual, 1.0, assumed=si != "1")
    scale = factor(unit, si)
    if scale is None:
        raise place.error(f"{shown(unit)} is no unit of {name}; choose from {', '.join(UNITS[si])}")
    return Column(header, index, unit, scale)


def _constant(place: Place, name: str, text: str) -> Column | None:
    """One value for all rows, with its unit; None where `text` is none."""
    found = _NUMBER.fullmatch(text)
    try:
        number = float(found[1]) if found else None
    except ValueError:
        number = None
    if found is None or number is None:
        return None
    column = _in_unit(place, name, text.strip(), 0, found[2] or None)
    value = number * column.factor
    if (problem := KNOWN[name].problem(value)) is not None:
        raise place.error(problem)
    return Column(column.header, None, column.unit, column.factor, column.assumed, value)


def _meant(name: str, header: list[str], chosen: Mapping[str, Column]) -> str:
    """What a column that is missing may be called in the file."""
    free = _free(header, chosen)
    called = [cell for cell in free if _CALLED.get(split_unit(cell)[0].casefold().partition(" ")[0]) == name]
    units = [(cell, split_unit(cell)[1]) for cell in free]
    of_kind = [cell for cell, unit in units if unit and factor(unit, KNOWN[name].unit) is not None]
    like = next(iter([*called, *of_kind]), None) or nearest(name, free)
    if like is None:
        return f"the file has {', '.join(column or 'a column without a name' for column in header)}"
    unit = "" if split_unit(like)[1] or name == RELIEF else f" ({next(iter(UNITS[KNOWN[name].unit]))})"
    return f"if {shown(like)} is it, rename it, or say so: --columns {shell_assignment(name, like + unit)}"


def _free(header: list[str], chosen: Mapping[str, Column]) -> list[str]:
    """The file's columns that are none of those chosen."""
    taken = {column.index for column in chosen.values()}
    return [cell for index, cell in enumerate(header) if cell and index not in taken]


def _alike(header: list[str], text: str) -> list[int]:
    """The columns called `text`, or, where there is none, called so but for capitals and blanks."""
    same = [index for index, cell in enumerate(header) if cell == text.strip()]
    return same or [index for index, cell in enumerate(header) if _plain(cell) == _plain(text)]


def _plain(text: str) -> str:
    return "".join(text.casefold().split())


def read_columns(words: list[str]) -> dict[str, str]:
    """The columns that words NAME="COLUMN (UNIT)" say; raises `InputError` where one is no such word."""
    columns: dict[str, str] = {}
    for word in words:
        name, equals, text = (part.strip() for part in word.partition("="))
        if not equals or not name or not text:
            example = f'{RATE}="ROP (m/h)"'
            raise InputError(f"--columns: {shown(word)} is no NAME=COLUMN; write one, like {example}")
        if name in columns:
            raise InputError(f"--columns: {name}: {shown(text)} is a second column; give one")
        columns[name] = text
    return columns

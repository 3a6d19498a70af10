"""Assignment of CSV columns of rig data to quantities, and the units of the columns.

rate_of_penetration="ROP (m/h)"    the column "ROP (m/h)", "ROP [m/h]" or "ROP_m/h"; or "ROP", taken to be in m/h
threshold="150 kN"                 no column: one value for all rows
rock="granite"                     the threshold of a rock of Table 4.5 of the source, for all rows
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import xarray as xr

from vibrojax.errors import InputError, Place, nearest, shell_assignment, shown, suggestion
from vibrojax.io.attributes import table_of
from vibrojax.physics.parameters import BIT_AND_STRIKER, CONTACT, ROTATION, Parameter, not_negative, table
from vibrojax.physics.rock import ROCK, ROCKS
from vibrojax.physics.units import UNITS, factor, is_unit
from vibrojax.scenes.penetration import PULSES

RATE, RELIEF, FORCE, THRESHOLD = "rate_of_penetration", "relief", "mean_force", "threshold"
WEIGHT, ROTATION_SPEED, DEPTH, BIT_DEPTH, TIME = "weight_on_bit", "rotary_speed", "depth", "bit_depth", "time"
STICK_SLIP, LINE = "stick_slip_index", "line"

LAW = table(
    not_negative(RATE, 1e-3, "m s-1", "rate of penetration", "ROP", (1e-5, 1e-2)),
    not_negative(RELIEF, 1.0, "1", "mean force over threshold, P/D", "P/D", (0.05, 2.0)),
    not_negative(FORCE, 20e3, "N", "mean force on the bit", "P", (10e3, 500e3)),
    ROCK[THRESHOLD],
)
"""The quantities that enter a fit of the rate-of-penetration law."""

RIG = table(
    not_negative(DEPTH, 1e3, "m", "depth of the hole", "h"),
    not_negative(BIT_DEPTH, 1e3, "m", "depth of the bit", "h"),
    not_negative(TIME, 0.0, "s", "time since the first row", "t"),
    not_negative(WEIGHT, 50e3, "N", "weight on bit", "WOB", (5e3, 500e3)),
    not_negative(ROTATION_SPEED, 10.0, "rad s-1", "rotary speed", "n", (1.0, 50.0)),
    not_negative("torque", 10e3, "N m", "torque", "T", (100.0, 100e3)),
    not_negative("flow", 0.03, "m3 s-1", "flow of mud", "Q", (1e-3, 0.2)),
    not_negative("pressure", 10e6, "Pa", "pressure of mud", "p", (1e5, 1e8)),
    not_negative("bit_diameter", 0.2, "m", "diameter of the bit", "d", (0.03, 1.5)),
    not_negative(STICK_SLIP, 0.0, "1", "stick-slip index as given", "SSI"),
    not_negative("impact_power", 10e3, "W", "power of the impacts on the bit", "P"),
)
"""Further quantities of a rig log."""

KNOWN: Mapping[str, Parameter] = BIT_AND_STRIKER | CONTACT | ROTATION | PULSES | ROCK | LAW | RIG

_DRILLING_TERMS = {"rop": RATE, "penetration": RATE, "wob": FORCE, "weight": FORCE, "force": FORCE, "p/d": RELIEF}
_DECIMAL_COMMA = re.compile(r",\d")
Guess = Callable[[str], tuple[str, str | None, bool] | None]
"""Function that returns the quantity and the unit of a column by its name, and whether the unit is not in the name."""

_NUMBER = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(.*?)\s*")
_BRACKETED = re.compile(r"\s*(.*?)\s*[\[(]\s*([^\[\]()]*?)\s*[\])]\s*")


@dataclass(frozen=True)
class Column:
    """The source of a quantity's values: a column of the file, or one `value` [SI] for all rows.

    `index` is the position of the column. It is None, and `header` the user's text, if there is only a `value`.
    `factor` converts numbers in `unit` to SI; `assumed` is True if `unit` is assumed because no unit is specified.
    """

    header: str
    index: int | None
    unit: str
    factor: float
    assumed: bool = False
    value: float | None = None

    def described(self) -> dict[str, object]:
        if self.index is None:
            return {"value": self.value, "given_in": self.unit, "assumed": self.assumed}
        return {"column": self.header, "unit": self.unit, "assumed": self.assumed}


def columns_lines(data: xr.Dataset) -> list[str]:
    """Return one line of text per entry of the attribute `columns`, or no lines without this attribute."""
    lines = []
    for name, source in table_of(data, "columns").items():
        written_in = source.get("unit", source.get("given_in"))
        unit = f", taken as {written_in}, since it names no unit" if source["assumed"] else f", in {written_in}"
        if "value" in source:
            si = UNITS[KNOWN[name].unit][0] if name in KNOWN else ""
            lines.append(f"{name}: {source['value']:g} {si} for all rows" + (unit if source["assumed"] else ""))
        else:
            lines.append(f"{name}: column {shown(source['column'])}{unit}")
    return lines


def read_columns(words: list[str]) -> dict[str, str]:
    """Return the columns by quantity from command-line words NAME="COLUMN (UNIT)".

    **Raises:** `InputError` for a word of another form, or if two words specify the same quantity.
    """
    columns: dict[str, str] = {}
    for word in words:
        name, equals, text = (part.strip() for part in word.partition("="))
        if not equals or not name or not text:
            example = f'{RATE}="ROP (m/h)"'
            raise InputError(f"--columns: {shown(word)} is not NAME=COLUMN; write, for example, {example}")
        if name in columns:
            raise InputError(f"--columns: {name}: {shown(text)} is a second column; give one")
        columns[name] = text
    return columns


def with_rock(columns: Mapping[str, str]) -> dict[str, str]:
    """Return `columns` with the threshold of the rock in place of `rock`, if that is given.

    **Raises:** `InputError` if the rock is unknown, or the threshold is given too.
    """
    columns = dict(columns)
    if "rock" not in columns:
        return columns
    place, name = Place("columns", "rock"), columns.pop("rock").strip()
    if name not in ROCKS:
        raise place.error(f"{shown(name)} is not a rock of the source; {suggestion(name, ROCKS)}")
    if given := {THRESHOLD, RELIEF} & set(columns):
        raise place.error(f"gives the {THRESHOLD}, and {given.pop()} is given too; give one of them")
    return columns | {THRESHOLD: f"{ROCKS[name].threshold:g} N"}


def split_unit(header: str) -> tuple[str, str | None]:
    """Split a header such as "ROP (m/h)", "ROP [m/h]", "ROP, m/h" or "WOB_kN" into its name and its unit.

    The unit is None if the header contains no unit.
    """
    bracketed = _BRACKETED.fullmatch(header)
    if bracketed and bracketed[1]:
        return bracketed[1], bracketed[2]
    for mark in ("_", ",", " "):
        name, _, unit = header.strip().rpartition(mark)
        if name.strip(" ,_") and unit.strip() not in ("1", "-") and is_unit(unit):
            return name.strip(" ,_"), unit.strip()
    return header.strip(), None


def choose_columns(
    place: Place, header: list[str], columns: Mapping[str, str], guess: Guess, units: Mapping[str, str]
) -> tuple[dict[str, Column], list[tuple[str, Column]], list[str]]:
    """Return the column of each quantity: the user's `columns`, columns with the quantity's name, and guessed ones.

    A header without a unit is recognised only for the quantities of the law, and means SI units. A header with a unit
    is recognised for every known quantity. `place` is the location of the `header` in the file; `guess` recognises the
    names of a dialect; `units` are the user's, by quantity, for guessed columns.

    The second result holds further columns of the same quantity by the same name, such as a depth in feet beside that
    in metres. The third holds notes on columns that were left out.
    """
    chosen = {name: _user_column(Place("columns", name), header, name, text) for name, text in columns.items()}
    taken = {column.index: name for name, column in reversed(chosen.items()) if column.index is not None}
    for name, column in chosen.items():
        if column.index is not None and taken[column.index] != name:
            raise Place("columns", name).error(
                f"column {shown(column.header)} is {taken[column.index]} already; give another"
            )
    for index, cell in enumerate(header):
        name, unit = (cell, None) if cell in LAW else split_unit(cell)
        if name not in KNOWN or (unit is None and name not in LAW) or index in taken:
            continue
        if name in columns:
            raise Place("columns", name).error(f"the file has a column {shown(cell)} too; rename that, or take it")
        if name in chosen:
            count = sum(split_unit(other)[0] == name for other in header)
            raise place.error(f"column {name} is there {count} times; give it once")
        chosen[name] = _column(Place(place.file, f"{place.key}, column {cell}"), name, cell, index, unit)
        taken[index] = name
    beside: list[tuple[str, Column]] = []
    notes: list[str] = []
    guesses = {
        index: recognised for index, cell in enumerate(header) if index not in taken and (recognised := guess(cell))
    }
    for index, (name, unit, assumed) in guesses.items():
        cell = header[index]
        if name in columns or name not in KNOWN:
            continue
        unit, si = units.get(name, unit), KNOWN[name].unit
        if name in (TIME, STICK_SLIP):  # times of the day have no unit; an index is kept as given
            column = Column(cell, index, unit or "1", factor(unit or "s", si) or 1.0 if name == TIME else 1.0)
        elif unit is None:
            notes.append(f"{name}: column {shown(cell)} names no unit and is left out")
            continue
        elif factor(unit, si) is None and name not in (RATE, WEIGHT, DEPTH):
            notes.append(f"{name}: column {shown(cell)} is in {unit}, not a unit of {name}, and is left out")
            continue
        else:
            own = _column(Place(place.file, f"{place.key}, column {cell}"), name, cell, index, unit)
            column = Column(cell, index, unit, own.factor, assumed and name not in units)
        if name in chosen:
            same = split_unit(cell)[0].casefold() == split_unit(chosen[name].header)[0].casefold()
            beside += [(name, column)] * same
            notes.append(f"{name}: column {shown(cell)} is another one, and is left out")
        else:
            chosen[name] = column
    return chosen, beside, notes


def required_names(
    place: Place, header: list[str], chosen: Mapping[str, Column], columns: Mapping[str, str]
) -> list[str]:
    """Return the names of the quantities required by the law: the rate, and either the relief or force and threshold.

    A relief in the file is ignored if the user specifies the force or the threshold but not the relief.

    **Raises:** `InputError` if a quantity is missing. The message suggests the column that is likely meant.
    """
    by_force = RELIEF not in chosen or (RELIEF not in columns and bool({FORCE, THRESHOLD} & set(columns)))
    names = [RATE, FORCE, THRESHOLD] if by_force else [RATE, RELIEF]
    missing = [name for name in names if name not in chosen]
    taken = {column.index for column in chosen.values()}
    free = [cell for index, cell in enumerate(header) if cell and index not in taken]
    if RATE in missing:
        raise place.error(f"column {RATE} [m/s] is missing; {_candidate(RATE, header, free)}")
    if len(missing) == 2:
        meant = _candidate(RELIEF if nearest(RELIEF, free) else FORCE, header, free)
        raise place.error(f"column {RELIEF} is missing, or {FORCE} and {THRESHOLD}; {meant}")
    if missing:
        constant = f', or for all rows: --columns {THRESHOLD}="150 kN", rock=granite or {THRESHOLD}=unknown'
        constant = constant if missing[0] == THRESHOLD else ""
        meant = _candidate(missing[0], header, free)
        raise place.error(f"column {missing[0]} [N] is missing, or {RELIEF}; {meant}{constant}")
    return names


def _user_column(place: Place, header: list[str], name: str, text: str) -> Column:
    """Return the column or the constant value that the user's `text` specifies for the quantity `name`."""
    if name not in KNOWN:
        raise place.error(f"is not a quantity of rig data; choose from {', '.join(LAW)}, or a parameter of the scenes")
    base, unit = split_unit(text)
    bases = [split_unit(cell)[0] for cell in header]
    matches = _matches(header, text) or _matches(header, base) or _matches(bases, base)
    if len(matches) > 1:
        candidates = ", ".join(shown(header[index]) for index in matches)
        raise place.error(f"{shown(text)} may be {candidates}; give each column a name of its own, and that one here")
    if matches:
        cell, own = header[matches[0]], split_unit(header[matches[0]])[1]
        factors = [factor(spelling, KNOWN[name].unit) for spelling in (unit, own) if spelling is not None]
        if len(factors) == 2 and None not in factors and factors[0] != factors[1]:
            raise place.error(f"column {shown(cell)} is in {own} by its name, not in {unit}; give one of them")
        return _column(place, name, cell, matches[0], unit or own)
    number = _NUMBER.fullmatch(text)
    if number and _DECIMAL_COMMA.match(number[2]):
        right = shown(text.replace(",", ".", 1))
        raise place.error(f"{shown(text)} has a decimal comma; write a point, like {right}")
    if number:
        column = _column(place, name, text.strip(), 0, number[2] or None)
        value = float(number[1]) * column.factor
        if (problem := KNOWN[name].problem(value)) is not None:
            raise place.error(problem)
        return Column(column.header, None, column.unit, column.factor, column.assumed, value)
    like = nearest(base, header)
    hint = f"did you mean {shown(like)}?" if like else f"the file has {', '.join(map(shown, header))}"
    raise place.error(f"the file has no column {shown(text)}; {hint}")


def _column(place: Place, name: str, header: str, index: int, unit: str | None) -> Column:
    """Return a column whose numbers are in `unit`, or in the SI unit if `unit` is None."""
    si = KNOWN[name].unit
    if unit is None:
        return Column(header, index, UNITS[si][0], 1.0, assumed=si != "1")
    scale = factor(unit, si)
    if scale is None:
        # A valid unit of another kind of quantity is no typing error: list all units instead of the most similar one.
        right = f"choose from {', '.join(UNITS[si])}" if is_unit(unit) else suggestion(unit, UNITS[si])
        raise place.error(f"{shown(unit)} is not a unit of {name}; {right}")
    return Column(header, index, unit, scale)


def _matches(names: list[str], text: str) -> list[int]:
    """Return the indices of the names equal to `text`; if there are none, ignore case and blanks."""

    def plain(name: str) -> str:
        return "".join(name.casefold().split())

    exact = [index for index, name in enumerate(names) if name == text.strip()]
    return exact or [index for index, name in enumerate(names) if plain(name) == plain(text)]


def _candidate(name: str, header: list[str], free: list[str]) -> str:
    """Return a hint for an error message: the unused (`free`) column that likely holds the missing quantity `name`."""
    units = {cell: split_unit(cell) for cell in free}
    likely = [cell for cell, (base, _) in units.items() if _DRILLING_TERMS.get(base.casefold().split(" ")[0]) == name]
    likely += [cell for cell, (_, unit) in units.items() if unit and factor(unit, KNOWN[name].unit) is not None]
    like = likely[0] if likely else nearest(name, free)
    if like is None:
        return f"the file has {', '.join(cell or 'a column without a name' for cell in header)}"
    unit = "" if units[like][1] or name == RELIEF else f" ({UNITS[KNOWN[name].unit][0]})"
    return f"if {shown(like)} is it, rename it, or name it: --columns {shell_assignment(name, like + unit)}"

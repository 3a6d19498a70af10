"""Assignment of the columns of a rig log to quantities, and the units of the columns.

rate_of_penetration="ROP (m/h)"    the column "ROP (m/h)", "ROP [m/h]" or "ROP_m/h"; or "ROP", taken to be in m/h
threshold="150 kN"                 no column: one value for all rows
rock="granite"                     the threshold of a rock of Table 4.5 of the source, for all rows
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace

from vibrojax.errors import InputError, Place, nearest, shell_assignment, shown, suggestion
from vibrojax.physics.parameters import BIT_AND_STRIKER, CONTACT, ROTATION, Parameter, not_negative, table
from vibrojax.physics.rock import ROCK, ROCKS
from vibrojax.physics.units import UNITS, factor, is_unit, likely_units
from vibrojax.scenes.penetration import PULSES

RATE, RELIEF, FORCE, THRESHOLD = "rate_of_penetration", "relief", "mean_force", "threshold"
WEIGHT, ROTATION_SPEED, DEPTH, BIT_DEPTH, TIME = "weight_on_bit", "rotary_speed", "depth", "bit_depth", "time"
STICK_SLIP, LINE, DATE = "stick_slip_index", "line", "date"

LAW = table(
    not_negative(RATE, 1e-3, "m s-1", "rate of penetration", "ROP", (1e-5, 1e-2)),
    not_negative(RELIEF, 1.0, "1", "mean force divided by the threshold, P/D", "P/D", (0.05, 2.0)),
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

_ALIASES = {
    DEPTH: "depth, hole depth, measured depth, total depth, dmea, dept, md",
    BIT_DEPTH: "bit depth, dbtm",
    RATE: "rop, rate of penetration, rop 1 ft, rop 1 m, rop depth hour, rop avg, ropa",
    WEIGHT: "weight on bit, wob, woba, wob avg",
    ROTATION_SPEED: "rotary speed, rotary rpm, top drive rpm, surf rpm, surface rpm, rpmx, rpma, rpm",
    "torque": "surface torque, top drive torque, rotary torque, torque, trq, tq, tqa, tqx",
    "flow": "flow in, mud flow in, total pump output, mfia",
    "pressure": "pump press, pump pressure, standpipe pressure, stand pipe pressure, spp, sppa",
    "bit_diameter": "diameter, bit diameter, bit size, bs",
    STICK_SLIP: "surface stick slip index, stick slip index",
    TIME: "time, hh mm ss, date time, datetime",
    DATE: "yyyy mm dd, date",
}
_QUANTITIES = {alias: name for name, text in _ALIASES.items() for alias in text.split(", ")}
_UNITS_IN_NAMES = {"rop 1 ft": "ft/h", "rop 1 m": "m/h"}

# Only RigCLOUD's exports have a column of this name. They are in US field units, and do not say so.
_FIELD_SIGN = "rop depth hour"
_FIELD_UNITS = {"m": "ft", "m s-1": "ft/h", "N": "klbf", "rad s-1": "rpm", "N m": "ft lbf", "m3 s-1": "gal/min"}
_FIELD_UNITS |= {"Pa": "psi"}

_TIME_FORMAT = re.compile(r"[a-z .:/-]*:[a-z .:/-]*|unitless|date ?time", re.IGNORECASE)
"""What exports write in place of the unit of times as texts."""

_MARGIN = 2.0  # ratio to the range of rigs beyond which the median of a column without a unit is in another unit

_NUMBER = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(.*?)\s*")
_BRACKETED = re.compile(r"\s*(.*?)\s*[\[(]\s*([^\[\]()]*?)\s*[\])]\s*")


@dataclass(frozen=True)
class Column:
    """The source of a quantity's values: the column `index` of the file, or, if that is None, one `value` [SI].

    `header` is the column's name, or the user's text. `factor` converts numbers in `unit` to SI; `assumed` is True if
    no unit is specified.
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


def read_columns(words: list[str]) -> dict[str, str]:
    """Return the columns by quantity from command-line words NAME="COLUMN (UNIT)".

    **Raises:** `InputError` for a word of another form, or if two words specify the same quantity.
    """
    columns: dict[str, str] = {}
    for word in words:
        name, _, text = (part.strip() for part in word.partition("="))
        if not name or not text:
            raise InputError(f'--columns: {shown(word)} is not NAME=COLUMN; write one, like {RATE}="ROP (m/h)"')
        if name in columns:
            raise InputError(f"--columns: {name}: {shown(text)} is a second column; give one")
        columns[name] = text
    return columns


def checked_columns(columns: object) -> dict[str, str]:
    """Return the user's `columns`, checked, with the threshold of a `rock` in its place; raise `InputError`."""
    if columns is not None and not isinstance(columns, Mapping):
        raise InputError(f'columns: {shown(columns)} does not name columns; give a dict like {{"{RATE}": "ROP (m/h)"}}')
    columns, choices = dict(columns or {}), dict.fromkeys((*LAW, "rock", *RIG, *KNOWN))
    for name, text in columns.items():
        here = Place("columns", str(name))
        if name not in choices:
            like = _QUANTITIES.get(normalised(str(name))) or nearest(str(name), choices)
            hint = f"did you mean {shown(like)}? " if like else ""
            raise here.error(f"is not a quantity of rig data; {hint}choose from {', '.join(choices)}")
        if not isinstance(text, str) or not text.strip():
            raise here.error(f'{shown(text)} is not a column; write one with its unit, like {name}="ROP (m/h)"')
    if rock := columns.pop("rock", "").strip():
        place, given = Place("columns", "rock"), {THRESHOLD, RELIEF} & set(columns)
        if rock not in ROCKS:
            raise place.error(f"{shown(rock)} is not a rock of the source; {suggestion(rock, ROCKS)}")
        if given:
            raise place.error(f"gives the {THRESHOLD}, and {given.pop()} is given too; give one of them")
        columns[THRESHOLD] = f"{ROCKS[rock].threshold:g} N"
    return columns


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


def recognise(cell: str) -> tuple[str | None, str | None]:
    """Return the quantity and the unit of a column by its name; None for a quantity or a unit that is unknown."""
    whole = normalised(cell)
    if cell in KNOWN:
        return cell, None
    if name := _QUANTITIES.get(whole):  # first: "SURF_RPM" is a name, not "SURF" in rpm
        return name, _UNITS_IN_NAMES.get(whole)
    base, unit = split_unit(cell)
    return (base if base in KNOWN else _QUANTITIES.get(normalised(base))), unit


def number_of(text: str) -> tuple[float | None, str]:
    """Return the number at the beginning of a text (None: there is none) and what follows it, such as a unit."""
    parts = _NUMBER.fullmatch(text)
    return (float(parts[1]), parts[2]) if parts else (None, "")


def normalised(name: str) -> str:
    """Return a column name in small letters, with one blank for all else than letters and digits."""
    return " ".join(re.findall(r"[a-z0-9]+", name.casefold())).removeprefix("average ")


def choose_columns(place: Place, header: list[str], columns: Mapping[str, str]) -> tuple[dict[str, Column], list[str]]:
    """Return the column of each quantity, and notes on those left out: the user's `columns`, and those of known names.

    `place` is the location of the `header` in the file. Parameters of scenes need a unit or the user's word.
    """
    chosen, taken, notes = dict[str, Column](), dict[int | None, str](), list[str]()
    for name, text in columns.items():
        here = Place("columns", name)
        chosen[name] = column = _user_column(here, header, name, text)
        if column.index is not None and column.index in taken:
            raise here.error(f"column {shown(column.header)} is {taken[column.index]} already; give another")
        taken[column.index] = name
    is_field = any(normalised(cell) == _FIELD_SIGN for cell in header)
    recognised = [(*recognise(cell), index, cell) for index, cell in enumerate(header) if cell and index not in taken]
    known = [item for item in recognised if item[0] in KNOWN and (item[1] is not None or item[0] in (*LAW, *RIG))]
    # A column with its quantity's name comes first, then those that name a unit.
    for quantity, unit, index, cell in sorted(known, key=lambda x: (split_unit(x[3])[0] != x[0], x[1] is None)):
        name = str(quantity)
        si = KNOWN[name].unit
        unit = None if name == TIME and _TIME_FORMAT.fullmatch(unit or "") else unit
        if name in columns:
            continue
        if name in chosen:
            notes.append(f"{name}: column {shown(cell)} is another one, and is left out")
        elif unit and factor(unit, si) is None and name not in (*LAW, WEIGHT, DEPTH):
            notes.append(f"{name}: column {shown(cell)} is in {shown(unit)}, not a unit of {name}, and is left out")
        else:
            default = _FIELD_UNITS.get(si, UNITS[si][0]) if is_field else UNITS[si][0]
            column = _column(Place(place.file, f"{place.key}, column {cell}"), name, cell, index, unit or default)
            chosen[name] = replace(column, assumed=unit is None and si != "1")
    return chosen, notes


def likely_words(name: str, column: Column, median: float, limit: float) -> str | None:
    """Return NAME="COLUMN (UNIT)" with likely units if the `median` of a column is far from the range of rigs.

    The limits are closer for a unit that is only assumed. `limit` [SI]: greatest value within reason. None if the unit
    is plausible.
    """
    quantity, value = KNOWN[name], median * column.factor
    if quantity.usual is None:
        return None
    low, high = quantity.usual
    near = low / _MARGIN <= value <= high * _MARGIN or not (column.assumed or quantity.is_far(value))
    if near and value <= limit:
        return None
    choice = " or ".join(likely_units(median, quantity.unit, quantity.usual)) or "UNIT"
    right = f"{median:.6g} {choice}" if column.index is None else f"{split_unit(column.header)[0]} ({choice})"
    return shell_assignment(name, right)


def _user_column(place: Place, header: list[str], name: str, text: str) -> Column:
    """Return the column or the constant value that the user's `text` specifies for the quantity `name`."""
    (base, unit), bases = split_unit(text), [split_unit(cell)[0] for cell in header]
    if matches := _matches(header, text) or _matches(bases, text):
        unit = None  # "Rotary RPM" is a name
    matches = matches or _matches(header, base) or _matches(bases, base)
    if len(matches) > 1:
        candidates = ", ".join(shown(header[index]) for index in matches)
        raise place.error(f"{shown(text)} may be {candidates}; give each column a name of its own, and that one here")
    if matches:
        cell, own = header[matches[0]], split_unit(header[matches[0]])[1]
        factors = [factor(spelling, KNOWN[name].unit) for spelling in (unit, own) if spelling is not None]
        if len(factors) == 2 and None not in factors and factors[0] != factors[1]:
            raise place.error(f"column {shown(cell)} is in {own} by its name, not in {unit}; give one of them")
        return _column(place, name, cell, matches[0], unit or own)
    number, unit = number_of(text)
    if number is None:
        raise place.error(f"the file has no column {shown(text)}; {suggestion(base, header)}")
    if unit.startswith(","):
        right = shown(text.replace(",", ".", 1))
        raise place.error(f"{shown(text)} has a decimal comma; write a point, like {right}")
    column = _column(place, name, text.strip(), None, unit or None)
    if (problem := KNOWN[name].problem(number * column.factor)) is not None:
        raise place.error(problem)
    return replace(column, value=number * column.factor)


def _column(place: Place, name: str, header: str, index: int | None, unit: str | None) -> Column:
    """Return a column whose numbers are in `unit`, or in the SI unit if `unit` is None."""
    si = KNOWN[name].unit
    if unit is None:
        return Column(header, index, UNITS[si][0], 1.0, assumed=si != "1")
    if (scale := factor(unit, si)) is not None:
        return Column(header, index, unit, scale)
    if name == RATE and factor(unit, "s m-1") is not None:
        right = "/".join(unit.split("/")[::-1])
        raise place.error(f"{shown(unit)} is a time per length; give the rate 1/x, in {right}")
    # A valid unit of another kind of quantity is no typing error: list all units instead of the most similar one.
    right = f"choose from {', '.join(UNITS[si])}" if is_unit(unit) else suggestion(unit, UNITS[si])
    raise place.error(f"{shown(unit)} is not a unit of {name}; {right}")


def _matches(names: list[str], text: str) -> list[int]:
    """Return the indices of the names equal to `text`; if there are none, ignore case and blanks."""
    plain = ["".join(name.casefold().split()) for name in (*names, text)]
    exact = [index for index, name in enumerate(names) if name == text.strip()]
    return exact or [index for index in range(len(names)) if plain[index] == plain[-1]]

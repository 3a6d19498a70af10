"""Words and numbers on pictures, from the attributes of the data where they are there."""

import re
from textwrap import fill

import numpy as np
import xarray as xr

_HERTZ = {"s-1": "Hz", "s-2": "Hz/s"}  # the only such units here are of frequencies
_LINE = 32  # letters of a label that fit along a panel
_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
# A prefix for a unit, where the greatest value is below (milli) or from (kilo, mega) the bound.
_MILLI = {"m": ("mm", 1e3, 1.0), "s": ("ms", 1e3, 0.1), "m s-1": ("mm s-1", 1e3, 0.3)}
_GREATER = {
    "N": (("MN", 1e-6, 1e6), ("kN", 1e-3, 1e3)),
    "N m-1": (("MN m-1", 1e-6, 1e6), ("kN m-1", 1e-3, 1e3)),
    "J": (("kJ", 1e-3, 1e4),),
    "W": (("kW", 1e-3, 1e4),),
}


def scale(data: xr.DataArray) -> tuple[float, str]:
    """The factor and the unit in which the values of `data` read well: mm for small lengths, kN for large forces."""
    unit = str(data.attrs.get("units", "")).strip()
    values = np.abs(np.asarray(data.values, float))
    greatest = values[np.isfinite(values)].max(initial=0.0)
    if unit in _MILLI:
        name, factor, bound = _MILLI[unit]
        return (factor, name) if greatest < bound else (1.0, unit)
    for name, factor, bound in _GREATER.get(unit, ()):
        if greatest >= bound:
            return factor, name
    return 1.0, unit


def pretty_unit(unit: str) -> str:
    """`unit` as printed: `m s-1` is m/s, `N s m-1` is N s/m; nothing for a pure number."""
    if unit in ("", "1"):
        return ""
    if unit in _HERTZ:
        return _HERTZ[unit]
    over, under = [], []
    for part in unit.split():
        match = re.fullmatch(r"([^\W\d]+)(-?\d+)?", part)
        if match is None:
            return unit
        name, power = match[1], int(match[2] or 1)
        (over if power > 0 else under).append(name + _power(abs(power)))
    if len(under) > 1:
        return unit.translate(_SUPERSCRIPTS)
    return " ".join(over or ["1"]) + (f"/{under[0]}" if under else "")


def _power(power: int) -> str:
    return "" if power == 1 else str(power).translate(_SUPERSCRIPTS)


def label(data: xr.DataArray, letters: int = _LINE) -> str:
    """What stands along an axis: long name, symbol and unit of `data`, or its name where it has no attributes.

    On lines of at most `letters`.
    """
    words = re.sub(r"\s*\([^)]*\)", "", str(data.attrs.get("long_name", ""))).strip()
    symbol = str(data.attrs.get("symbol", "")).strip()
    text = ", ".join(part for part in (words, symbol) if part) or str(data.name).replace("_", " ")
    return fill(with_unit(text, scale(data)[1]).replace(" [", "\u00a0["), min(letters, _LINE)).replace("\u00a0", " ")


def with_unit(text: str, unit: str) -> str:
    """`text` and the unit in brackets; `text` alone for a pure number."""
    return f"{text} [{pretty_unit(unit)}]" if pretty_unit(unit) else text


def symbol(data: xr.DataArray) -> str:
    """The short name of `data`: its symbol, or its name."""
    return str(data.attrs.get("symbol", "")).strip() or str(data.name)


def number(value: float) -> str:
    """`value` with at most five digits and a true minus."""
    text = f"{float(value):.5g}"
    return ("0" if text == "-0" else text).replace("-", "−")


def value_text(data: xr.DataArray, value: object) -> str:
    """`value` of the coordinate `data` as in `Δ = −5 mm`; `start: drive` where values are names."""
    if not np.issubdtype(np.asarray(value).dtype, np.number):
        return f"{data.name}: {value}"
    factor, unit = scale(data)
    return f"{symbol(data)} = {number(float(value) * factor)} {pretty_unit(unit)}".rstrip()


def share_text(share: float) -> str:
    """`share` in percent; what is there never reads as 0 %, what is not all never as 100 %."""
    percent = 100.0 * share
    if 0.0 < percent < 1.0:
        return "<1 %"
    if 99.0 < percent < 100.0:
        return ">99 %"
    return f"{percent:.0f} %"

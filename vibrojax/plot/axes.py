"""What stands along an axis and in notes: words, numbers and units; where cells end, and logarithmic scales."""

import json
import re
from textwrap import fill
from typing import Literal

import numpy as np
import xarray as xr
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from vibrojax.io.attributes import counts_of, parameters_of, text_of
from vibrojax.plot.contents import differing_from_defaults
from vibrojax.plot.drawable import plain

_HERTZ = {"s-1": "Hz", "s-2": "Hz/s"}  # the only such units here are of frequencies
_LINE = 32  # letters of a label that fit along a panel
_ROUNDING = 1e-6  # relative
_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
# A prefix for a unit, where the greatest value is below (milli) or from (kilo, mega) the bound.
_MILLI = {"m": ("mm", 1e3, 1.0), "s": ("ms", 1e3, 0.1), "m s-1": ("mm s-1", 1e3, 0.3)}
_GREATER = {
    "N": (("MN", 1e-6, 1e6), ("kN", 1e-3, 1e3)),
    "N m-1": (("MN m-1", 1e-6, 1e6), ("kN m-1", 1e-3, 1e3)),
    "J": (("kJ", 1e-3, 1e4),),
    "W": (("kW", 1e-3, 1e4),),
}

# The parameters worth a word on a picture: symbol, factor and unit.
_NAMED = {
    "beta": ("β", 1.0, ""),
    "gamma": ("γ", 1.0, ""),
    "v": ("v", 1.0, " m/s"),
    "delta": ("Δ", 1e3, " mm"),
    "force": ("A", 1e-3, " kN"),
    "bias": ("B", 1e-3, " kN"),
    "frequency": ("f", 1.0, " Hz"),
    "pulse_width": ("w", 1e3, " ms"),
    "threshold": ("D", 1e-3, " kN"),
    "k3": ("k₃", 1e-6, " MN/m"),
    "zeta": ("ζ", 1.0, ""),
}


USUAL_FRICTION = "stribeck"
"""The law that goes without saying."""


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
    over: list[str] = []
    under: list[str] = []
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
    text = ", ".join(part for part in (words, symbol) if part) or plain(str(data.name).replace("_", " "))
    return fill(with_unit(text, scale(data)[1]).replace(" [", "\u00a0["), min(letters, _LINE)).replace("\u00a0", " ")


def with_unit(text: str, unit: str) -> str:
    """`text` and the unit in brackets; `text` alone for a pure number."""
    return f"{text} [{pretty_unit(unit)}]" if pretty_unit(unit) else text


def symbol(data: xr.DataArray) -> str:
    """The short name of `data`: its symbol, or its name."""
    return str(data.attrs.get("symbol", "")).strip() or plain(str(data.name))


def number(value: float) -> str:
    """`value` with at most five digits and a true minus."""
    text = f"{float(value):.5g}"
    return ("0" if text == "-0" else text).replace("-", "−")


def value_text(data: xr.DataArray, value: float | str | np.number | np.str_) -> str:
    """`value` of the coordinate `data` as in `Δ = −5 mm`; `start: drive` where values are names."""
    if not np.issubdtype(np.asarray(value).dtype, np.number):
        return f"{plain(str(data.name))}: {short(str(value))}"
    factor, unit = scale(data)
    return f"{symbol(data)} = {number(float(value) * factor)} {pretty_unit(unit)}".rstrip()


def index_text(ds: xr.Dataset, dimension: str, index: int) -> str:
    """The value at `index` of `dimension`; where it has none itself, those of all the coordinates along it."""
    along = [dimension] if dimension in ds.coords else [name for name in ds.coords if ds[name].dims == (dimension,)]
    return ", ".join(value_text(ds[name], ds[name].values[index]) for name in along) or f"{dimension} = {index}"


def short(name: str) -> str:
    """`name`, with no more digits than tell starts apart where it is a vector, "[0.0, 0.0, 0.0213, 1.0]"."""
    try:
        values = json.loads(name)
        return f"[{', '.join(number(float(f'{value:.3g}')) for value in values)}]"
    except (ValueError, TypeError, RecursionError):
        return name


def share_text(share: float) -> str:
    """`share` in percent; what is there never reads as 0 %, what is not all never as 100 %."""
    percent = 100.0 * share
    if 0.0 < percent < 1.0:
        return "<1 %"
    if 99.0 < percent < 100.0:
        return ">99 %"
    return f"{percent:.0f} %"


def point_text(ds: xr.Dataset) -> str:
    """What is the same all over `ds`: its scalar coordinates, and parameters and start in its attributes."""
    scalars = {str(name): data for name, data in ds.coords.items() if data.ndim == 0}
    if "start" in scalars:  # which says its states
        scalars = {name: data for name, data in scalars.items() if not name.startswith("start_")}
    parts = [value_text(data, data.values.item()) for data in scalars.values()]
    known = {*ds.coords, *(("threshold", "k3") if "rock" in ds.coords else ())}
    given = {name: value for name, value in parameters_of(ds).items() if name in _NAMED and name not in known}
    for name, (symbol, factor, unit) in _NAMED.items():
        if name in given:
            parts.append(f"{symbol} = {number(factor * given[name])}{unit}")
    others = (data for data in differing_from_defaults(ds) if data.name not in _NAMED and data.name not in known)
    parts += [value_text(data, data.values.item()) for data in others]
    if ds.attrs.get("friction", USUAL_FRICTION) != USUAL_FRICTION:
        parts.append(f"friction: {text_of(ds, 'friction')}")
    if "start" in ds.attrs and "start" not in ds.coords:
        parts.append(f"start: {short(text_of(ds, 'start'))}")
    return ", ".join(parts)


def certified_text(ds: xr.Dataset) -> str:
    """How many of the lanes that repeat are known to the accepted error, and how many are still settling."""
    counted = counts_of(ds)
    if not counted.get("estimated") or not {"within", "still_settling", "error"} <= set(counted):
        return ""
    within, estimated, still = (round(counted[name]) for name in ("within", "estimated", "still_settling"))
    text = f"{within} of {estimated} lanes that repeat are known to {counted['error']:g}"
    text += f", {still} are still settling" if still else ""
    return text + (f", {counted['sensitive']} are sensitive to rounding" if counted.get("sensitive") else "")


def values_along(data: xr.DataArray) -> Float[np.ndarray, " values"]:
    """The values of the axis `data` in the unit of its label."""
    return np.asarray(data.values * scale(data)[0], float)


def steady(axes: Axes) -> None:
    """Give `axes` upright limits wide of what it shows where that is one value but for rounding."""
    low, high = (float(end) for end in axes.dataLim.intervaly)
    if 0.0 <= high - low <= _ROUNDING * max(abs(low), abs(high)):
        room = 0.1 * abs(high) or 1.0
        axes.set_ylim(low - room, high + room)


def is_geometric(values: Float[np.ndarray, " values"]) -> bool:
    """Whether `values` grow by a constant factor (and not, within the same bound, by a constant step)."""
    if values.size < 3 or values[0] <= 0 or np.any(np.diff(values) <= 0):
        return False
    factors, steps = values[1:] / values[:-1], np.diff(values)
    return bool(np.ptp(factors) <= 1e-3 * factors.mean() and np.ptp(steps) > 1e-3 * steps.mean())


def edges(values: Float[np.ndarray, " values"]) -> Float[np.ndarray, " values+1"]:
    """The n + 1 ends of the cells around n > 1 increasing `values`: halfway, in the logarithm for geometric ones."""
    if is_geometric(values):
        return np.exp(edges(np.log(values)))
    half = np.diff(values) / 2
    return np.concatenate([values[:1] - half[:1], values[:-1] + half, values[-1:] + half[-1:]])


def shape_axis(axes: Axes, which: Literal["x", "y"], values: Float[np.ndarray, " values"]) -> None:
    """Make the x or y axis of `axes` logarithmic for geometric `values`, with its ends at the ends of the cells."""
    ends = edges(values)
    limit, set_scale = (axes.set_xlim, axes.set_xscale) if which == "x" else (axes.set_ylim, axes.set_yscale)
    if is_geometric(values):
        set_scale("log")
        _plain_log_ticks(axes.xaxis if which == "x" else axes.yaxis, ends)
    limit(ends[0], ends[-1])


def _plain_log_ticks(axis: Axis, ends: Float[np.ndarray, " ends"]) -> None:
    """1, 2, 5 and so on as plain numbers, where the axis spans less than three decades."""
    if ends[-1] / ends[0] < 1e3:
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())

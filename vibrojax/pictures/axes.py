"""Text and scales of axes: labels, units, number formats, edges of map cells and logarithmic scales."""

import json
import re
from collections.abc import Mapping
from textwrap import fill, wrap
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float

from vibrojax.errors import counted, printable
from vibrojax.io.attributes import certified_of, differing_of, flag_counts, parameter_units_of, parameters_of, text_of
from vibrojax.pictures.plots import Axis
from vibrojax.scenes import SCENES

_HERTZ = {"s-1": "Hz", "s-2": "Hz s-1"}  # printed units of frequencies
_FREQUENCIES = {"frequency": "f", "sweep_start": "f₀", "sweep_rate": "r"}  # the package's own: name and symbol
_ANGULAR = re.compile(r"\bangular\b|\bomega|[ωΩ]", re.IGNORECASE)  # names of angular frequencies
_LABEL_LETTERS = 32  # characters that fit along a panel
_SHORT_UNIT = 7  # greatest length of a unit in brackets that is kept beside the word before it
_GEOMETRIC = 1e-3  # relative scatter up to which ratios or differences count as constant
SUPERSCRIPTS = str.maketrans("-.0123456789", "⁻·⁰¹²³⁴⁵⁶⁷⁸⁹")
# Prefixed units: name, factor, and the range of greatest magnitudes for which the prefix is used.
_PREFIXED = {
    "m": (("mm", 1e3, 0.0, 1.0),),
    "s": (("ms", 1e3, 0.0, 0.1),),
    "m s-1": (("mm s-1", 1e3, 0.0, 0.3),),
    "N": (("MN", 1e-6, 1e6, np.inf), ("kN", 1e-3, 1e3, np.inf)),
    "N m-1": (("MN m-1", 1e-6, 1e6, np.inf), ("kN m-1", 1e-3, 1e3, np.inf)),
    "J": (("kJ", 1e-3, 1e4, np.inf),),
    "J m-3": (("MJ m-3", 1e-6, 1e6, np.inf),),
    "W": (("kW", 1e-3, 1e4, np.inf),),
}

# The parameters that every note lists, besides those that differ from their defaults.
_LISTED = "beta", "gamma", "v", "delta", "force", "bias", "frequency", "pulse_width", "threshold", "k3", "zeta"

_MOST_OWN = 12  # parameters of a user's own system that a note lists
_USUAL_FRICTION = "stribeck"  # notes omit this friction law


def scale(data: xr.DataArray) -> tuple[float, str]:
    """Return the conversion factor and the unit to print values in, such as mm for small lengths.

    Values in s-1 are printed in Hz only if they are known to be frequencies, and in rad/s if their name, long name or
    symbol says that they are angular frequencies.
    """
    unit = str(data.attrs.get("units", "")).strip()
    if unit in _HERTZ:
        sign = _FREQUENCIES.get(str(data.name))
        if sign is not None and data.attrs.get("symbol", sign) == sign:
            return 1.0, _HERTZ[unit]
        if _ANGULAR.search(" ".join(str(text) for text in (data.name, data.attrs.get("long_name"), symbol(data)))):
            return 1.0, f"rad {unit}"
    values = np.abs(np.asarray(data.values, float))
    greatest = values[np.isfinite(values)].max(initial=0.0)
    prefixed = _PREFIXED.get(unit, ())
    return next(((factor, name) for name, factor, low, high in prefixed if low <= greatest < high), (1.0, unit))


def in_units(ds: xr.Dataset, units: Mapping[str, tuple[float, str]]) -> xr.Dataset:
    """Return a dataset with its variables in other units: by SI unit, the factor to the other one and its name."""
    for name, data in ds.data_vars.items():
        if other := units.get(str(data.attrs.get("units"))):
            ds = ds.assign({name: data.copy(data=other[0] * data.values).assign_attrs(units=other[1])})
    return ds


def pretty_unit(unit: str) -> str:
    """Return a unit as it is printed: m/s for `m s-1`, N s/m for `N s m-1`, empty if dimensionless."""
    if unit in ("", "1"):
        return ""
    above: list[str] = []
    below: list[str] = []
    for part in unit.split():
        match = re.fullmatch(r"([^\W\d]+)(-?\d+)?", part)
        if match is None:
            return unit
        power = int(match[2] or 1)
        exponent = "" if abs(power) == 1 else str(abs(power)).translate(SUPERSCRIPTS)
        (above if power > 0 else below).append(match[1] + exponent)
    if len(below) > 1:
        return unit.translate(SUPERSCRIPTS)
    return " ".join(above or ["1"]) + (f"/{below[0]}" if below else "")


def label(data: xr.DataArray, letters: int = _LABEL_LETTERS) -> str:
    """Return an axis label: long name, symbol and unit. A variable without these attributes is labelled by its name.

    The label is wrapped at `letters` characters, 32 at most.
    """
    words = typeset(re.sub(r"\s*\([^)]*\)", "", str(data.attrs.get("long_name", ""))).strip())
    parts = (words, str(data.attrs.get("symbol", "")).strip())
    text = ", ".join(dict.fromkeys(filter(None, parts))) or str(data.name).replace("_", " ")
    return broken(with_unit(text, scale(data)[1]), min(letters, _LABEL_LETTERS))


def broken(text: str, letters: int) -> str:
    """Return a text in lines of at most `letters` characters; none breaks a unit, or begins with a short one.

    A line begins with a short unit if the word before it leaves no room.
    """

    def keep(unit: re.Match[str]) -> str:
        beside = len(unit[2]) <= _SHORT_UNIT and len(unit[0]) <= letters
        return unit[1] + ("\u00a0" if beside else " ") + unit[2].replace(" ", "\u00a0")

    joined = re.sub(r"(\S+) (\[[^]]*\])", keep, " ".join(text.split()))
    return balanced(joined, max(letters, 8)).replace("\u00a0", " ")


def balanced(text: str, letters: int) -> str:
    """Return a text in as few lines of at most `letters` characters as possible, of about equal length."""
    count = len(wrap(text, letters, break_long_words=False))
    while letters > 1 and len(wrap(text, letters - 1, break_long_words=False)) == count:
        letters -= 1
    return fill(text, letters, break_long_words=False)


def unbroken(text: str) -> str:
    """Return a text with no-break spaces within a value: γ = 0.6, 21.3 ± 0.4 m/h, 97 %."""
    return re.sub(r"(?<=\d) (?=[±%]|1/|[^\W\d]\S{0,4}(?!\S))|(?<=[±=]) (?=\S*\d)| (?== \S*\d)", "\u00a0", text)


def broken_title(text: str, letters: int) -> str:
    """Return a title in lines of at most `letters` characters, broken between its parts if they are short enough."""
    if "\n" in text:
        return "\n".join(broken_title(line, letters) for line in text.splitlines())
    for marks in (",", ",:"):
        joined = re.sub(f"([{marks}])\u00a0", r"\1 ", text.replace(" ", "\u00a0"))
        parts = fill(joined, letters, break_long_words=False).replace("\u00a0", " ")
        if max(map(len, parts.splitlines()), default=0) <= letters:
            return parts
    return balanced(unbroken(text), letters).replace("\u00a0", " ")


def with_unit(text: str, unit: str) -> str:
    """Return the text followed by the unit in brackets, or the text alone if the unit is dimensionless."""
    return f"{text} [{pretty_unit(unit)}]" if pretty_unit(unit) else text


def typeset(text: str) -> str:
    """Return a text with the ratios of the parameters' meanings as they are printed: ω₂/ω₁ for w2/w1."""
    return text.replace("w2/w1", "ω₂/ω₁").replace("m2/m1", "m₂/m₁")


def symbols_of(ds: xr.Dataset) -> dict[str, str]:
    """Return the symbols of the parameters of a dataset's scene by name; empty for a scene of the user's own."""
    scene = SCENES.get(text_of(ds, "scene"))
    return {} if scene is None else {name: about.symbol for name, about in scene().parameters().items()}


def symbol(data: xr.DataArray) -> str:
    """Return the symbol of a variable, or its name if it has no symbol."""
    return str(data.attrs.get("symbol", "")).strip() or str(data.name)


def number(value: float, digits: int = 5) -> str:
    """Format a number with at most `digits` significant digits and a typographic minus sign."""
    text = f"{float(value):.{digits}g}"
    return ("0" if text == "-0" else text).replace("-", "−")


def value_text(data: xr.DataArray, value: float | int | str | np.number | np.str_) -> str:
    """Format a value of the coordinate `data`: `Δ = −5 mm` for a number, `start: drive` for a string."""
    if not np.issubdtype(np.asarray(value).dtype, np.number):
        return f"{data.name!s}: {short(str(value))}"
    return f"{symbol(data)} = {quantity_text(float(value), data)}"


def quantity_text(value: float, data: xr.DataArray, digits: int = 5) -> str:
    """Format a value of a variable in the unit in which it is printed."""
    factor, unit = scale(data)
    return f"{number(value * factor, digits)} {pretty_unit(unit)}".rstrip()


def index_text(ds: xr.Dataset, dimension: str, index: int) -> str:
    """Format a dimension's value at an index, or the values of all coordinates along a dimension without its own."""
    along = [dimension] if dimension in ds.coords else [name for name in ds.coords if ds[name].dims == (dimension,)]
    return ", ".join(value_text(ds[name], ds[name].values[index]) for name in along) or f"{dimension} = {index}"


def short(name: str) -> str:
    """Shorten the name of an initial condition: a vector, "[0.0, 0.0, 0.0213, 1.0]", gets three digits per state."""
    try:
        start = json.loads(name)
        return start if isinstance(start, str) else f"[{', '.join(number(float(f'{value:.3g}')) for value in start)}]"
    except (ValueError, TypeError, RecursionError):
        return name.strip('"')


def share_text(share: float) -> str:
    """Format a fraction in percent; fractions below 1 % read <1 % and above 99 % read >99 %, unless exactly 0 or 1."""
    percent = round(100.0 * share, 6)  # sums of shares have rounding errors
    if 0.0 < percent < 1.0:
        return "<1 %"
    return ">99 %" if 99.0 < percent < 100.0 else f"{percent:.0f} %"


def point_text(ds: xr.Dataset) -> str:
    """Format the values common to all lanes: scalar coordinates, parameters and initial condition."""
    scalars = {str(name): data for name, data in ds.coords.items() if data.ndim == 0}
    if "start" in scalars:  # its name contains the initial states
        scalars = {name: data for name, data in scalars.items() if not name.startswith("start_")}
    parts = [value_text(data, data.values.item()) for data in scalars.values()]
    known = {*ds.coords, *(("threshold", "k3") if "rock" in ds.coords else ())}
    scene, values = SCENES.get(text_of(ds, "scene")), parameters_of(ds)
    about = {} if scene is None else scene().parameters()
    listed = [name for name in _LISTED if name in about and name in values]
    records = {name: (about[name].symbol, about[name].unit, values[name]) for name in listed}
    if scene is None:  # of the user's own
        units = parameter_units_of(ds)
        shown = [name for name in values if name not in known]
        records = {printable(x, 40): (printable(x, 40), units.get(x, ""), values[x]) for x in shown[:_MOST_OWN]}
    for x in differing_of(ds):
        records.setdefault(x["name"], (printable(x["symbol"], 40), printable(x["units"], 40), x["value"]))
    for name, (sign, unit, value) in records.items():
        if name not in known:
            parts.append(value_text(xr.DataArray(value, name=name, attrs={"symbol": sign, "units": unit}), value))
    if ds.attrs.get("friction", _USUAL_FRICTION) != _USUAL_FRICTION:
        parts.append(f"friction: {text_of(ds, 'friction')}")
    if "start" in ds.attrs and "start" not in ds.coords:
        parts.append(f"start: {short(text_of(ds, 'start'))}")
    return ", ".join(parts)


def certified_text(ds: xr.Dataset) -> str:
    """Return how many periodic lanes meet the error tolerance or still settle, and why lanes failed; "" if unknown."""
    counts, parts = certified_of(ds), []
    if counts.get("estimated") and {"within", "still_settling", "error"} <= set(counts):
        within, estimated, still = (round(counts[name]) for name in ("within", "estimated", "still_settling"))
        lanes = f"of {estimated} lanes that repeat" if estimated > 1 else "of 1 lane that repeats"
        text = counted(within, f"{lanes} is", f"{lanes} are") + f" exact to {counts['error']:g}"
        text += f", {counted(still, 'is', 'are')} still settling" if still else ""
        sensitive = round(counts.get("sensitive", 0))
        parts.append(text + (f", {counted(sensitive, 'is', 'are')} sensitive to numerical errors" if sensitive else ""))
    reasons = [name for name in flag_counts(ds, "reason") if name != "none"] if "status" in ds else []
    return ". ".join([*parts, *([f"Lanes failed: {', '.join(reasons)}"] if reasons else [])])


def values_along(data: xr.DataArray) -> Float[np.ndarray, " values"]:
    """Return a coordinate's values in the unit of its axis label."""
    return np.asarray(data.values * scale(data)[0], float)


def is_geometric(values: Float[np.ndarray, " values"]) -> bool:
    """Return whether the values increase by a constant ratio, and not by a constant difference."""
    if values.size < 3 or values[0] <= 0 or np.any(np.diff(values) <= 0):
        return False
    factors, steps = values[1:] / values[:-1], np.diff(values)
    return bool(np.ptp(factors) <= _GEOMETRIC * factors.mean() and np.ptp(steps) > _GEOMETRIC * steps.mean())


def edges(values: Float[np.ndarray, " values"]) -> Float[np.ndarray, " values+1"]:
    """Return the n + 1 edges of the map cells at n > 1 increasing values: midpoints, of logarithms if geometric."""
    if is_geometric(values):
        return np.exp(edges(np.log(values)))
    half = np.diff(values) / 2
    return np.concatenate([values[:1] - half[:1], values[:-1] + half, values[-1:] + half[-1:]])


def axis(data: xr.DataArray, **about: Any) -> Axis:
    """Return the axis of a variable, with its label; `about`: further attributes of the axis."""
    return Axis(**{"label": label(data), "name": str(data.name)} | about)


def map_axis(data: xr.DataArray, **about: Any) -> Axis:
    """Return the axis between the outer map-cell edges at a coordinate's values, logarithmic for geometric values."""
    values = np.sort(values_along(data))
    low, high = (float(end) for end in edges(values)[[0, -1]])
    return axis(data, **{"limits": (low, high), "log": is_geometric(values)} | about)


def margins(ds: xr.Dataset, *notes: str, point: str | None = None) -> dict[str, Any]:
    """Return title and note as fields of a sheet; the note begins with `point`, or the values common to all lanes."""
    title = str(ds.attrs.get("title") or ds.attrs.get("scene", ""))
    return {"title": title, "note": ". ".join(filter(None, (point_text(ds) if point is None else point, *notes)))}

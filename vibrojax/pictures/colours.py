"""Colours of regimes, of the formulas of the penetration law, and of quantities (one scale for all panels)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, Literal

import numpy as np
import xarray as xr
from jaxtyping import Float

from vibrojax.errors import InputError
from vibrojax.io.attributes import flags
from vibrojax.lazy import colors
from vibrojax.measures.labels import REGIMES
from vibrojax.pictures.axes import scale, share_text, with_unit
from vibrojax.pictures.contents import RATE, REGIME, RELIEF, quantities_beside, require
from vibrojax.pictures.plots import Axis, Key, dots, patch
from vibrojax.pictures.style import NO_VALUE, NOTHING, colour_map, other_colour

# One fixed colour for each regime, so that pictures of different runs can be compared. Any two differ by 27 or more in
# CIELAB, also for readers who lack one kind of cone. The regime of interest, 3, is the brightest. The two greys differ
# by 35 in lightness; lanes without a value are hatched.
REGIME_COLOURS = {
    0: "#DDD8C8",
    1: "#767676",
    2: "#88CCEE",
    3: "#FFC20A",
    4: "#0C6BB3",
    5: "#C2410C",
    6: "#6A1B5D",
    7: "#000000",
}
_CLEAR = (1.0, 1.0, 1.0, 0.0)  # cells without a value show the hatched background
SINGLE = REGIMES.index("single-impact")

FORM_COLOURS = {
    "onset": "#004488",
    "literal": "#222222",
    "percent": "#DDAA33",
    "line": "#56B4E9",
    "power": "#BB5566",
    "constant": "#228833",
}
_OTHER_FORM = "#8C8C8C"

# Words for quantities whose names do not say enough, and perceptually uniform colour maps other than viridis.
_WORDS = {
    "slip_per_impact": "slip per blow",
    "mean_force": "mean force P",
    "relief": "relief P/D",
    "multiplier_abs": "largest |multiplier|",
    "multiplier_arg": "argument of the largest\nmultiplier",
    "stable": "stability",
    "lyapunov": "greatest Lyapunov exponent",
    "stick_fraction": "share of stick",
    "reverse_fraction": "share of slip backwards",
}
_COLOUR_MAPS = {"rate_of_penetration": "plasma", "bit_amplitude": "plasma"}
_COLOUR_MAPS |= dict.fromkeys(("period", "mean_force", "relief"), "cividis")
_STABILITY_COLOURS = {-1: "#BBBBBB", 0: "#D55E00", 1: "#0072B2"}
_OF_ROCK = (RATE, "slip_per_impact", RELIEF, "mean_force")
_NOTHING_AT_ZERO = {"rate_of_penetration", "slip_per_impact"}
ROBUST = (2.0, 98.0)  # percentiles
_OUTLIER_RANGE = 0.2  # outliers are farther from the robust limits than this, in units of the robust range
_SPREAD = {"rate_of_penetration", "slip_per_impact", "C"}  # quantities that may extend over decades
_LOG_SHARE, _LOG_RATIO = 20.0, 15.0  # logarithmic if this percentage of values is below the greatest over this factor
_CONSTANT = 1e-9  # relative range up to which values count as equal

Cells = Float[np.ndarray, "*shape"]
Extend = Literal["neither", "min", "max", "both"]


@dataclass(frozen=True)
class Value:
    """Colour coding of a variable: its values times `factor`, mapped by `norm`, which all panels of a picture share."""

    name: str
    label: str
    factor: float
    norm: "colors.Normalize"
    extend: Extend
    colour_map: "colors.Colormap"
    names: Mapping[int, str] = field(default_factory=dict)
    """Meanings of the values by flag; empty if the variable has no flags."""

    has_values: bool = True
    """False if there is nothing to colour: the colour bar is then a placeholder without ticks."""

    counted: bool = False
    """True if the legend lists the flags with their shares of the lanes, in place of a colour bar."""

    @property
    def of_rate(self) -> bool:
        """True if zero means that there is no penetration."""
        return self.name in _NOTHING_AT_ZERO

    def of(self, ds: xr.Dataset) -> xr.DataArray:
        """Return the variable's values in `ds`, in the unit of the label."""
        return ds[self.name] * self.factor


def regimes_in(ds: xr.Dataset) -> xr.Dataset:
    """Return the dataset with axes of length 1 as scalars; raise `InputError` if it has no regimes with a colour."""
    ds = require(ds, REGIME, 'no regimes to draw: the dataset holds no variable "regime"')
    regime_cells(ds[REGIME])
    return ds


def regime_cells(data: xr.DataArray) -> Cells:
    """Return the regime flags as floats, NaN for lanes without a regime.

    **Raises:** `InputError` if a flag has no colour.
    """
    values = np.asarray(data.values, float)
    known = np.isin(values, list(REGIME_COLOURS))
    unknown = values[~known & np.isfinite(values)]
    if unknown.size:
        flag = int(unknown.min())
        name = flags(data).get(flag, "no meaning in flag_meanings")
        choices = ", ".join(f"{key} {REGIMES[key]}" for key in REGIME_COLOURS)
        raise InputError(f"{data.name}: flag {flag} ({name}) is not a regime with a colour; these are {choices}")
    return np.where(known, values, np.nan)


def regime_names(data: xr.DataArray) -> dict[int, str]:
    """Return the names of regimes by flag; the attributes `flag_values` and `flag_meanings` override the defaults."""
    return dict(enumerate(REGIMES)) | flags(data)


def regime_keys(data: Sequence[xr.DataArray]) -> list[Key]:
    """Return a legend entry for each regime that occurs, with name and fraction of the lanes."""
    names, values = regime_names(data[0]), np.concatenate([regime_cells(part).ravel() for part in data])
    occurring, counts = np.unique(values[np.isfinite(values)], return_counts=True)
    return [
        patch(REGIME_COLOURS[flag], f"{names[flag]}  {share_text(n / values.size)} of lanes")
        for flag, n in zip(occurring.astype(int).tolist(), counts.tolist(), strict=True)
    ]


SENSITIVE_KEY = dots(label="numerical errors decide\nthe attractor", marker="x", edge_width=0.8)
"""Legend entry for lanes whose attractor is determined by rounding error."""


def no_value_key(name: str = "no value") -> Key:
    """Return the legend entry for map cells without a value."""
    return patch(NO_VALUE["facecolor"], name, edge=NO_VALUE["edgecolor"], hatch=NO_VALUE["hatch"])


# Formulas of the fitted law, and quantities.


def form_colour(name: str) -> str:
    """Return the colour of a formula of the penetration law."""
    return FORM_COLOURS.get(name, _OTHER_FORM)


def regime_value(data: xr.DataArray, label: str = "") -> Value:
    """Return the colour coding of the regimes; `label` is part of the titles of their maps."""
    colour_map, norm = regime_colour_map()
    return Value(str(data.name), label, 1.0, norm, "neither", colour_map, regime_names(data), counted=True)


def regime_colour_map() -> "tuple[colors.Colormap, colors.BoundaryNorm]":
    """Return the colour map of the regimes' numbers, and its norm."""
    colour_map = colors.ListedColormap(list(REGIME_COLOURS.values()), name="regimes").with_extremes(bad=_CLEAR)
    return colour_map, colors.BoundaryNorm(np.arange(-0.5, len(REGIME_COLOURS)), len(REGIME_COLOURS))


def values_beside(ds: xr.Dataset) -> list[Value]:
    """Return the quantities that get a panel next to the regimes."""
    return [value_of(ds[name]) for name in quantities_beside(ds)]


def values_of_rock(ds: xr.Dataset) -> tuple[Value, ...]:
    """Return the quantities of which maps are drawn for a dataset without regimes.

    They are the rate of penetration, and those of slip per impact, relief and mean force that vary over the lanes.
    """
    names = [name for name in _OF_ROCK if name in ds and (name == RATE or _varies(ds[name].values))]
    if {RELIEF, "mean_force"} <= set(names) and not _varies((ds["mean_force"] / ds[RELIEF]).values):
        names.remove(RELIEF)  # proportional to the force, so the map looks the same
    return tuple(value_of(ds[name]) for name in names)


def value_of(data: xr.DataArray) -> Value:
    """Return the colour coding of a variable; a flag variable gets one colour per flag that occurs."""
    name = str(data.name)
    if "flag_meanings" in data.attrs and np.size(data.values):
        return _flags_value(data)
    factor, unit = scale(data)
    finite: Cells = data.values[np.isfinite(data.values)] * factor
    finite = finite[finite > 0] if name in _NOTHING_AT_ZERO else finite
    has_values = bool(finite.size)
    if not has_values:
        finite = np.array([0.0, 1.0])
    norm = _norm(name, finite)
    extends: tuple[Extend, ...] = ("neither", "min", "max", "both")
    extend = extends[bool(finite.min() < (norm.vmin or 0.0)) + 2 * bool(finite.max() > (norm.vmax or 0.0))]
    shown = colour_map(_COLOUR_MAPS.get(name, "viridis")).with_extremes(bad=_CLEAR)
    return Value(name, with_unit(words_for(name), unit), factor, norm, extend, shown, has_values=has_values)


def words_for(name: str) -> str:
    """Return the words for a variable on axes and colour bars."""
    return _WORDS.get(name, name.replace("_", " "))


def _flags_value(data: xr.DataArray) -> Value:
    """Return the colour coding of flags: fixed colours for stability and regimes, else colours by position."""
    meanings, name = flags(data), str(data.name)
    occurring = np.unique(data.values[~np.isnan(data.values)]).astype(int).tolist() or [0]
    own = REGIME_COLOURS if "single-impact" in meanings.values() else _STABILITY_COLOURS if name == "stable" else {}
    colours = [own.get(flag, other_colour(position)) for position, flag in enumerate(occurring)]
    between = [(low + high) / 2 for low, high in pairwise(occurring)]
    norm = colors.BoundaryNorm([occurring[0] - 0.5, *between, occurring[-1] + 0.5], len(occurring))
    names = {flag: meanings.get(flag, str(flag)) for flag in occurring}
    shown = colors.ListedColormap(colours, name=name).with_extremes(bad=_CLEAR)
    return Value(name, words_for(name), 1.0, norm, "neither", shown, names)


def value_axis(value: Value, text: str = "", **about: Any) -> Axis:
    """Return the axis of a quantity, labelled by `text` or its own label; flags have ticks with their meanings."""
    if value.names:
        about |= {
            "limits": (min(value.names) - 0.5, max(value.names) + 0.5),
            "ticks": [(float(flag), name) for flag, name in value.names.items()],
        }
    return Axis(**{"label": text or value.label, "name": value.name} | about)


def share_value(data: xr.DataArray, name: str) -> Value:
    """Return the colour coding, from 0 to 100 %, of the fraction of initial conditions that end in regime `name`."""
    return Value(str(data.name), f"{name} [% of starts]", 1.0, colors.Normalize(0.0, 100.0), "neither", colour_map())


def cell_keys(data: Sequence[xr.Dataset], values: Sequence[Value]) -> list[Key]:
    """Return the legend entries for regimes, for lanes without penetration, and for lanes without a value."""
    counted = [part[value.name] for part in data for value in values if value.counted]
    shown = [(part[value.name].values, value.of_rate) for part in data for value in values if not value.counted]
    keys = regime_keys(counted) if counted else []
    if any((cells == 0).any() for cells, of_rate in shown if of_rate):
        keys.append(patch(NOTHING, "no penetration"))
    if any(np.isnan(cells).any() for cells, _ in shown):
        keys.append(no_value_key())
    return keys


def _varies(values: Cells) -> bool:
    finite = values[np.isfinite(values)]
    return bool(finite.size) and bool(np.ptp(finite) > _CONSTANT * np.abs(finite).max())


def _norm(name: str, finite: Cells) -> "colors.Normalize":
    """Return the colour scale: robust against outliers, logarithmic over decades."""
    low, high = robust = tuple(float(limit) for limit in np.percentile(finite, ROBUST))
    beyond = _OUTLIER_RANGE * (high - low)
    least, greatest = float(finite.min()), float(finite.max())
    low, high = (least if least >= low - beyond else low), (greatest if greatest <= high + beyond else high)
    if name in _SPREAD and finite.min() > 0 and float(np.percentile(finite, _LOG_SHARE)) < high / _LOG_RATIO:
        return colors.LogNorm(robust[0], high)
    if high - low <= 1e-6 * abs(high):  # one value everywhere: a bar with room on both sides
        low, high = low - 0.05 * abs(low) - 1e-12, high + 0.05 * abs(high) + 1e-12
    return colors.Normalize(low, high)

"""Colours of what is drawn: the regimes and the forms of the law one each, quantities by a scale that panels share."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float
from matplotlib import colormaps
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis, XAxis
from matplotlib.colors import BoundaryNorm, Colormap, ListedColormap, LogNorm, Normalize
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import NullLocator

from vibrojax.errors import printable
from vibrojax.measures.labels import REGIMES
from vibrojax.plot.axes import scale, share_text, with_unit
from vibrojax.plot.contents import RATE, REGIME, RELIEF, contents
from vibrojax.plot.style import COLOURS, INK, NOTHING, OTHER_COLOURS, UNDEFINED

# One colour for each regime, for ever, so that pictures of different runs can be read side by side. Any two differ by
# 28 or more in CIELAB, also with any one kind of cone missing. The one to find, 3, is the brightest.
REGIME_COLOURS = {
    0: "#DDD8C8",
    1: "#8C8C8C",
    2: "#88CCEE",
    3: "#FFC20A",
    4: "#0C6BB3",
    5: "#C2410C",
    6: "#6A1B5D",
    7: "#000000",
}
REGIME_MAP = ListedColormap(list(REGIME_COLOURS.values()), name="regimes").with_extremes(bad=UNDEFINED)
REGIME_NORM = BoundaryNorm(np.arange(-0.5, len(REGIME_COLOURS)), len(REGIME_COLOURS))

FORM_COLOURS = {"onset": "#004488", "literal": "#222222", "percent": "#DDAA33", "line": "#56B4E9", "power": "#BB5566"}
_OTHER_FORM = "#8C8C8C"

# Name on the picture and colours, perceptually uniform.
_QUANTITIES = {
    "rate_of_penetration": ("rate of penetration", "plasma"),
    "impact_velocity": ("impact velocity", "viridis"),
    "period": ("period", "cividis"),
    "bit_amplitude": ("bit amplitude", "plasma"),
    "slip_per_impact": ("slip per blow", "viridis"),
    "mean_force": ("mean force P", "cividis"),
    "relief": ("relief P/D", "cividis"),
    "C": ("C", "viridis"),
    "multiplier_abs": ("largest |multiplier|", "viridis"),
    "multiplier_arg": ("argument of the largest\nmultiplier", "viridis"),
    "stable": ("stability", ""),
    "lyapunov": ("greatest Lyapunov exponent", "viridis"),
    "nature": ("nature", ""),
    "stick_fraction": ("share of stick", "viridis"),
    "reverse_fraction": ("share of slip backwards", "viridis"),
    "C_relative_error": ("standard error of C", "cividis"),
}
_STABILITY_COLOURS = {-1: "#BBBBBB", 0: "#D55E00", 1: "#0072B2"}
_OF_DRILL = ("impact_velocity", "period", "bit_amplitude")
_OF_ROCK = (RATE, "slip_per_impact", RELIEF, "mean_force")
_NOTHING_AT_ZERO = {"rate_of_penetration", "slip_per_impact"}
ROBUST = (2.0, 98.0)  # percentiles
_OUTLYING = 2.0  # of the range between them, from which what lies beyond is left out of the colours
_SPREAD = {"rate_of_penetration", "slip_per_impact", "C"}
_MANY, _WIDE = 20.0, 15.0  # that share [percent] of rates, so much smaller than the greatest: logarithmic colours
_BESIDE = 3  # flags whose names have room side by side
_SAME = 1e-9  # relative, within which a value does not vary

Cells = Float[np.ndarray, "*shape"]


@dataclass(frozen=True)
class Value:
    """A variable in colours: its values times `factor`, under `norm`, which all panels of a picture share."""

    name: str
    label: str
    factor: float
    norm: Normalize
    extend: Literal["neither", "min", "max", "both"]
    colour_map: Colormap
    names: Mapping[int, str] = field(default_factory=dict)
    """What its values mean, where they are flags."""

    @property
    def of_rate(self) -> bool:
        """Whether zero means that there is no penetration."""
        return self.name in _NOTHING_AT_ZERO

    def of(self, ds: xr.Dataset) -> xr.DataArray:
        """The values in `ds`, in the unit of the label."""
        return ds[self.name] * self.factor


class Coloured(NamedTuple):
    """Cells, and what gives them their colours."""

    cells: Cells
    colour_map: Colormap
    norm: Normalize


def coloured(ds: xr.Dataset, value: Value | None, *dims: str) -> Coloured:
    """The regimes, or `value`, of the lanes in `ds` along `dims`."""
    if value is None:
        return Coloured(flags(ds[REGIME].transpose(*dims)), REGIME_MAP, REGIME_NORM)
    return Coloured(value.of(ds).transpose(*dims).values, value.colour_map, value.norm)


# Regimes.


def flags(data: xr.DataArray) -> Cells:
    """The flags in `data` as floats; NaN where there is none of the known ones."""
    values = np.asarray(data.values, float)
    return np.where(np.isin(values, list(REGIME_COLOURS)), values, np.nan)


def by_share(rows: Float[np.ndarray, "starts values"]) -> Float[np.ndarray, "starts values"]:
    """The regimes of each column one above the other, so that their heights are their shares: single impacts first."""
    single = REGIMES.index("single-impact")
    ordered = np.sort(np.where(rows == single, -1.0, rows), axis=0)
    return np.where(ordered == -1.0, float(single), ordered)


def regime_names(data: xr.DataArray) -> dict[int, str]:
    """The name of each regime, by the attributes `flag_values` and `flag_meanings` of `data` where they are there."""
    return dict(enumerate(REGIMES)) | flag_names(data)


def flag_names(data: xr.DataArray) -> dict[int, str]:
    """What the flags of `data` mean, by its attributes."""
    values = np.atleast_1d(data.attrs.get("flag_values", [])).astype(int).tolist()
    meanings = [printable(meaning, 60) for meaning in str(data.attrs.get("flag_meanings", "")).split()]
    return dict(zip(values, meanings, strict=False))


def regime_counts(data: Iterable[xr.DataArray]) -> dict[int, int]:
    """The flags that occur in `data`, in their order, and how many lanes have each."""
    values = np.concatenate([flags(part).ravel() for part in data])
    occurring, lanes = np.unique(values[np.isfinite(values)], return_counts=True)
    return dict(zip(occurring.astype(int).tolist(), lanes.tolist(), strict=True))


def regime_handles(data: Sequence[xr.DataArray]) -> list[Artist]:
    """A patch for each regime that occurs in `data`, named with its share of the lanes."""
    names = regime_names(data[0])
    lanes = sum(part.size for part in data)
    shares = {flag: share_text(n / lanes) for flag, n in regime_counts(data).items()}
    return [_patch(REGIME_COLOURS[flag], f"{names[flag]}  {share}") for flag, share in shares.items()]


def sensitive_handle() -> Artist:
    """Return the legend's entry for lanes of which rounding decides the attractor."""
    label = "rounding decides\nthe attractor"
    return Line2D([], [], label=label, marker="x", markersize=4.0, markeredgewidth=0.8, linestyle="none", color=INK)


def _patch(colour: str, name: str) -> Patch:
    return Patch(facecolor=colour, edgecolor="0.35", linewidth=0.4, label=name)


# Forms of the law.


def form_colour(name: str) -> str:
    """The colour of the form `name`."""
    return FORM_COLOURS.get(name, _OTHER_FORM)


def form_colours(names: Sequence[str]) -> tuple[Colormap, BoundaryNorm]:
    """The colours of the forms by their number."""
    colours = [form_colour(name) for name in names]
    norm = BoundaryNorm(np.arange(-0.5, len(colours)), len(colours))
    return ListedColormap(colours, name="forms").with_extremes(bad=UNDEFINED), norm


def form_handles(names: Sequence[str], data: Sequence[xr.DataArray]) -> list[Artist]:
    """A patch for each form whose number occurs in `data`, named with its share."""
    values = np.concatenate([part.values.ravel() for part in data])
    shares = {name: float((values == at).mean()) for at, name in enumerate(names)}
    return [_patch(form_colour(name), f"{name}  {share_text(s)}") for name, s in shares.items() if s > 0]


# Quantities.


def values_beside(ds: xr.Dataset) -> tuple[Value, ...]:
    """The values worth a panel beside the regimes."""
    return tuple(value_of(ds[name]) for name in contents(ds).beside)


def values_of_rock(ds: xr.Dataset) -> tuple[Value, ...]:
    """The values worth a map where there are no regimes: the rate of penetration, and what else varies."""
    named = [name for name in _OF_ROCK if name in ds and (name == RATE or _varies(ds[name].values))]
    if {RELIEF, "mean_force"} <= set(named) and not _varies((ds["mean_force"] / ds[RELIEF]).values):
        named.remove(RELIEF)  # the same picture as that of the force
    return tuple(value_of(ds[name]) for name in named)


def value_of(data: xr.DataArray) -> Value:
    """The quantity `data` in colours; of flags those that occur, one each."""
    name = str(data.name)
    if "flag_meanings" in data.attrs and np.size(data.values):
        return _flags_value(data)
    (text, colours), (factor, unit) = _QUANTITIES.get(name, (name.replace("_", " "), "viridis")), scale(data)
    finite: Cells = data.values[np.isfinite(data.values)] * factor
    finite = finite[finite > 0] if name in _NOTHING_AT_ZERO else finite
    if not finite.size:  # nothing to show
        finite = np.array([0.0, 1.0])
    low, high, norm = _norm(name, finite)
    beyond = bool(finite.min() < low), bool(finite.max() > high)
    extend: dict[tuple[bool, bool], Literal["neither", "min", "max", "both"]]
    extend = {(False, False): "neither", (True, False): "min", (False, True): "max", (True, True): "both"}
    shown = colormaps[COLOURS.get() or colours].with_extremes(bad=UNDEFINED)
    return Value(name, with_unit(text, unit), factor, norm, extend[beyond], shown)


def _flags_value(data: xr.DataArray) -> Value:
    """Flags in colours: of stability and of regimes their own, of others in order."""
    meanings = flag_names(data)
    there = np.unique(data.values[~np.isnan(data.values)]).astype(int).tolist() or [0]
    own = (
        REGIME_COLOURS if "single-impact" in meanings.values() else _STABILITY_COLOURS if data.name == "stable" else {}
    )
    colours = [own.get(flag, OTHER_COLOURS[at % len(OTHER_COLOURS)]) for at, flag in enumerate(there)]
    between = [(one + other) / 2 for one, other in pairwise(there)]
    norm = BoundaryNorm([there[0] - 0.5, *between, there[-1] + 0.5], len(there))
    name = str(data.name)
    names = {flag: meanings.get(flag, str(flag)) for flag in there}
    shown = ListedColormap(colours, name=name).with_extremes(bad=UNDEFINED)
    return Value(name, _QUANTITIES.get(name, (name.replace("_", " "), ""))[0], 1.0, norm, "neither", shown, names)


def name_flags(axis: Axis, value: Value) -> None:
    """Write along an axis what the flags mean, where `value` has flags; many side by side on two lines, if they can."""
    if value.names:
        side_by_side = isinstance(axis, XAxis) and len(value.names) > _BESIDE
        names = [name.replace("-", "-\n", 1) if side_by_side else name for name in value.names.values()]
        axis.set_ticks(list(value.names), names)
        axis.set_minor_locator(NullLocator())


def shape_flags(axes: Axes, value: Value) -> None:
    """Give the y axis of `axes` the names and the limits of flags, where `value` has flags."""
    if value.names:
        name_flags(axes.yaxis, value)
        axes.set_ylim(min(value.names) - 0.5, max(value.names) + 0.5)


def share_value(data: xr.DataArray, name: str) -> Value:
    """The share [%] `data` of starts that end in the regime `name`, in colours from 0 to 100 %."""
    colours = colormaps[COLOURS.get() or "viridis"]
    return Value(str(data.name), f"{name} [% of starts]", 1.0, Normalize(0.0, 100.0), "neither", colours)


def value_handles(data: Sequence[xr.Dataset], values: Sequence[Value]) -> list[Artist]:
    """The legend's entries for lanes without penetration and without a value, where there are any."""
    nothing = any((part[value.name].values == 0).any() for part in data for value in values if value.of_rate)
    missing = any(np.isnan(part[value.name].values).any() for part in data for value in values)
    handles: list[Artist] = [_patch(NOTHING, "no penetration")] if nothing else []
    return handles + ([_patch(UNDEFINED, "no value")] if missing else [])


def _varies(values: Cells) -> bool:
    finite = values[np.isfinite(values)]
    return bool(finite.size) and bool(np.ptp(finite) > _SAME * np.abs(finite).max())


def _limits(name: str, finite: Cells) -> tuple[float, float]:
    """The least and the greatest value, or the robust limits where that is an outlier, as in what the drill does."""
    low, high = (float(limit) for limit in np.percentile(finite, ROBUST))
    if name in _OF_DRILL:
        return low, high
    beyond = _OUTLYING * (high - low)
    least, greatest = float(finite.min()), float(finite.max())
    return (least if least >= low - beyond else low), (greatest if greatest <= high + beyond else high)


def _norm(name: str, finite: Cells) -> tuple[float, float, Normalize]:
    """The limits of the colours, from zero for a share; logarithmic for rates over decades."""
    low, high = _limits(name, finite)
    if name in _SPREAD and finite.min() > 0 and float(np.percentile(finite, _MANY)) < high / _WIDE:
        low = float(np.percentile(finite, ROBUST[0]))
        return low, high, LogNorm(low, high)
    if high - low <= 1e-6 * abs(high):  # one value everywhere: a bar with room on both sides
        low, high = low - 0.05 * abs(low) - 1e-12, high + 0.05 * abs(high) + 1e-12
    low = 0.0 if name == "C_relative_error" else low
    return low, high, Normalize(low, high)

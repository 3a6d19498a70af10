"""The quantities drawn beside the regimes: which, in which colours, between which limits."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr
from matplotlib import colormaps
from matplotlib.artist import Artist
from matplotlib.colors import Colormap, LogNorm, Normalize

from vibrojax.plot._flags import patch
from vibrojax.plot._labels import scale, with_unit
from vibrojax.plot._style import NOTHING, UNDEFINED

# Name on the picture and colours, perceptually uniform. Beside the regimes stand the first two that a dataset has.
_KNOWN = {
    "rate_of_penetration": ("rate of penetration", "plasma"),
    "impact_velocity": ("impact velocity", "viridis"),
    "period": ("period", "cividis"),
    "bit_amplitude": ("bit amplitude", "plasma"),
    "slip_per_impact": ("slip per blow", "viridis"),
    "mean_force": ("mean force P", "cividis"),
    "relief": ("relief P/D", "cividis"),
    "C": ("C", "viridis"),
    "C_relative_error": ("standard error of C", "cividis"),
}
_OF_DRILL = ("impact_velocity", "period", "bit_amplitude")
_BESIDE = ("rate_of_penetration", *_OF_DRILL)
_OF_ROCK = ("rate_of_penetration", "slip_per_impact", "relief", "mean_force")
_NOTHING_AT_ZERO = {"rate_of_penetration", "slip_per_impact"}
_SHOWN = 2
ROBUST = (2.0, 98.0)  # percentiles
_OUTLYING = 2.0  # of the range between them, from which what lies beyond is left out of the colours
_SPREAD = {"rate_of_penetration", "slip_per_impact", "C"}
_MANY, _WIDE = 20.0, 15.0  # that share [percent] of rates, so much smaller than the greatest: logarithmic colours
_SAME = 1e-9  # relative, within which a value does not vary


@dataclass(frozen=True)
class Value:
    """A variable in colours: its values times `factor`, under `norm`, which all panels of a picture share."""

    name: str
    label: str
    factor: float
    norm: Normalize
    extend: str
    colour_map: Colormap

    @property
    def of_rate(self) -> bool:
        """Whether zero means that there is no penetration."""
        return self.name in _NOTHING_AT_ZERO

    def of(self, ds: xr.Dataset) -> xr.DataArray:
        """The values in `ds`, in the unit of the label."""
        return ds[self.name] * self.factor


def values_beside(ds: xr.Dataset) -> tuple[Value, ...]:
    """The values worth a panel beside the regimes; none for a variable without a single finite value."""
    named = [name for name in _BESIDE if name in ds and np.isfinite(ds[name].values).any()]
    return tuple(value_of(ds[name]) for name in named[:_SHOWN])


def values_of_rock(ds: xr.Dataset) -> tuple[Value, ...]:
    """The values worth a map where there are no regimes: the rate of penetration, and what else varies."""
    named = [name for name in _OF_ROCK if name in ds and (name == _OF_ROCK[0] or _varies(ds[name].values))]
    if {"relief", "mean_force"} <= set(named) and not _varies((ds["mean_force"] / ds["relief"]).values):
        named.remove("relief")  # the same picture as that of the force
    return tuple(value_of(ds[name]) for name in named)


def value_handles(data: Sequence[xr.Dataset], values: Sequence[Value]) -> list[Artist]:
    """The legend's entries for lanes without penetration and without a value, where there are any."""
    nothing = any((part[value.name].values == 0).any() for part in data for value in values if value.of_rate)
    missing = any(np.isnan(part[value.name].values).any() for part in data for value in values)
    found: list[Artist] = [patch(NOTHING, "no penetration")] if nothing else []
    return found + ([patch(UNDEFINED, "no value")] if missing else [])


def _varies(values: np.ndarray) -> bool:
    finite = values[np.isfinite(values)]
    return bool(finite.size) and bool(np.ptp(finite) > _SAME * np.abs(finite).max())


def _limits(name: str, finite: np.ndarray) -> tuple[float, float]:
    """The least and the greatest value, or the robust limits where that is an outlier, as in what the drill does."""
    low, high = (float(limit) for limit in np.percentile(finite, ROBUST))
    if name in _OF_DRILL:
        return low, high
    beyond = _OUTLYING * (high - low)
    least, greatest = float(finite.min()), float(finite.max())
    return (least if least >= low - beyond else low), (greatest if greatest <= high + beyond else high)


def value_of(data: xr.DataArray) -> Value:
    """The variable `data`, which is one of the known, in colours."""
    name = str(data.name)
    (text, colours), (factor, unit) = _KNOWN[name], scale(data)
    finite = data.values[np.isfinite(data.values)] * factor
    finite = finite[finite > 0] if name in _NOTHING_AT_ZERO else finite
    finite = finite if finite.size else np.array([0.0, 1.0])  # nothing to show
    norm = _norm(name, finite)
    below, above = bool(finite.min() < norm.vmin), bool(finite.max() > norm.vmax)
    extend = {(False, False): "neither", (True, False): "min", (False, True): "max", (True, True): "both"}[below, above]
    shown = colormaps[colours].with_extremes(bad=UNDEFINED)
    return Value(name, with_unit(text, unit), factor, norm, extend, shown)


def _norm(name: str, finite: np.ndarray) -> Normalize:
    """The limits of the colours, from zero for a share; logarithmic for rates over decades."""
    low, high = _limits(name, finite)
    if name in _SPREAD and finite.min() > 0 and float(np.percentile(finite, _MANY)) < high / _WIDE:
        return LogNorm(float(np.percentile(finite, ROBUST[0])), high)
    if high - low <= 1e-6 * abs(high):  # one value everywhere: a bar with room on both sides
        low, high = low - 0.05 * abs(low) - 1e-12, high + 0.05 * abs(high) + 1e-12
    return Normalize(0.0 if name == "C_relative_error" else low, high)

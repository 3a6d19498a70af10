"""The quantities drawn beside the regimes: which, in which colours, between which limits."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr
from matplotlib import colormaps
from matplotlib.artist import Artist
from matplotlib.colors import Colormap, Normalize

from vibrojax.plot._flags import patch
from vibrojax.plot._labels import scale, with_unit
from vibrojax.plot._style import UNDEFINED

# Name on the picture and colours, perceptually uniform. A picture shows the first two that a dataset has.
_KNOWN = {
    "impact_velocity": ("impact velocity", "viridis"),
    "period": ("period", "cividis"),
    "bit_amplitude": ("bit amplitude", "plasma"),
}
_SHOWN = 2
_ROBUST = (2.0, 98.0)  # percentiles


@dataclass(frozen=True)
class Value:
    """A variable in colours: its values times `factor`, under `norm`, which all panels of a picture share."""

    name: str
    label: str
    factor: float
    norm: Normalize
    extend: str
    colour_map: Colormap

    def of(self, ds: xr.Dataset) -> xr.DataArray:
        """The values in `ds`, in the unit of the label."""
        return ds[self.name] * self.factor


def values_beside(ds: xr.Dataset) -> tuple[Value, ...]:
    """The values worth a panel beside the regimes; none for a variable without a single finite value."""
    named = [name for name in _KNOWN if name in ds and np.isfinite(ds[name].values).any()]
    return tuple(_value(ds[name]) for name in named[:_SHOWN])


def undefined_handle(data: Sequence[xr.Dataset], values: Sequence[Value]) -> list[Artist]:
    """The legend's entry for the grey of lanes without a value, where there are any."""
    missing = any(np.isnan(part[value.name].values).any() for part in data for value in values)
    return [patch(UNDEFINED, "no value")] if missing else []


def _value(data: xr.DataArray) -> Value:
    (text, colours), (factor, unit) = _KNOWN[str(data.name)], scale(data)
    finite = data.values[np.isfinite(data.values)] * factor
    low, high = (float(limit) for limit in np.percentile(finite, _ROBUST))
    if high - low <= 1e-6 * abs(high):  # one value everywhere: a bar with room on both sides
        low, high = low - 0.05 * abs(low) - 1e-12, high + 0.05 * abs(high) + 1e-12
    below, above = bool(finite.min() < low), bool(finite.max() > high)
    extend = {(False, False): "neither", (True, False): "min", (False, True): "max", (True, True): "both"}[below, above]
    shown = colormaps[colours].with_extremes(bad=UNDEFINED)
    return Value(str(data.name), with_unit(text, unit), factor, Normalize(low, high), extend, shown)

"""Regimes in pictures: one colour each, for ever, so that pictures of different runs can be read side by side."""

from collections.abc import Iterable

import numpy as np
import xarray as xr
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.patches import Patch

from vibrojax.label import REGIMES
from vibrojax.plot._labels import share_text
from vibrojax.plot._style import UNDEFINED

# Any two differ by 28 or more in CIELAB, also with any one kind of cone missing. The one to find, 3, is the brightest.
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

COLOUR_MAP = ListedColormap(list(REGIME_COLOURS.values()), name="regimes").with_extremes(bad=UNDEFINED)
NORM = BoundaryNorm(np.arange(-0.5, len(REGIME_COLOURS)), len(REGIME_COLOURS))


def flags(data: xr.DataArray) -> np.ndarray:
    """The flags in `data` as floats; NaN where there is none of the known ones."""
    values = np.asarray(data.values, float)
    return np.where(np.isin(values, list(REGIME_COLOURS)), values, np.nan)


def names(data: xr.DataArray) -> dict[int, str]:
    """The name of each flag, by the attributes `flag_values` and `flag_meanings` of `data` where they are there."""
    values = np.atleast_1d(data.attrs.get("flag_values", [])).astype(int).tolist()
    meanings = str(data.attrs.get("flag_meanings", "")).split()
    return dict(enumerate(REGIMES)) | dict(zip(values, meanings, strict=False))


def counts(data: Iterable[xr.DataArray]) -> dict[int, int]:
    """The flags that occur in `data`, in their order, and how many lanes have each."""
    values = np.concatenate([flags(part).ravel() for part in data])
    found, lanes = np.unique(values[np.isfinite(values)], return_counts=True)
    return dict(zip(found.astype(int).tolist(), lanes.tolist(), strict=True))


def legend_handles(data: list[xr.DataArray]) -> list[Patch]:
    """A patch for each regime that occurs in `data`, named with its share of the lanes."""
    named = names(data[0])
    lanes = sum(part.size for part in data)
    shares = {flag: share_text(n / lanes) for flag, n in counts(data).items()}
    return [patch(REGIME_COLOURS[flag], f"{named[flag]}  {share}") for flag, share in shares.items()]


def patch(colour: str, name: str) -> Patch:
    """A legend's patch of `colour`."""
    return Patch(facecolor=colour, edgecolor="0.35", linewidth=0.4, label=name)

"""Regimes in pictures: one colour each, for ever, so that pictures of different runs can be read side by side."""

from collections.abc import Iterable

import numpy as np
import xarray as xr
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.patches import Patch

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
_NAMES = ("undecided", "equilibrium", "impact-free", "single-impact", "multi-impact", "subharmonic", "irregular", "failed")

COLOUR_MAP = ListedColormap(list(REGIME_COLOURS.values()), name="regimes").with_extremes(bad=UNDEFINED)
NORM = BoundaryNorm(np.arange(-0.5, len(REGIME_COLOURS)), len(REGIME_COLOURS))


def flags(data: xr.DataArray) -> np.ndarray:
    """The flags in `data` as floats; NaN where there is none of the known ones."""
    values = np.asarray(data.values, float)
    return np.where(np.isin(values, list(REGIME_COLOURS)), values, np.nan)


def names(data: xr.DataArray) -> dict[int, str]:
    """The name of each flag, as in the attributes `flag_values` and `flag_meanings` of `data`, or as in the contract."""
    values = np.atleast_1d(data.attrs.get("flag_values", [])).astype(int).tolist()
    meanings = str(data.attrs.get("flag_meanings", "")).split()
    return dict(enumerate(_NAMES)) | dict(zip(values, meanings, strict=False))


def present(data: Iterable[xr.DataArray]) -> dict[int, float]:
    """The flags that occur in `data`, and the share of lanes that each has; the known flags only."""
    values = np.concatenate([flags(part).ravel() for part in data])
    known = values[np.isfinite(values)].astype(int)
    return {int(flag): np.count_nonzero(known == flag) / max(values.size, 1) for flag in np.unique(known)}


def legend_handles(data: list[xr.DataArray]) -> list[Patch]:
    """A patch for each regime that occurs in `data`, named with its share of the lanes."""
    named = names(data[0])
    return [
        Patch(facecolor=REGIME_COLOURS[flag], edgecolor="0.35", linewidth=0.4, label=f"{named[flag]}  {share_text(share)}")
        for flag, share in present(data).items()
    ]

"""Borders of the stable single-impact orbits as curves, with one line style per kind of border."""

from collections.abc import Iterable
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke

from vibrojax.errors import InputError
from vibrojax.plot.axes import scale
from vibrojax.plot.colours import flag_names
from vibrojax.plot.contents import START
from vibrojax.plot.overlays import SAME_DIGITS, check_machine
from vibrojax.plot.style import DASHED, FAINT, INK

ANY = "any"

# Distinguishable in greyscale and for colour-blind readers. Special points of families have the same or similar
# colours.
LINES: dict[str, dict[str, Any]] = {
    "fold": {"color": "#222222", "linestyle": "-"},
    "period-doubling": {"color": "#D55E00", "linestyle": "-"},
    "torus": {"color": "#B5468B", "linestyle": (0.0, (7.0, 1.5))},
    "grazing": {"color": "#009E73", "linestyle": (0.0, (5.0, 1.2, 1.2, 1.2))},
    "stick": {"color": "#E69F00", "linestyle": "-"},
    "section": {"color": "#0072B2", "linestyle": (0.0, (1.2, 1.2))},
    "end": {"color": INK, "linestyle": ":"},
    "basin": {"color": "#6E6E6E", "linestyle": DASHED},
    "not-settled": {"color": FAINT, "linestyle": (0.0, (1.2, 1.6))},
}
_OTHER_LINE = {"color": INK, "linestyle": "-"}

OVER_TEXT = "Lines: where stable single impacts end, whichever start leads to them"
"""Note printed when borders are drawn over a map."""


def axes_of(ds: xr.Dataset) -> tuple[str, str]:
    """Return the parameters on the horizontal and on the vertical axis."""
    first, second = (str(name) for name in np.atleast_1d(ds.attrs["axes"]))
    return first, second


def beyond(ds: xr.Dataset) -> list[str]:
    """Return the further parameters: constant within a plane of the two axes, different between planes."""
    names = (str(name) for name, data in ds.coords.items() if data.dims == ("curve",))
    return [name for name in names if name not in (START, "curve")]


def draw_borders(axes: Axes, ds: xr.Dataset, plane: dict[str, float], start: str, x: str, y: str) -> list[str]:
    """Draw the curves of one plane (parameter values) and one initial condition; return the kinds of borders drawn."""
    mask = ds[START].values == start if START in ds.coords else np.ones(ds.sizes["curve"], bool)
    for name, value in plane.items():
        mask &= np.isclose(ds[name].values, value, rtol=SAME_DIGITS, atol=0.0)
    names, factors = flag_names(ds["kind"]), [scale(ds[name])[0] for name in (x, y)]
    stroke = [withStroke(linewidth=2.8, foreground="white", alpha=0.85)]
    kinds = []
    for curve in np.flatnonzero(mask):
        kinds.append(names[int(ds["kind"][curve])])
        vertices = ds["curve"].values == curve
        path = (factor * ds[name].values[vertices] for name, factor in zip((x, y), factors, strict=True))
        axes.plot(*path, linewidth=1.6, path_effects=stroke, **LINES.get(kinds[-1], _OTHER_LINE))
    return kinds


def border_handles(kinds: Iterable[str]) -> list[Artist]:
    """Return the legend entries for kinds of borders."""
    occurring = set(kinds)
    return [
        Line2D([], [], label=kind, linewidth=1.8, **LINES.get(kind, _OTHER_LINE))
        for kind in (*LINES, *sorted(occurring - set(LINES)))
        if kind in occurring
    ]


def check_borders(ds: xr.Dataset, over: xr.Dataset, x: str, y: str) -> None:
    """Raise `InputError` unless the borders `over` have the map's axes, and the scene and friction law of `ds`."""
    if set(axes_of(over)) != {x, y}:
        raise InputError(f"over: the borders are over {' and '.join(axes_of(over))}, the map over {x} and {y}")
    check_machine(ds, over, "borders", "map", "find those of")


def draw_over_panel(axes: Axes, over: xr.Dataset, facet: xr.Dataset, x: str, y: str) -> list[str]:
    """Draw the borders that hold for any initial condition over a map panel; return the kinds of borders drawn."""
    plane = {name: float(facet[name]) for name in beyond(over) if name in facet.coords and facet[name].ndim == 0}
    return draw_borders(axes, over, plane, ANY, x, y)

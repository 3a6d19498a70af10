"""Borders of the stable single impact drawn as curves, one line style for each kind."""

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
from vibrojax.plot.style import DASHED, FAINT, INK

START = "start"
ANY = "any"
_SAME = 1e-4  # relative: as many digits as a picture prints

# Told apart in greyscale and by colour-blind eyes, with the colours that the same kinds have along families.
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


def axes_of(ds: xr.Dataset) -> tuple[str, str]:
    """The parameter that runs to the right, and the one that runs up."""
    first, second = (str(name) for name in np.atleast_1d(ds.attrs["axes"]))
    return first, second


def beyond(ds: xr.Dataset) -> list[str]:
    """The parameters that are the same all over a plane, but not in all planes."""
    names = (str(name) for name, data in ds.coords.items() if data.dims == ("curve",))
    return [name for name in names if name not in (START, "curve")]


def draw_borders(axes: Axes, ds: xr.Dataset, at: dict[str, float], start: str, x: str = "", y: str = "") -> list[str]:
    """Draw the curves of the plane with the values `at`, and of a `start`; the kinds that were drawn."""
    x, y = (x, y) if x else axes_of(ds)
    of_start = np.ones(ds.sizes["curve"], bool)
    if START in ds.coords:
        of_start = ds[START].values == start
    for name, value in at.items():
        of_start &= np.isclose(ds[name].values, value, rtol=_SAME, atol=0.0)
    names, number = flag_names(ds["kind"]), ds["curve"].values
    factors = [scale(ds[name])[0] for name in (x, y)]
    drawn = []
    for curve in np.flatnonzero(of_start):
        kind = names[int(ds["kind"][curve])]
        mine = number == curve
        line = _line(kind)
        axes.plot(
            ds[x].values[mine] * factors[0],
            ds[y].values[mine] * factors[1],
            linewidth=1.6,
            path_effects=[withStroke(linewidth=2.8, foreground="white", alpha=0.85)],
            **line,
        )
        drawn.append(kind)
    return drawn


def border_handles(kinds: Iterable[str]) -> list[Artist]:
    """The legend's entries for kinds of borders."""
    found = set(kinds)
    return [
        Line2D([], [], label=kind, linewidth=1.8, **_line(kind))
        for kind in (*LINES, *sorted(found - set(LINES)))
        if kind in found
    ]


OVER_TEXT = "Lines: where stable single impacts end, whichever start leads to them"
"""What the borders over a map are."""


def check_borders(ds: xr.Dataset, over: xr.Dataset, x: str, y: str) -> None:
    """Raise `InputError` unless `over` has borders over the axes of a map of `ds`."""
    if set(axes_of(over)) != {x, y}:
        raise InputError(f"over: the borders are over {' and '.join(axes_of(over))}, the map over {x} and {y}")
    for name in ("scene", "friction"):
        if ds.attrs.get(name) != over.attrs.get(name):
            raise InputError(
                f"over: the borders are of {name} {over.attrs.get(name)}, the map of {ds.attrs.get(name)}; "
                f"find those of {ds.attrs.get(name)}"
            )


def draw_over_panel(axes: Axes, over: xr.Dataset, facet: xr.Dataset, x: str, y: str) -> list[str]:
    """Draw the borders of all orbits on a panel of a map, whose cells show those of its start; the kinds drawn."""
    at = {name: float(facet[name]) for name in beyond(over) if name in facet.coords and facet[name].ndim == 0}
    return draw_borders(axes, over, at, ANY, x, y)


def _line(kind: str) -> dict[str, Any]:
    return LINES.get(kind, {"color": INK, "linestyle": "-"})

"""The analysis `tolerance`: summary and picture of a machine over the box of its parameter tolerances."""

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from vibrojax.errors import counted
from vibrojax.pictures.axes import label, scale, values_along
from vibrojax.pictures.colours import REGIME_COLOURS, regime_cells, regime_handles
from vibrojax.pictures.sheet import legend_at_right, write_margins
from vibrojax.pictures.style import new_figure, styled

_TOLERANCE = "tolerance_"
_MARKERS = "os^Dv"
_DRAWN = ("impact_velocity", "impact_energy", "rate_of_penetration")


def toleranced(ds: xr.Dataset) -> list[str]:
    """Return the names of the parameters that have a tolerance."""
    names = [name.removeprefix(_TOLERANCE) for name in ds.attrs if name.startswith(_TOLERANCE)]
    return [name for name in names if name in ds.coords]


@styled
def extremes_picture(ds: xr.Dataset) -> Figure:
    """Draw impact velocity, energy and rate of penetration of all samples over each parameter with a tolerance."""
    names = toleranced(ds)
    rows = [name for name in _DRAWN if name in ds and ds[name].notnull().any()] or ["period"]
    lanes = ds if "start" in ds.dims else ds.expand_dims("start")
    starts = [str(name) for name in np.atleast_1d(lanes["start"].values)] if "start" in lanes.coords else [""]
    figure = new_figure(1.8 + 2.6 * len(names), 0.9 + 2.2 * len(rows))
    grid = figure.subplots(len(rows), len(names), sharex="col", sharey="row", squeeze=False)
    for row, quantity in enumerate(rows):
        for column, name in enumerate(names):
            axes = grid[row, column]
            for k in range(len(starts)):
                lane = lanes.isel(start=k)
                colours = [REGIME_COLOURS[int(flag)] for flag in regime_cells(lane["regime"])]
                y = lane[quantity].values * scale(lanes[quantity])[0]
                look = {"marker": _MARKERS[k % len(_MARKERS)], "edgecolors": "0.3", "linewidths": 0.4}
                # Later starts are smaller: of samples that several starts bring to one motion, all markers show.
                axes.scatter(values_along(ds[name]), y, s=max(36.0 / 3.0**k, 4.0), c=colours, **look)
                axes.axhline(y[0], color="0.6", linewidth=0.7, linestyle="--", zorder=0)
            axes.margins(0.08)
            axes.xaxis.set_major_locator(MaxNLocator(4))
            axes.grid(True)
            if row == len(rows) - 1:
                axes.set_xlabel(label(ds[name]))
        grid[row, 0].set_ylabel(label(lanes[quantity]))
    handles: list[Artist] = regime_handles([lanes["regime"]])
    for marker, start in zip(_MARKERS, starts, strict=False):
        if start:
            handles.append(
                Line2D([], [], color="0.3", marker=marker, linestyle="none", markersize=4, label=f"start: {start}")
            )
    handles.append(Line2D([], [], color="0.6", linewidth=0.7, linestyle="--", label="nominal"))
    legend_at_right(figure, handles)
    missing = int(lanes[rows[0]].isnull().sum())
    write_margins(
        figure,
        ds,
        counted(missing, "lane without impact is", "lanes without impact are") + " not drawn"
        if missing and rows[0] != "period"
        else "",
    )
    return figure

"""The picture of a machine over the box of its parameter tolerances."""

import numpy as np
import xarray as xr

from vibrojax.errors import counted
from vibrojax.pictures.axes import axis, margins, scale, values_along
from vibrojax.pictures.colours import REGIME_COLOURS, regime_cells, regime_keys
from vibrojax.pictures.plots import Layer, Look, Plot, Points, Sheet, dots, key, level

_TOLERANCE = "tolerance_"
_MARKERS = "os^Dv"
_NOMINAL: Look = {"colour": "#999999", "width": 0.7, "dash": "--"}
_DRAWN = ("impact_velocity", "impact_energy", "rate_of_penetration")


def toleranced(ds: xr.Dataset) -> list[str]:
    """Return the names of the parameters that have a tolerance."""
    names = [name.removeprefix(_TOLERANCE) for name in ds.attrs if name.startswith(_TOLERANCE)]
    return [name for name in names if name in ds.coords]


def extremes_picture(ds: xr.Dataset) -> Sheet:
    """Draw impact velocity, energy and rate of penetration of all samples over each parameter with a tolerance."""
    names = toleranced(ds)
    rows = [name for name in _DRAWN if name in ds and ds[name].notnull().any()] or ["period"]
    lanes = ds if "start" in ds.dims else ds.expand_dims("start")
    starts = [str(name) for name in np.atleast_1d(lanes["start"].values)] if "start" in lanes.coords else [""]
    plots = []
    for row, quantity in enumerate(rows):
        for column, name in enumerate(names):
            layers: list[Layer] = []
            for k in range(len(starts)):
                lane = lanes.isel(start=k)
                colours = [REGIME_COLOURS[int(flag)] for flag in regime_cells(lane["regime"])]
                y = lane[quantity].values * scale(lanes[quantity])[0]
                look: Look = {"marker": _MARKERS[k % len(_MARKERS)], "edge": "#4D4D4D", "edge_width": 0.4}
                # Later starts are smaller: of samples that several starts bring to one motion, all markers show.
                size = max(6.0 / 3.0 ** (k / 2), 2.0)
                layers.append(level(y[0], order=0.0, **_NOMINAL))
                layers.append(Points(values_along(ds[name]), y, colours, size, **look))
            across = axis(ds[name], group=name, margin=0.08, intervals=4)
            up = axis(lanes[quantity], group=quantity, margin=0.08)
            plots.append(Plot(layers, across, up, place=(row, column)))
    keys = regime_keys([lanes["regime"]])
    for marker, start in zip(_MARKERS, starts, strict=False):
        keys += [dots(label=f"start: {start}", colour="#4D4D4D", marker=marker)] if start else []
    keys.append(key("nominal", **_NOMINAL))
    missing = int(lanes[rows[0]].isnull().sum()) if rows[0] != "period" else 0
    note = counted(missing, "lane without impact is", "lanes without impact are") + " not drawn" if missing else ""
    size = 1.8 + 2.6 * len(names), 0.9 + 2.2 * len(rows)
    return Sheet(plots, size, (1.0,) * len(names), (1.0,) * len(rows), [keys], **margins(ds, note))

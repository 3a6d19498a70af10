"""Picture of borders: the curves of each plane, a column for each initial condition."""

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from vibrojax.errors import InputError
from vibrojax.io.kinds import kind_of
from vibrojax.plot.axes import label, point_text, share_text, value_text
from vibrojax.plot.borders import ANY, axes_of, beyond, border_handles, draw_borders
from vibrojax.plot.margins import legend_at_right, write_margins
from vibrojax.plot.style import new_figure, styled

_PANEL = (3.3, 3.0)  # inches
_MOST = (4, 4)  # planes and starts that are shown


@styled
def border_curves(ds: xr.Dataset) -> Figure:
    """The borders of the single impact over the plane's two parameters: a row for each plane, a column for each start.

    **Arguments:** `ds`: what `borders` gives.

    **Returns:** a figure that pyplot knows nothing of.

    **Raises:** `InputError` where there are no borders.
    """
    if kind_of(ds) != "borders":
        raise InputError("no borders to draw: the dataset holds no curves, as vj.borders gives them")
    x, y = axes_of(ds)
    regions = ds.sizes["region"]
    others = beyond(ds)
    planes = list(dict.fromkeys(tuple(float(ds[f"region_{name}"][k]) for name in others) for k in range(regions)))
    starts = list(dict.fromkeys(ds["region_start"].values.tolist())) if "region_start" in ds.coords else [ANY]
    planes_shown, starts_shown = planes[: _MOST[0]], [*starts[:-1][: _MOST[1] - 1], starts[-1]]
    width, height = _PANEL
    figure = new_figure(width * len(starts_shown) + 1.6, height * len(planes_shown) + 0.6)
    grid = figure.subplots(len(planes_shown), len(starts_shown), squeeze=False, sharex=True, sharey=True)
    drawn: list[str] = []
    for row, plane in zip(grid, planes_shown, strict=True):
        for axes, start in zip(row, starts_shown, strict=True):
            at = dict(zip(others, plane, strict=True))
            drawn += draw_borders(axes, ds, at, start)
            words = [value_text(ds[name], value) for name, value in at.items()]
            words.append("any start" if start == ANY else f"start {start}")
            area = _area(ds, at, start)
            axes.set_title(f"{', '.join(words)}: {share_text(area)}")
            axes.grid(True)
        row[0].set_ylabel(label(ds[y]))
    for axes in grid[-1]:
        axes.set_xlabel(label(ds[x]))
    legend_at_right(figure, border_handles(drawn))
    left_out = f"{len(planes) - len(planes_shown)} planes and {len(starts) - len(starts_shown)} starts are not shown"
    everything = len(planes) == len(planes_shown) and len(starts) == len(starts_shown)
    about = "Percent: share of the plane with a stable single impact; any start: however its orbit is reached"
    write_margins(figure, str(ds.attrs.get("title", "")), point_text(ds), about, "" if everything else left_out)
    return figure


def _area(ds: xr.Dataset, at: dict[str, float], start: str) -> float:
    here = np.ones(ds.sizes["region"], bool)
    if "region_start" in ds.coords:
        here = ds["region_start"].values == start
    for name, value in at.items():
        here &= ds[f"region_{name}"].values == value
    return float(ds["region_area"].values[here][0])

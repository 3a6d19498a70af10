"""Picture of borders: a row of panels for each plane, a column for each initial condition."""

from itertools import product

import xarray as xr
from matplotlib.figure import Figure

from vibrojax.plot.axes import label, share_text, value_text
from vibrojax.plot.overlays import ANY, axes_of, beyond, border_handles, draw_borders
from vibrojax.plot.sheet import legend_at_right, write_margins
from vibrojax.plot.style import new_figure, styled

_PANEL = (3.3, 3.0)  # inches
_MOST_SHOWN = 4  # largest numbers of rows and of columns


@styled
def border_curves(ds: xr.Dataset) -> Figure:
    """Draw the borders of stable single impacts over two parameters.

    The figure has a row for each plane and a column for each initial condition.
    """
    x, y = axes_of(ds)
    others = beyond(ds)
    planes = [tuple(float(ds[f"region_{name}"][k]) for name in others) for k in range(ds.sizes["region"])]
    starts = ds["region_start"].values.tolist() if "region_start" in ds.coords else [ANY] * len(planes)
    areas = dict(reversed(list(zip(zip(planes, starts, strict=True), ds["region_area"].values.tolist(), strict=True))))
    rows, columns = list(dict.fromkeys(planes)), list(dict.fromkeys(starts))
    shown_rows, shown_columns = rows[:_MOST_SHOWN], [*columns[:-1][: _MOST_SHOWN - 1], columns[-1]]
    width, height = _PANEL
    figure = new_figure(width * len(shown_columns) + 1.6, height * len(shown_rows) + 0.6)
    grid = figure.subplots(len(shown_rows), len(shown_columns), squeeze=False, sharex=True, sharey=True)
    kinds: list[str] = []
    for axes, (plane, start) in zip(grid.flat, product(shown_rows, shown_columns), strict=True):
        values = dict(zip(others, plane, strict=True))
        kinds += draw_borders(axes, ds, values, start, x, y)
        words = [value_text(ds[name], value) for name, value in values.items()]
        words.append("any start" if start == ANY else f"start {start}")
        axes.set_title(f"{', '.join(words)}: {share_text(areas[plane, start])}")
        axes.grid(True)
    for axes in grid[:, 0]:
        axes.set_ylabel(label(ds[y]))
    for axes in grid[-1]:
        axes.set_xlabel(label(ds[x]))
    legend_at_right(figure, border_handles(kinds))
    hidden = len(rows) - len(shown_rows), len(columns) - len(shown_columns)
    about = "Percent: share of the plane with a stable single impact; any start: however its orbit is reached"
    write_margins(figure, ds, about, "{} planes and {} starts are not shown".format(*hidden) if any(hidden) else "")
    return figure

"""Any variables of a dataset, in the picture that fits its dimensions: maps, curves, points, or a time history."""

from collections.abc import Sequence
from typing import Literal

import xarray as xr
from matplotlib.figure import Figure

from vibrojax.analyses.continuation.picture import families
from vibrojax.analyses.sweep.basins import many_starts
from vibrojax.analyses.sweep.maps import map_of
from vibrojax.analyses.sweep.scatter import scattered
from vibrojax.analyses.sweep.strips import regime_lines
from vibrojax.errors import InputError, shown, suggestion
from vibrojax.io.kinds import kind_of
from vibrojax.plot.axes import label, point_text, steady
from vibrojax.plot.colours import Value, shape_flags, value_of
from vibrojax.plot.contents import (
    FORM,
    MULTIPLIER,
    POINT,
    REGIME,
    TIME,
    axes_of_map,
    contents,
    lane_dims,
    named_groups,
    varied,
    without_single,
)
from vibrojax.plot.curves import MOST_ROWS, across, axis_of_lines, label_axes, line_handles, lines, rows
from vibrojax.plot.envelope import band_text, draw_over_time
from vibrojax.plot.margins import legend_at_right, write_margins
from vibrojax.plot.sheet import facets
from vibrojax.plot.starts import medians, medians_text, varied_states
from vibrojax.plot.style import BIT, Mark, new_figure, styled

_MOST, _MOST_OF_RUN = 4, 8  # variables


@styled
def variables(ds: xr.Dataset, names: Sequence[str]) -> Figure:
    """The variables `names` of `ds`, each on panels of its own.

    Over two axes they are maps, over one, curves; of a list of points over two parameters, dots; of a run, time
    histories; of families, lines along them. Of multipliers the largest is drawn. Of many starts the median stands for
    all where there is no room for each.

    **Arguments:**

    - `ds`: what a sweep, a fit or `simulate` gives.
    - `names`: of variables along all the dimensions of its lanes, four at most; of a run, along time, eight at most.

    **Returns:** a figure that pyplot knows nothing of.

    **Raises:** `InputError` where there is no such variable, it lies along other dimensions, or there are too many.
    """
    _check(ds, names)
    if TIME in ds.dims:
        return _histories(ds, names)
    if kind_of(ds) == "family":
        return families(ds, names)
    ds = without_single(_largest(named_groups(ds), names))
    held, about = contents(ds), ""
    values = tuple(None if name == REGIME else value_of(ds[name]) for name in names)
    if FORM in ds[names[0]].dims:
        return _curves(ds, values, about)
    if held.many_starts and held.regimes:
        if held.points_over_two or (not held.points and (held.axes or varied_states(ds))):
            return many_starts(ds, values, about)
        about = ". ".join(text for text in (about, medians_text(ds)) if text)
        ds = medians(ds, [name for name in names if name != REGIME])
    if held.points_over_two:
        x, y = varied(ds)
        return scattered(ds, x, y, values, about)
    if not held.points and (held.worth_a_map or (held.regimes and len(held.axes) > 1)):
        return map_of(ds, values, *axes_of_map(ds, None, None), about)
    if not held.points and held.regimes and held.axes:
        return regime_lines(ds, about=about, values=tuple(value for value in values if value is not None))
    return _curves(ds, values, about)


def _check(ds: xr.Dataset, names: Sequence[str]) -> None:
    """Raise `InputError` unless all `names` can be drawn."""
    if not isinstance(names, Sequence):
        raise InputError(f"variable: {shown(names)} is no name of a variable; give one, or a list")
    run, orbits = TIME in ds.dims, kind_of(ds) == "family"
    lanes = {TIME} if run else {POINT} if orbits else set(lane_dims(ds))
    found = {str(name): data for name, data in ds.data_vars.items() if data.dtype.kind in ("f" if orbits else "fiub")}
    drawable = [name for name, data in found.items() if lanes == {*data.dims} - {FORM, MULTIPLIER}]
    what = "time" if run else "point of the families" if orbits else "lane"
    for name in names:
        if name in ds.data_vars and name not in drawable:
            choices = f"choose from {', '.join(drawable)}" if drawable else "there is none that can"
            raise InputError(f"variable: {shown(name)} is not one number a {what}; {choices}")
        if name not in drawable:
            raise InputError(f"variable: {shown(name)} is not in the dataset; {suggestion(str(name), drawable)}")
    most = _MOST_OF_RUN if run else _MOST
    if not 1 <= len(names) <= most:
        raise InputError(f"variable: {len(names)} names; give one to {most} for a picture")


def _largest(ds: xr.Dataset, names: Sequence[str]) -> xr.Dataset:
    """`ds` with the first along `multiplier`, which is the largest, of those `names` that have several."""
    several = [name for name in names if MULTIPLIER in ds[name].dims]
    return ds.assign({name: ds[name].isel({MULTIPLIER: 0}) for name in several})


def _curves(ds: xr.Dataset, values: tuple[Value | None, ...], about: str) -> Figure:
    """The variables over the longest axis: a row for each facet, a line for each value of one more axis, or form."""
    shown = [value if value is not None else value_of(ds[REGIME]) for value in values]
    x = across(ds)
    by = FORM if FORM in ds[shown[0].name].dims else axis_of_lines(ds, x.name)
    ds = ds.sortby(x.name) if x.is_number else ds
    panels = facets(ds, (POINT, x.name, by), MOST_ROWS)
    figure, drawn, _ = rows(panels, len(shown))
    joined: Literal["-", "none"] = "-" if x.is_number and POINT not in lane_dims(ds) else "none"
    mark = Mark(marker="o", markersize=3.0, linewidth=1.2, linestyle=joined)
    for row in drawn:
        for at, value in enumerate(shown):
            for line in lines(row.facet, by):
                heights = value.of(line.lanes).values.ravel()
                row.axes[at].plot(x.of(line.lanes), heights, label=line.name, **mark | Mark(color=line.colour))
            label_axes(row, at, x.label, value.label)
            x.shape(row.axes[at])
            steady(row.axes[at])
            shape_flags(row.axes[at], value)
    legend_at_right(figure, line_handles(lines(ds, by), Mark(linestyle=joined)))
    write_margins(figure, str(ds.attrs.get("title", "")), point_text(ds), panels.note, about)
    return figure


def _histories(ds: xr.Dataset, names: Sequence[str]) -> Figure:
    """The variables of a run over time."""
    figure = new_figure(10.0, 1.5 * len(names) + 0.9)
    panels = figure.subplots(len(names), 1, sharex=True, squeeze=False)[:, 0]
    time = ds[TIME].values.astype(float)
    for axes, name in zip(panels, names, strict=True):
        value = value_of(ds[name])
        axes.grid(True)
        axes.set_xlim(time[0], time[-1])
        draw_over_time(axes, time, value.of(ds).values.astype(float), BIT, 1.0, name)
        axes.set_ylabel(value.label.replace(" [", "\n["))
        shape_flags(axes, value)
    panels[-1].set_xlabel(label(ds[TIME]))
    figure.align_ylabels()
    title = str(ds.attrs.get("title") or ds.attrs.get("scene", ""))
    write_margins(figure, title, point_text(ds), band_text(*panels))
    return figure

"""Pictures of many starts: where each of them ends, or the share of them that ends in each regime."""

import numpy as np
import xarray as xr
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from vibrojax.analyses.sweep.maps import map_of
from vibrojax.analyses.sweep.scatter import draw_points, regime_bars, scattered
from vibrojax.analyses.sweep.strips import regime_lines
from vibrojax.plot.axes import certified_text, label, point_text
from vibrojax.plot.colours import Value, name_flags, regime_handles, share_value, values_beside
from vibrojax.plot.contents import ENOUGH, POINT, REGIME, START, axes_of_map, lane_dims, regimes_in, swept, varied
from vibrojax.plot.margins import legend_at_right, write_margins
from vibrojax.plot.sheet import Panel
from vibrojax.plot.starts import (
    PREFIX,
    SHARE,
    described,
    left_out_text,
    medians,
    medians_text,
    on_axes,
    together,
    varied_states,
)
from vibrojax.plot.style import new_figure, styled

_MOST_SHARES = 5  # on maps of one facet
_SHARED = "The regime that most of {} starts end in, and the share of them that ends in each"

Values = tuple[Value | None, ...]


@styled
def many_starts(ds: xr.Dataset, values: Values | None = None, about: str = "") -> Figure:
    """Where many starts end: maps over their states where they are a grid of them, curves where they are a line.

    Other starts are scattered over the phase planes of bit and striker. Where the parameters vary over more values than
    there is room for a panel each, the share of starts in each regime stands for them, or the median of `values`,
    which are drawn in place of the regimes and what is beside them.
    """
    ds = regimes_in(ds)
    if POINT in lane_dims(ds):
        return _over_points(ds, values, about)
    axes, spread = swept(ds), on_axes(ds)
    shown = values or (None, *values_beside(ds))
    curves = None if values is None else _quantities(values)
    states = [name for name in swept(spread) if name.startswith(PREFIX)]
    long = [name for name in axes if ds.sizes[name] >= ENOUGH]
    if len(states) >= 2 and not long:
        return map_of(spread, shown, states[0], states[1], left_out_text(ds), about)
    if len(states) == 1 and len(long) == 1:
        return map_of(spread, shown, long[0], states[0], left_out_text(ds), about)
    if len(states) == 1 and not long:
        return regime_lines(spread, states[0], ". ".join(filter(None, (left_out_text(ds), about))), curves)
    if not axes:
        return _phase_planes(ds, shown, about) if varied_states(ds) else regime_bars(ds)
    if len(axes) == 1 or len(long) == 1:
        return regime_lines(ds, about=about, values=curves)
    if values is None:
        return share_grid(ds)
    x, y = axes_of_map(ds, None, None)
    return map_of(_medians(ds, values), values, x, y, about, medians_text(ds))


@styled
def share_grid(ds: xr.Dataset, x: str | None = None, y: str | None = None) -> Figure:
    """The regime that most of many starts end in, over two axes, and the shares that end in each regime."""
    ds = regimes_in(ds)
    x, y = axes_of_map(ds, x, y)
    shares = together(ds)
    further = [name for name in swept(ds) if name not in (x, y)]
    values, note = _share_values(shares, 1 if further else _MOST_SHARES)
    return map_of(shares, (None, *values), x, y, _SHARED.format(ds.sizes[START]), note)


def _over_points(ds: xr.Dataset, values: Values | None, about: str) -> Figure:
    """Many starts of each of a list of points: shares, or medians, over two parameters, or all lanes counted."""
    names = tuple(varied(ds))
    if len(names) != 2:
        return regime_bars(ds)
    if values is not None:
        return scattered(_medians(ds, values), *names, values, about, medians_text(ds))
    shares = together(ds)
    found, note = _share_values(shares, _MOST_SHARES)
    return scattered(shares, *names, (None, *found), _SHARED.format(ds.sizes[START]), note)


def _medians(ds: xr.Dataset, values: Values) -> xr.Dataset:
    return medians(ds, [value.name for value in _quantities(values)])


def _quantities(values: Values) -> tuple[Value, ...]:
    return tuple(value for value in values if value is not None)


def _share_values(shares: xr.Dataset, most: int) -> tuple[tuple[Value, ...], str]:
    """The first shares in colours, and which others there are, in words."""
    names = [str(name) for name in shares.data_vars if str(name).startswith(SHARE)]
    values = tuple(share_value(shares[name], name.removeprefix(SHARE)) for name in names[:most])
    others = [name.removeprefix(SHARE) for name in names[most:]]
    return values, f"Without a map of its share: {', '.join(others)}" if others else ""


def _phase_planes(ds: xr.Dataset, shown: Values, note: str) -> Figure:
    """Starts anywhere: the values `shown`, None for their regimes, over the states two by two."""
    ds = described(ds)
    names = varied_states(ds)
    pairs = list(zip(names[::2], names[1::2], strict=False)) or [(names[0], names[0])]
    pairs += [(names[0], names[-1])] if len(names) > 1 and len(names) % 2 else []
    order = np.random.default_rng(0).permutation(ds.sizes[START])  # no start is always in front
    figure = new_figure(3.6 * len(shown) + 1.6, 3.0 * min(len(pairs), 3) + 1.2)
    panels = figure.subplots(min(len(pairs), 3), len(shown), squeeze=False, sharey="row", sharex="row")
    for row, (x, y) in zip(panels, pairs, strict=False):
        for axes, value in zip(row, shown, strict=True):
            draw_points(Panel(figure, axes, ds.isel({START: order}), "", value, True, True), x, y)
            axes.set_xlabel(label(ds[x]))
        row[0].set_ylabel(label(ds[y]))
    for column, value in zip(panels.T, shown, strict=True):
        if value is not None:
            bar = ScalarMappable(value.norm, value.colour_map)
            drawn = figure.colorbar(
                bar,
                ax=column,
                extend=value.extend,
                label=value.label,
                location="bottom",
                aspect=30,
                ticks=MaxNLocator(5),
            )
            name_flags(drawn.long_axis, value)
    legend_at_right(figure, regime_handles([ds[REGIME]]) if None in shown else [])
    notes = point_text(ds), certified_text(ds), f"{ds.sizes[START]} starts", left_out_text(ds), note
    write_margins(figure, str(ds.attrs.get("title", "")), *notes)
    return figure

"""Regimes of many initial conditions, one by one or as fractions, and numbers of lanes in each regime."""

import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from vibrojax.pictures.axes import certified_text, label, share_text
from vibrojax.pictures.colours import (
    REGIME_COLOURS,
    Values,
    regime_counts,
    regime_handles,
    regime_names,
    share_value,
    values_beside,
)
from vibrojax.pictures.contents import ENOUGH, POINT, REGIME, START, axes_of_map, lane_dims, regimes_in, swept, varied
from vibrojax.pictures.maps import draw_map, draw_points, split_starts
from vibrojax.pictures.sheet import draw_bar, legend_at_right, write_margins
from vibrojax.pictures.starts import (
    PREFIX,
    SHARE,
    described,
    left_out_text,
    medians,
    medians_text,
    on_axes,
    regime_shares,
    varied_states,
)
from vibrojax.pictures.strips import regime_lines
from vibrojax.pictures.style import new_figure, styled

_MOST_BAR_COLUMNS = 4
_MOST_SHARES = 5  # number of fractions drawn as maps if there is a single facet


@styled
def regime_bars(ds: xr.Dataset) -> Figure:
    """Draw the number of lanes in each regime, one panel per initial condition."""
    ds = regimes_in(ds)
    panels = split_starts(ds)
    counts = [regime_counts([facet[REGIME]]) for facet in panels.data]
    occurring = sorted(set().union(*counts))
    names = regime_names(ds[REGIME])
    wide = min(len(panels), _MOST_BAR_COLUMNS)
    deep = -(-len(panels) // wide)
    figure = new_figure(1.6 + 3.0 * wide, 0.6 + deep * (0.6 + 0.32 * max(len(occurring), 2)))
    grid = figure.subplots(deep, wide, sharex=True, sharey=True, squeeze=False)
    colours = [REGIME_COLOURS[flag] for flag in occurring]
    for axes, title, facet, count in zip(grid.flat, panels.titles, panels.data, counts, strict=False):
        lanes = [count.get(flag, 0) for flag in occurring]
        bars = axes.barh(range(len(occurring)), lanes, color=colours, edgecolor="0.35", linewidth=0.4)
        axes.bar_label(bars, [f"{n}  ({share_text(n / facet[REGIME].size)})" if n else "" for n in lanes], padding=3)
        axes.margins(x=0.4)
        axes.xaxis.set_major_locator(MaxNLocator(5, integer=True))
        axes.set_title(title, loc="left")
    for axes in grid.flat[len(panels) :]:
        axes.axis("off")
    for axes in grid[-1]:
        axes.set_xlabel("lanes")
    grid[0, 0].set_yticks(range(len(occurring)), [names[flag] for flag in occurring])
    grid[0, 0].invert_yaxis()
    write_margins(figure, ds, certified_text(ds))
    return figure


@styled
def many_starts(ds: xr.Dataset, values: Values | None = None) -> Figure:
    """Draw the regimes that many initial conditions lead to.

    Initial states on a grid become maps over these states, and initial states on a line become curves. Other initial
    conditions are scattered over the phase planes of bit and striker. If parameters vary over more values than there
    can be panels, the fraction of initial conditions in each regime is drawn, or the median of `values`. If specified,
    `values` replace the regimes and the quantities next to them.
    """
    ds = regimes_in(ds)
    quantities = None if values is None else tuple(value for value in values if value is not None)
    if POINT in lane_dims(ds):
        return _over_two(ds, tuple(varied(ds)), values) if len(varied(ds)) == 2 else regime_bars(ds)
    axes, spread = swept(ds), on_axes(ds)
    shown = values or (None, *values_beside(ds))
    states = [name for name in swept(spread) if name.startswith(PREFIX)]
    long = [name for name in axes if ds.sizes[name] >= ENOUGH]
    if len(states) >= 2 and not long:
        return draw_map(spread, states[0], states[1], shown, left_out_text(ds))
    if len(states) == 1 and len(long) == 1:
        return draw_map(spread, long[0], states[0], shown, left_out_text(ds))
    if len(states) == 1 and not long:
        return regime_lines(spread, states[0], left_out_text(ds), quantities)
    if not axes:
        return _phase_planes(described(ds), shown) if varied_states(ds) else regime_bars(ds)
    if len(axes) == 1 or len(long) == 1:
        return regime_lines(ds, values=quantities)
    return _over_two(ds, axes_of_map(ds), values)


def _over_two(ds: xr.Dataset, axes: tuple[str, ...], values: Values | None) -> Figure:
    """Draw the medians of `values` over two parameters, or the fraction of initial conditions in each regime.

    The first fractions get a map each; a note lists the other regimes.
    """
    x, y = axes
    if values is not None:
        return draw_map(medians(ds, [value.name for value in values if value]), x, y, values, medians_text(ds))
    most = 1 if set(swept(ds)) - set(axes) else _MOST_SHARES
    shares = regime_shares(ds)
    names = [str(name) for name in shares.data_vars if str(name).startswith(SHARE)]
    shown = tuple(share_value(shares[name], name.removeprefix(SHARE)) for name in names[:most])
    rest = ", ".join(name.removeprefix(SHARE) for name in names[most:])
    note = f"Without a map of its share: {rest}" if rest else ""
    about = f"The regime that most of {ds.sizes[START]} starts end in, and the share of them that ends in each"
    return draw_map(shares, x, y, (None, *shown), about, note)


def _phase_planes(ds: xr.Dataset, shown: Values) -> Figure:
    """Draw the values `shown` over pairs of states, for initial conditions that form no grid."""
    names = varied_states(ds)
    pairs = list(zip(names[::2], names[1::2], strict=False)) or [(names[0], names[0])]
    pairs += [(names[0], names[-1])] if len(names) > 1 and len(names) % 2 else []
    shuffled = ds.isel({START: np.random.default_rng(0).permutation(ds.sizes[START])})  # so none is always in front
    figure = new_figure(3.6 * len(shown) + 1.6, 3.0 * min(len(pairs), 3) + 1.2)
    panels = figure.subplots(min(len(pairs), 3), len(shown), squeeze=False, sharey="row", sharex="row")
    for row, (x, y) in zip(panels, pairs, strict=False):
        for axes, value in zip(row, shown, strict=True):
            draw_points(axes, shuffled, value, x, y)
            axes.set_xlabel(label(ds[x]))
        row[0].set_ylabel(label(ds[y]))
    for column, value in zip(panels.T, shown, strict=True):
        if value is not None:
            draw_bar(figure, value, ax=column, location="bottom", aspect=30, ticks=MaxNLocator(5))
    legend_at_right(figure, regime_handles([ds[REGIME]]) if None in shown else [])
    write_margins(figure, ds, certified_text(ds), f"{ds.sizes[START]} starts", left_out_text(ds))
    return figure

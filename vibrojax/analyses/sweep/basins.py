"""Pictures of many initial conditions: the regime that each leads to, or the fraction of them in each regime."""

import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from vibrojax.analyses.sweep.maps import draw_map
from vibrojax.analyses.sweep.scatter import draw_points, draw_scatter, regime_bars
from vibrojax.analyses.sweep.strips import regime_lines
from vibrojax.plot.axes import certified_text, label
from vibrojax.plot.colours import Values, regime_handles, share_value, values_beside
from vibrojax.plot.contents import ENOUGH, POINT, REGIME, START, axes_of_map, lane_dims, regimes_in, swept, varied
from vibrojax.plot.sheet import draw_bar, legend_at_right, write_margins
from vibrojax.plot.starts import (
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
from vibrojax.plot.style import new_figure, styled

_MOST_SHARES = 5  # number of fractions drawn as maps if there is a single facet
_SHARED = "The regime that most of {} starts end in, and the share of them that ends in each"


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
        names = tuple(varied(ds))
        if len(names) != 2:
            return regime_bars(ds)
        if quantities is None or values is None:
            return draw_scatter(*_shares(ds, names, _MOST_SHARES))
        return draw_scatter(medians(ds, [value.name for value in quantities]), *names, values, medians_text(ds))
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
    if quantities is None or values is None:
        return share_grid(ds)
    x, y = axes_of_map(ds, None, None)
    return draw_map(medians(ds, [value.name for value in quantities]), x, y, values, medians_text(ds))


@styled
def share_grid(ds: xr.Dataset, x: str | None = None, y: str | None = None) -> Figure:
    """Draw the most frequent regime over two axes, and the fraction of initial conditions in each regime."""
    ds = regimes_in(ds)
    x, y = axes_of_map(ds, x, y)
    return draw_map(*_shares(ds, (x, y), 1 if set(swept(ds)) - {x, y} else _MOST_SHARES))


def _shares(ds: xr.Dataset, axes: tuple[str, str], most: int) -> tuple[xr.Dataset, str, str, Values, str, str]:
    """Return the arguments of `draw_map` for the fractions of the regimes over two axes.

    The first `most` fractions get a map each; a note lists the other regimes.
    """
    shares = regime_shares(ds)
    names = [str(name) for name in shares.data_vars if str(name).startswith(SHARE)]
    values = tuple(share_value(shares[name], name.removeprefix(SHARE)) for name in names[:most])
    rest = ", ".join(name.removeprefix(SHARE) for name in names[most:])
    note = f"Without a map of its share: {rest}" if rest else ""
    return shares, *axes, (None, *values), _SHARED.format(ds.sizes[START]), note


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

"""Smallest pushes out of the working cycle: a panel for each state, over machines or to either side."""

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from vibrojax.errors import InputError
from vibrojax.io.kinds import kind_of
from vibrojax.plot.axes import label, point_text, scale, with_unit
from vibrojax.plot.colours import REGIME_COLOURS, regime_names
from vibrojax.plot.contents import POINT, varied
from vibrojax.plot.margins import legend_at_right, write_margins
from vibrojax.plot.starts import SYMBOLS
from vibrojax.plot.style import new_figure, styled

_PUSH = "push_"
_SIDES = {-1: ("#0072B2", "v", "less"), 1: ("#D55E00", "^", "more")}


@styled
def smallest_pushes(ds: xr.Dataset) -> Figure:
    """The smallest push in each state, over what differs between machines; of one machine, to either side.

    **Arguments:** `ds`: what `smallest_push` gives.

    **Returns:** a figure that pyplot knows nothing of.

    **Raises:** `InputError` where there are no pushes.
    """
    if kind_of(ds) != "push":
        raise InputError("no pushes to draw: the dataset holds no push along sign, as vj.smallest_push gives it")
    if POINT in ds.dims and ds.sizes[POINT] == 1:
        ds = ds.isel({POINT: 0})
    states = [str(name).removeprefix(_PUSH) for name in ds.data_vars if str(name).startswith(_PUSH)]
    rows = -(-len(states) // 2)
    figure = new_figure(8.6, 2.3 * rows + 0.6)
    panels = figure.subplots(rows, 2, squeeze=False, sharex=True).ravel()
    over = next(iter(varied(ds)), POINT) if POINT in ds.dims else None
    for axes, state in zip(panels, states, strict=False):
        factor, unit = scale(ds[f"bound_{state}"])
        if over is None:
            _bars(axes, ds, state, factor)
        else:
            _curves(axes, ds, state, over, factor)
        axes.set_ylabel(with_unit(f"push in {SYMBOLS.get(state, state)}", unit))
        axes.set_ylim(bottom=0.0)
    if over is not None:
        for axes in panels[-2:]:
            axes.set_xlabel(label(ds[over]) if over in ds.coords else "machine")
    legend_at_right(figure, _handles(ds, states, over))
    write_margins(
        figure, str(ds.attrs.get("title", "")), point_text(ds), "Where nothing is drawn, none that leaves was found"
    )
    return figure


def _bars(axes: Axes, ds: xr.Dataset, state: str, factor: float) -> None:
    """The push to either side in the colour of what it ends in, below the bound."""
    push, regime = ds[f"{_PUSH}{state}"].values * factor, ds[f"regime_{state}"].values
    at = np.arange(len(push))
    axes.bar(at, np.nan_to_num(push), 0.6, color=[REGIME_COLOURS[int(one)] for one in regime], edgecolor="0.35")
    axes.axhline(float(ds[f"bound_{state}"]) * factor, color="0.5", linestyle="--", linewidth=0.9)
    axes.set_xticks(at, [_SIDES[int(sign)][2] for sign in ds["sign"].values])
    axes.set_xlim(-0.6, len(push) - 0.4)


def _curves(axes: Axes, ds: xr.Dataset, state: str, over: str, factor: float) -> None:
    """The pushes over what differs, and the bound."""
    x = ds[over].values * scale(ds[over])[0] if over in ds.coords else np.arange(ds.sizes[POINT])
    order = np.argsort(x, kind="stable")
    for sign, (colour, marker, _) in _SIDES.items():
        y = ds[f"{_PUSH}{state}"].sel(sign=sign).values * factor
        axes.plot(x[order], y[order], color=colour, marker=marker, markersize=4, linewidth=1.0)
    axes.plot(x[order], ds[f"bound_{state}"].values[order] * factor, color="0.5", linestyle="--", linewidth=0.9)
    axes.grid(True)


def _handles(ds: xr.Dataset, states: list[str], over: str | None) -> list[Artist]:
    bound = Line2D([], [], color="0.5", linestyle="--", linewidth=0.9, label="greatest tried")
    if over is not None:
        sides = [
            Line2D([], [], color=colour, marker=m, markersize=4, label=side) for colour, m, side in _SIDES.values()
        ]
        return [*sides, bound]
    names = regime_names(ds[f"regime_{states[0]}"])
    ends = np.unique([int(x) for state in states for x in ds[f"regime_{state}"].values if x > 0])
    return [*(Patch(facecolor=REGIME_COLOURS[one], edgecolor="0.35", label=names[one]) for one in ends.tolist()), bound]

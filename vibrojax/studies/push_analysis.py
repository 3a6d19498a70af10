"""The picture of the smallest pushes out of a working cycle."""

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from vibrojax.pictures.axes import label, number, scale, values_along, with_unit
from vibrojax.pictures.colours import REGIME_COLOURS, regime_cells, regime_names
from vibrojax.pictures.contents import POINT, varied
from vibrojax.pictures.sheet import legend_at_right, write_margins
from vibrojax.pictures.starts import SYMBOLS
from vibrojax.pictures.style import Mark, new_figure, styled

_PUSH = "push_"
_SIDES = {-1: ("#0072B2", "v", "negative push"), 1: ("#D55E00", "^", "positive push")}
_RETURNS = Mark(facecolor="white", edgecolor="0.7", hatch="//")  # every push tried returns
_BOUND = Mark(color="0.5", linestyle="--", linewidth=0.9)


@styled
def smallest_pushes(ds: xr.Dataset) -> Figure:
    """Draw the smallest push in each state variable, with a panel for each variable.

    Several machines are drawn as curves over their parameter, one curve for each sign of the push. One machine is drawn
    as a bar for each sign.
    """
    if POINT in ds.dims and ds.sizes[POINT] == 1:
        ds = ds.isel({POINT: 0})
    states = [str(name).removeprefix(_PUSH) for name in ds.data_vars if str(name).startswith(_PUSH)]
    rows = -(-len(states) // 2)
    figure = new_figure(8.6, 2.3 * rows + 0.6)
    panels = figure.subplots(rows, 2, squeeze=False, sharex=True).ravel()
    several = POINT in ds.dims
    over = next(iter(varied(ds)), POINT)
    handles: list[Artist] = []
    ends: dict[int, str] = {}
    returning = leaving = False
    for axes, state in zip(panels, states, strict=False):
        (factor, unit), push = scale(ds[f"bound_{state}"]), ds[f"{_PUSH}{state}"]
        bound = ds[f"bound_{state}"].values * factor
        if several:
            x = values_along(ds[over]) if over in ds.coords else np.arange(ds.sizes[POINT])
            order = np.argsort(x, kind="stable")
            for sign, (colour, marker, _) in _SIDES.items():
                y = push.sel(sign=sign).values * factor
                axes.plot(x[order], y[order], color=colour, marker=marker, markersize=4, linewidth=1.0)
                stays = np.isnan(y) & (bound > 0)
                look = Mark(linestyle="none", marker=marker, markersize=5 + sign, markerfacecolor="none")
                axes.plot(x[stays], bound[stays], color=colour, **look)
                returning |= bool(stays.any())
            axes.plot(x[order], bound[order], **_BOUND)
            axes.grid(True)
        else:
            regimes = regime_cells(ds[f"regime_{state}"]).astype(int).tolist()
            sides = np.arange(len(push))
            stable = float(bound) > 0
            for side, size, flag in zip(sides, push.values * factor, regimes, strict=True):
                leaves = bool(np.isfinite(size))
                look = Mark(facecolor=REGIME_COLOURS[flag], edgecolor="0.35") if leaves else _RETURNS
                axes.bar(side, size if leaves else float(bound) if stable else 0.0, 0.6, **look)
                text = number(float(f"{size:.3g}")) if leaves else "returns" if stable else "no stable\ncycle"
                place = (side, size if leaves else 0.5 * float(bound) if stable else 0.0)
                box = {"facecolor": "white", "edgecolor": "none", "pad": 1.5}
                axes.annotate(
                    text, place, (0, 3 * leaves), textcoords="offset points", ha="center", va="bottom", bbox=box
                )
                returning |= stable and not leaves
                leaving |= leaves
            if stable:
                axes.axhline(float(bound), **_BOUND)
            else:
                axes.set_yticks([])
            axes.set_xticks(sides, [_SIDES[int(sign)][2] for sign in ds["sign"].values])
            axes.set_xlim(-0.6, len(push) - 0.4)
            names = regime_names(ds[f"regime_{state}"])
            ends |= {flag: names[flag] for flag in regimes if flag > 0}
        axes.set_ylabel(with_unit(f"push in {SYMBOLS.get(state, state)}", unit))
        axes.set_ylim(-0.03 * axes.get_ylim()[1] if several else 0.0, 1.08 * axes.get_ylim()[1])
    if several:
        for axes in panels[-2:]:
            axes.set_xlabel(label(ds[over]) if over in ds.coords else "machine")
        handles += [Line2D([], [], color=c, marker=m, markersize=4, label=side) for c, m, side in _SIDES.values()]
    handles += [Patch(facecolor=REGIME_COLOURS[flag], edgecolor="0.35", label=ends[flag]) for flag in sorted(ends)]
    if returning:
        hollow = Line2D([], [], color="0.3", marker="o", markerfacecolor="none", linestyle="none")
        handles.append(hollow if several else Patch(**_RETURNS))
        handles[-1].set_label("every push tried returns")
    handles.append(Line2D([], [], label="greatest push tried", **_BOUND))
    legend_at_right(figure, handles)
    none_leaves = "No push up to the greatest tried leaves the working cycle"
    write_margins(figure, ds, none_leaves if returning and not (leaving or several) else "")
    return figure

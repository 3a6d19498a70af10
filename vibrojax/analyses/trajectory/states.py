"""Picture of the trajectory of a system: each state over time, and a phase portrait."""

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from vibrojax.analyses.trajectory.motion import read_states
from vibrojax.errors import InputError
from vibrojax.plot.axes import label
from vibrojax.plot.contents import TIME
from vibrojax.plot.curves import band_text, draw_over_time
from vibrojax.plot.sheet import write_margins
from vibrojax.plot.style import BIT, FAINT, IMPACT, Mark, new_figure, styled

MOST_STATES = 6
"""Greatest number of states that are drawn; more would not be legible on one page."""

_DOTS = Mark(linestyle="none", marker="o", markersize=3.0, color=IMPACT)


def state_names(ds: xr.Dataset) -> list[str]:
    """Return the states of a trajectory, the floating-point variables along the time that are not forces."""
    along = [str(name) for name, data in ds.data_vars.items() if data.dims == (TIME,) and data.dtype.kind == "f"]
    return [name for name in along if not name.endswith("_force")]


@styled
def states_over_time(ds: xr.Dataset) -> Figure:
    """Draw the states over the last ten periods of a motion, and a phase portrait of its first two states.

    The transient is faint in the portrait. Dots are impacts.

    **Raises:** `InputError` if the dataset holds no state.
    """
    names = state_names(ds)[:MOST_STATES]
    if not names:
        raise InputError("no trajectory to draw: the dataset has no state along time")
    motion, end = read_states(ds, names), float(ds[TIME].values[-1])
    start = end - _observed(ds, end)
    late, impacts = motion.since(start), motion.impacts[motion.impacts >= start]
    portrait = len(names) > 1
    rows: list[Any] = [[f"{name}-over-time"] * 2 + (["portrait"] if portrait else []) for name in names]
    figure = new_figure(10.0, max(1.5 * len(names) + 1.0, 3.6))
    panels = figure.subplot_mosaic(rows)
    history = [panels[f"{name}-over-time"] for name in names]
    for name, axes in zip(names, history, strict=True):
        draw_over_time(axes, motion.time[late], motion[name][late], BIT, 0.9)
        axes.set(xlim=(start, end), ylabel=label(ds[name]))
    # Only the first state is continuous in an impact; elsewhere a dot would lie within the jump.
    history[0].plot(impacts, np.interp(impacts, motion.time, motion[names[0]]), **_DOTS)
    for axes in history[:-1]:
        axes.tick_params(labelbottom=False)
    history[-1].set_xlabel("time [s]")
    figure.align_ylabels(history)
    if portrait:
        x, y = names[:2]
        panels["portrait"].plot(motion[x], motion[y], color=FAINT, linewidth=0.5).pop().set_rasterized(True)
        panels["portrait"].plot(motion[x][late], motion[y][late], color=BIT, linewidth=1.0)
        panels["portrait"].set(xlabel=label(ds[x]), ylabel=label(ds[y]))
    notes = ["dots: impacts"] if impacts.size else []
    write_margins(figure, ds, *notes, band_text(*figure.axes))
    return figure


def _observed(ds: xr.Dataset, end: float) -> float:
    """Return the length of the part of the motion that is drawn [s]: ten periods, or a tenth of the motion."""
    period = float(ds["period"]) if "period" in ds and ds["period"].ndim == 0 else np.nan
    return min(10 * period, end) if np.isfinite(period) else end / 10

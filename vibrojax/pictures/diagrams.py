"""Diagrams that engineers ask for by name: Campbell, rate of penetration over the force, designer's chart."""

from collections.abc import Callable
from typing import Literal

import numpy as np
import xarray as xr
from jaxtyping import Float
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from vibrojax.errors import InputError
from vibrojax.pictures.axes import scale, with_unit
from vibrojax.pictures.chart import chart
from vibrojax.pictures.contents import FORM, POINT, RATE, RELIEF, lane_dims, rates_in, without_single
from vibrojax.pictures.curves import MOST_ROWS, Across, axis_of_lines, longest_axis, new_rows, split_lines
from vibrojax.pictures.sheet import facets, legend_at_right, write_margins
from vibrojax.pictures.style import FAINT, INK, Mark, styled
from vibrojax.studies.frequencies import frequencies

_MODES: dict[str, Literal["-", ":"]] = {
    "lower_frequency": "-",
    "upper_frequency": "-",
    "bit_frequency": ":",
    "striker_frequency": ":",
}
_MODE_NAMES: dict[Literal["-", ":"], str] = {
    "-": "natural frequencies\nof both masses",
    ":": "bit alone,\nstriker alone",
}
_MOTIONS = {"return_frequency": "o", "blows_per_second": "x"}
_MOTION_NAMES = {"return_frequency": "returns of the bit", "blows_per_second": "blows"}
_ORDERS = 6  # most multiples of the rotation that are drawn
_CURVE_POINTS = 200
_FORCE = "mean_force"

Lanes = Float[np.ndarray, " lanes"]


@styled
def campbell(ds: xr.Dataset) -> Figure:
    """Draw the Campbell diagram: frequencies of the motion and of the machine over the speed, or the longest axis.

    Dots are the returns of the bit per second and crosses the blows; lines are the natural frequencies. If the sweep
    has a bit radius, the axis is the rotation speed, with its multiples as rays.

    **Raises:** `InputError` if the dataset holds no periods over an axis, or no natural frequencies.
    """
    ds = without_single(_on_a_grid(ds, "campbell"))
    known = frequencies(ds) if "period" in ds else {}
    if "lower_frequency" not in known or "period" not in ds:
        raise InputError("campbell: the dataset holds no natural frequencies and periods; give a sweep of a drill")
    x = longest_axis(ds)
    if not x.is_number:
        raise InputError("campbell: no number varies in the dataset; sweep the speed, as v or rpm")
    known["return_frequency"] = 1 / ds["period"]
    if "blow_frequency" in known:
        known["blows_per_second"] = known["blow_frequency"] / 60
    drawn = {name: data for name, data in known.items() if name in (*_MODES, *_MOTIONS, "rpm")}
    ds = ds.assign({name: data for name, data in drawn.items() if name not in ds.coords}).sortby(x.name)
    turns = "rpm" in ds and x.name in ds["rpm"].dims
    by = axis_of_lines(ds, x.name)
    panels = facets(ds, (POINT, x.name, by), MOST_ROWS)
    figure, rows, _ = new_rows(panels, 1)
    for row in rows:
        axes = row.axes[0]
        for line in split_lines(row.facet, by):
            across = line.lanes["rpm"].values if turns else x.of(line.lanes)
            for name, style in _MODES.items():
                axes.plot(across, np.broadcast_to(line.lanes[name].values, across.shape), color=FAINT, linestyle=style)
            for name, marker in _MOTIONS.items():
                if name in line.lanes:
                    look = _marks(marker) | Mark(color=line.colour)
                    axes.plot(across, line.lanes[name].values, **look)
        row.label(0, "rotation [1/min]" if turns else x.label, "frequency [Hz]")
        axes.set_ylim(bottom=0.0)
        if turns:
            (low, high), top = axes.get_xlim(), axes.get_ylim()[1]
            for order in range(1, _ORDERS + 1):
                axes.axline((0.0, 0.0), slope=order / 60, color=FAINT, linewidth=0.6, zorder=1)
                end = 0.98 * min(high, 60 * top / order)
                if end > low:
                    axes.text(end, order * end / 60, f"{order}n", ha="right", va="top", color="0.3", fontsize="small")
            axes.set_xlim(low, high)
        else:
            x.shape(axes)
    handles: list[Artist] = [Line2D([], [], color=FAINT, linestyle=s, label=name) for s, name in _MODE_NAMES.items()]
    for name, marker in _MOTIONS.items():
        if name in ds:
            handles.append(Line2D([], [], color=INK, label=_MOTION_NAMES[name], **_marks(marker)))
    lines = [Line2D([], [], color=line.colour, label=line.name, **_marks("o")) for line in split_lines(ds, by) if by]
    legend_at_right(figure, handles, lines)
    write_margins(figure, ds, panels.note, "Rays: multiples of the rotation n" if turns else "")
    return figure


@styled
def rate_over_force(ds: xr.Dataset) -> Figure:
    """Draw the rate of penetration over the mean force P, with the onset: the force at which penetration begins.

    The onset lies between a lane without penetration, drawn hollow, and the next one with it. Lines are the fitted law
    C ln(P/P0).

    **Raises:** `InputError` if the dataset holds no rates over an axis.
    """
    ds = rates_in(_on_a_grid(ds, "rate-over-force"))
    if not {_FORCE, RELIEF} <= set(ds.data_vars):
        raise InputError(f"rate-over-force: the dataset holds no {_FORCE}; give a sweep of a scene with rock")
    x = _force_axis(ds)
    # Only this diagram needs the fits, which import SciPy's optimizers.
    from vibrojax.studies.rop_forms import FORMS
    from vibrojax.studies.rop_law import fit_rop

    fit = fit_rop(ds, along=x.name, progress=False).sel({FORM: "onset"})
    law = next(form.rate for form in FORMS if form.name == "onset")
    by = axis_of_lines(ds, x.name)
    panels = facets(ds, (POINT, x.name, by), MOST_ROWS)
    figure, rows, _ = new_rows(panels, 1)
    (factor, unit), (of_force, force_unit) = scale(ds[RATE]), scale(ds[_FORCE])
    onsets: list[Artist] = []
    for row in rows:
        axes = row.axes[0]
        for line in split_lines(row.facet, by):
            force, rate = (np.atleast_1d(line.lanes[name].values) for name in (_FORCE, RATE))
            group = fit.sel({name: line.lanes[name].item() for name in fit["C"].dims})
            with np.errstate(all="ignore"):
                threshold = np.nanmedian(force / np.atleast_1d(line.lanes[RELIEF].values))
            onset, (below, above) = float(group["eta0"]) * threshold, _onset(force, rate)
            text = f"onset at {of_force * below:.4g} to {of_force * above:.4g} {force_unit}"
            if not np.isfinite(below):
                text = f"onset below {of_force * above:.4g} {force_unit}"
            if not np.isfinite(above):
                text = "no onset"
            if np.isfinite(below) and np.isfinite(above):
                axes.axvspan(of_force * below, of_force * above, color=line.colour, alpha=0.15, linewidth=0)
            look = Mark(linestyle="none", marker="o", markersize=4.0, color=line.colour)
            for mask, face in ((rate > 0, line.colour), (rate == 0, "white")):
                axes.plot(of_force * force[mask], factor * rate[mask], **look | Mark(markerfacecolor=face))
            if 0 < onset < float(np.nanmax(force)):
                along = np.geomspace(onset, float(np.nanmax(force)), _CURVE_POINTS)
                values = law(along / threshold, float(group["C"]), float(group["eta0"]), np.nan)
                axes.plot(of_force * along, factor * values, color=line.colour, linewidth=1.2)
            label = "\n".join(part for part in (line.name, text) if part)
            onsets.append(Line2D([], [], label=label, **look | Mark(linestyle="-")))
        row.label(0, with_unit("mean force P", force_unit), with_unit("rate of penetration", unit))
        axes.set_ylim(bottom=-0.03 * factor * max(float(ds[RATE].max()), np.finfo(float).tiny))
        axes.set_xlim(left=0.0)
    hollow = Line2D([], [], color=INK, linestyle="none", marker="o", markerfacecolor="white", label="no penetration")
    legend_at_right(figure, onsets, [hollow] if bool((ds[RATE] == 0).any()) else [])
    write_margins(figure, ds, panels.note, "Shaded: the onset. Lines: the fitted law C ln(P/P0)")
    return figure


DIAGRAMS: dict[str, Callable[[xr.Dataset], Figure]] = {
    "campbell": campbell,
    "chart": chart,
    "rate-over-force": rate_over_force,
}
"""Diagrams by the name under which `picture` draws them."""


def _on_a_grid(ds: xr.Dataset, diagram: str) -> xr.Dataset:
    if not lane_dims(ds) or POINT in lane_dims(ds):
        raise InputError(f"{diagram}: the dataset holds no lanes over a grid; give the dataset of a sweep with one")
    return ds


def _force_axis(ds: xr.Dataset) -> Across:
    """Return the axis `force` if it is swept, else the longest one."""
    x = longest_axis(ds.isel({name: 0 for name in lane_dims(ds) if name != "force"}) if "force" in ds.dims else ds)
    if not x.is_number:
        raise InputError("rate-over-force: no number varies in the dataset; sweep the force, or what changes it")
    return x


def _marks(marker: str) -> Mark:
    return Mark(linestyle="none", marker=marker, markersize=5.0, markerfacecolor="none", markeredgewidth=1.2)


def _onset(force: Lanes, rate: Lanes) -> tuple[float, float]:
    """Return the greatest force without penetration below the least force with it, and the latter; NaN if unknown."""
    above = float(np.min(force[rate > 0], initial=np.inf))
    below = float(np.max(force[(rate == 0) & (force < above)], initial=-np.inf))
    return (below if np.isfinite(below) else np.nan), (above if np.isfinite(above) else np.nan)

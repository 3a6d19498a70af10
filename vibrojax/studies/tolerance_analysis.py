"""The analysis `tolerance`: summary and picture of a machine over the box of its parameter tolerances."""

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from vibrojax.errors import counted
from vibrojax.io.attributes import flags
from vibrojax.pictures.axes import label, pretty_unit, scale, values_along
from vibrojax.pictures.colours import REGIME_COLOURS, regime_cells, regime_handles
from vibrojax.pictures.sheet import legend_at_right, write_margins
from vibrojax.pictures.style import new_figure, styled
from vibrojax.studies.analysis import Analysis, PictureRule, SummaryPart
from vibrojax.studies.tolerance_run import QUANTITIES, REFINED, SAMPLE_VARIABLES

_TOLERANCE = "tolerance_"
_MARKERS = "os^Dv"
_DRAWN = ("impact_velocity", "impact_energy", "rate_of_penetration")


def toleranced(ds: xr.Dataset) -> list[str]:
    """Return the names of the parameters that have a tolerance."""
    names = [name.removeprefix(_TOLERANCE) for name in ds.attrs if name.startswith(_TOLERANCE)]
    return [name for name in names if name in ds.coords]


@styled
def extremes_picture(ds: xr.Dataset) -> Figure:
    """Draw impact velocity, energy and rate of penetration of all samples over each parameter with a tolerance."""
    names = toleranced(ds)
    rows = [name for name in _DRAWN if name in ds and ds[name].notnull().any()] or ["period"]
    lanes = ds if "start" in ds.dims else ds.expand_dims("start")
    starts = [str(name) for name in np.atleast_1d(lanes["start"].values)] if "start" in lanes.coords else [""]
    figure = new_figure(1.8 + 2.6 * len(names), 0.9 + 2.2 * len(rows))
    grid = figure.subplots(len(rows), len(names), sharex="col", sharey="row", squeeze=False)
    for row, quantity in enumerate(rows):
        for column, name in enumerate(names):
            axes = grid[row, column]
            for k in range(len(starts)):
                lane = lanes.isel(start=k)
                colours = [REGIME_COLOURS[int(flag)] for flag in regime_cells(lane["regime"])]
                y = lane[quantity].values * scale(lanes[quantity])[0]
                look = {"marker": _MARKERS[k % len(_MARKERS)], "edgecolors": "0.3", "linewidths": 0.4}
                # Later starts are smaller: of samples that several starts bring to one motion, all markers show.
                axes.scatter(values_along(ds[name]), y, s=max(36.0 / 3.0**k, 4.0), c=colours, **look)
                axes.axhline(y[0], color="0.6", linewidth=0.7, linestyle="--", zorder=0)
            axes.margins(0.08)
            axes.xaxis.set_major_locator(MaxNLocator(4))
            axes.grid(True)
            if row == len(rows) - 1:
                axes.set_xlabel(label(ds[name]))
        grid[row, 0].set_ylabel(label(lanes[quantity]))
    handles: list[Artist] = regime_handles([lanes["regime"]])
    for marker, start in zip(_MARKERS, starts, strict=False):
        if start:
            handles.append(
                Line2D([], [], color="0.3", marker=marker, linestyle="none", markersize=4, label=f"start: {start}")
            )
    handles.append(Line2D([], [], color="0.6", linewidth=0.7, linestyle="--", label="nominal"))
    legend_at_right(figure, handles)
    missing = int(lanes[rows[0]].isnull().sum())
    write_margins(
        figure,
        ds,
        counted(missing, "lane without impact is", "lanes without impact are") + " not drawn"
        if missing and rows[0] != "period"
        else "",
    )
    return figure


class Tolerances(Analysis):
    """Simulate a machine at samples of the box of its parameter tolerances: regimes, extremes, and where they occur."""

    kind = "tolerance"
    variables = SAMPLE_VARIABLES
    pictures = (PictureRule("extremes of the samples of a tolerance box", lambda held: True, extremes_picture),)
    view = "plots"

    def summary(self, ds: xr.Dataset) -> list[SummaryPart]:
        """Return the nominal behaviour, the regimes and the extremes, for each start."""
        lanes = ds if "start" in ds.dims else ds.expand_dims("start")
        facts, lines = {}, _irregular_lines(lanes)
        for k in range(lanes.sizes["start"]):
            lane = lanes.isel(start=k)
            start = str(lane["start"].values) if "start" in lane.coords else ""
            facts[start], text = _start_summary(ds, lane)
            lines += [f"from {start}:"] * bool(start) + [f"  {line}" if start else line for line in text]
        lines += [str(ds.attrs["extremes"])] * ("extremes" in ds.attrs)
        return [SummaryPart("tolerance", lines, {"tolerance": facts})]


def _irregular_lines(lanes: xr.Dataset) -> list[str]:
    """Return a line if motions are irregular, so that the extremes say little about the box."""
    shares = lanes["irregular_share"].values if "irregular_share" in lanes else np.zeros(1)
    if not (shares > 0).any():
        return []
    starts = [f" from {start}" for start in lanes["start"].values] if "start" in lanes.coords else [""]
    where = ", ".join(f"{100 * x:.2g} % of the samples{start}" for x, start in zip(shares, starts, strict=True))
    return [
        f"irregular motions in the box ({where}): extremes depend on the time of observation, and other points of the "
        "box may be far beyond them"
    ]


def _start_summary(ds: xr.Dataset, lane: xr.Dataset) -> tuple[dict[str, object], list[str]]:
    """Return the behaviour from one start, as facts and as lines of text."""
    meanings, drawn = flags(ds["regime"]), lane["place"].values != REFINED
    samples, regimes = int(drawn.sum()), lane["regime"].values[drawn]
    nominal = meanings[int(regimes[0])]
    counts = {meanings[flag]: int((regimes == flag).sum()) for flag in np.unique(regimes).tolist()}
    others = [f"{name} at {count}" for name, count in counts.items() if name != nominal]
    line = f"{nominal} at {counts[nominal]} of {counted(samples, 'sample')}"
    if others:
        first = int(np.flatnonzero(regimes != regimes[0])[0])
        line += f"; {', '.join(others)}, such as {_place_text(ds, first)}"
    facts: dict[str, object] = {"nominal": nominal, "samples": samples, "regimes": counts}
    lines = [line]
    for name in (name for name in QUANTITIES if f"{name}_least" in lane):
        ends = {word: float(lane[f"{name}_{word}"]) for word in ("least", "most")}
        if not np.isfinite(ends["least"]):
            continue
        where = {word: int(lane[f"{name}_{word}_sample"]) for word in ends}
        factor, unit = scale(ds[f"{name}_most"])
        known = int(lane[name].notnull().values[drawn].sum())
        low, high = (f"{ends[word] * factor:.4g}" for word in ends)
        worst = "most" if name == "peak_impact_force" else "least"
        text = (
            f"{name.replace('_', ' ')} {low} to {high} {pretty_unit(unit)}, nominal {float(lane[name][0]) * factor:.4g}"
        )
        text += f"; {worst} at {_place_text(ds, where[worst])}"
        lines.append(
            text + (f" ({counted(samples - known, 'sample has', 'samples have')} none)" if known < samples else "")
        )
        facts[name] = {**ends, **{f"{word}_at": _place(ds, index) for word, index in where.items()}, "samples": known}
    return facts, lines


def _place(ds: xr.Dataset, sample: int) -> dict[str, float]:
    return {name: float(ds[name][sample]) for name in toleranced(ds)}


def _place_text(ds: xr.Dataset, sample: int) -> str:
    return ", ".join(f"{name} = {value:.6g}" for name, value in _place(ds, sample).items())

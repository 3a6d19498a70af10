"""Work-precision diagram: all settings of all methods, with the Pareto front, in one panel per scene."""

from textwrap import fill
from typing import NamedTuple

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from matplotlib.typing import MarkerType

from vibrojax.errors import counted, printable
from vibrojax.io.attributes import table_of, title_of
from vibrojax.pictures.contents import SETTING
from vibrojax.pictures.style import FAINT, INK, Mark, new_figure, styled
from vibrojax.studies.analysis import Analysis, PictureRule

_FRONT = "#F2C94C"
_FLOOR = "#E8E8E8"
_MOST_COLUMNS = 3
_MICRO = 1e6
_SINGLE_PRECISION = (0.0, (3.0, 1.5))  # dashes
_BAND = Mark(color=_FRONT, linewidth=4.5, alpha=0.65)


class _Look(NamedTuple):
    """The name of a method in the legend, its marker and its colour."""

    name: str
    marker: MarkerType
    colour: str


# By method and varied setting; the markers are distinct in greyscale.
_LOOKS = {
    ("located", "tolerance"): _Look("located, over tolerance", "o", "#004488"),
    ("located", "stride"): _Look("located, over fixed stride", "D", "#3F8FA3"),
    ("smoothed", "width"): _Look("smoothed, over width", "s", "#D1570A"),
    ("smoothed", "step"): _Look("smoothed, over step", "p", "#9C6B1E"),
    ("smoothed", "stride"): _Look("Runge–Kutta, over stride", "h", "#D9A441"),
    ("diffrax Tsit5", "width"): _Look("diffrax Tsit5, adaptive", "^", "#7A5195"),
    ("diffrax Dopri8", "width"): _Look("diffrax Dopri8, adaptive", "v", "#C2185B"),
    ("diffrax Kvaerno5", "width"): _Look("diffrax Kvaerno5, adaptive", "<", "#4D4D4D"),
    ("diffrax Tsit5, fixed steps", "width"): _Look("diffrax Tsit5, fixed steps", ">", "#2E8B57"),
}


@styled
def work_precision(ds: xr.Dataset) -> Figure:
    """Draw the worst error over the time per lane-second, both logarithmic, in one panel per scene.

    A whisker goes down from each setting's marker to the median lane's error. The Pareto front is in the background.
    Errors in the grey area are smaller than the error of the reference. Hollow markers are float32; crosses are
    settings with failed lanes.
    """
    scenes = list(dict.fromkeys(ds["scene"].values.tolist()))
    wide = min(_MOST_COLUMNS, len(scenes) + 1)
    deep = -(-(len(scenes) + 1) // wide)
    figure = new_figure(3.1 * wide, 3.0 * deep + 0.35)
    panels = figure.subplots(deep, wide, squeeze=False, sharex=True, sharey=True).ravel()
    for axes, scene in zip(panels, scenes, strict=False):
        _panel(axes, ds.isel({SETTING: ds["scene"].values == scene}), scene)
    for axes in panels[len(scenes) :]:
        axes.axis("off")
    _shape_axes(panels[0], ds)
    for index, axes in enumerate(panels[: len(scenes)]):
        if index % wide == 0:
            axes.set_ylabel("worst lane's relative error")
        if index + wide >= len(scenes):
            axes.set_xlabel("time per simulated lane-second [µs]")
            axes.tick_params(labelbottom=True)
    panels[len(scenes)].legend(
        handles=_handles(ds), loc="upper left", bbox_to_anchor=(-0.08, 1.04), fontsize=8, handlelength=2.2
    )
    machine, computer = table_of(ds, "machine"), "machine unknown"
    if {"processor", "cores", "jax"} <= set(machine):
        text = f"{machine['processor']}, {machine['cores']} cores, jax {machine['jax']}"
        computer = fill(printable(text, 180), 90)
    figure.suptitle(f"{title_of(ds, 'Speed against error')} · {computer}", fontsize=10)
    return figure


def _panel(axes: Axes, ds: xr.Dataset, scene: str) -> None:
    axes.set_title(scene, loc="left", fontweight="bold")
    axes.set_title(counted(int(ds["lanes"].values[0]), "periodic lane"), loc="right", fontsize=8, color=FAINT)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.grid(which="major")
    time, worst = _MICRO * ds["time_per_lane_second"].values, ds["error_worst"].values
    on_front = np.flatnonzero(ds["on_front"].values == 1)
    if on_front.size:  # the Pareto front as a staircase; settings above and to the right of it are worse
        front = on_front[np.argsort(time[on_front])]
        x, y = np.concatenate([time[front[:1]], time[front], [1e9]]), np.concatenate([[1e9], worst[front]])
        axes.step(x, np.append(y, y[-1]), where="post", solid_joinstyle="round", zorder=1, **_BAND)
    axes.axhspan(1e-30, max(float(ds["reference_spread"].values[0]), 1e-16), color=_FLOOR, linewidth=0, zorder=0)
    keys = list(zip(*(ds[name].values.tolist() for name in ("method", "varied", "precision")), strict=True))
    for key in dict.fromkeys(keys):
        here = ds.isel({SETTING: [index for index, other in enumerate(keys) if other == key]})
        _draw_series(axes, here.sortby("value"), _look(*key[:2]), key[2] == "float32")
    absent = [str(name).split()[0] for name in ds["method"].values[~np.isfinite(time)]]
    if absent:
        text = f"{', '.join(dict.fromkeys(absent))}: cannot run this scene"
        axes.text(0.97, 0.97, text, transform=axes.transAxes, ha="right", va="top", fontsize=7.5, color="#666666")


def _look(method: str, varied: str) -> _Look:
    return _LOOKS.get((method, varied), _Look(f"{method}, over {varied}", "h", INK))


def _draw_series(axes: Axes, ds: xr.Dataset, look: _Look, single: bool) -> None:
    time, worst = _MICRO * ds["time_per_lane_second"].values, ds["error_worst"].values
    median, good = ds["error_median"].values, ds["status"].values == 0
    line = _SINGLE_PRECISION if single else "-"
    axes.plot(time, worst, color=look.colour, linewidth=0.9, linestyle=line, zorder=2)
    axes.vlines(time, median, worst, color=look.colour, linewidth=0.6, alpha=0.55, zorder=2)
    fastest, slowest = (_MICRO * ds[f"time_per_lane_second_{end}"].values for end in ("min", "max"))
    axes.hlines(worst, fastest, slowest, color=look.colour, linewidth=1.6, alpha=0.45, zorder=2)
    fill_colour = "white" if single else look.colour
    marks = Mark(linestyle="none", markeredgecolor=look.colour, markeredgewidth=0.9, zorder=3)
    axes.plot(time[good], worst[good], marker=look.marker, markersize=4.4, markerfacecolor=fill_colour, **marks)
    axes.plot(time[~good], worst[~good], marker="x", markersize=5.0, **marks)


def _shape_axes(axes: Axes, ds: xr.Dataset) -> None:
    """Set limits and ticks of `axes`, with which all panels share their axes."""
    time, worst = _MICRO * ds["time_per_lane_second"].values, ds["error_worst"].values
    for values, margin, set_limits in ((time, 1.6, axes.set_xlim), (worst, 5.0, axes.set_ylim)):
        known = values[np.isfinite(worst) & (values > 0)]
        set_limits(*((known.min() / margin, known.max() * margin) if known.size else (0.1, 10.0)))
    axes.yaxis.set_major_locator(LogLocator(100.0, numticks=12))
    axes.yaxis.set_minor_locator(LogLocator(10.0, numticks=24))
    fastest, slowest = axes.get_xlim()
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if slowest < 150 * fastest else (1.0,), numticks=12))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_minor_formatter(NullFormatter())


def _handles(ds: xr.Dataset) -> list[Artist]:
    keys = dict.fromkeys(zip(ds["method"].values.tolist(), ds["varied"].values.tolist(), strict=True))
    looks = dict.fromkeys(_look(*key) for key in sorted(keys, key=lambda key: [*_LOOKS, key].index(key)))
    handles: list[Artist] = [
        Line2D([], [], color=look.colour, marker=look.marker, markersize=4.4, linewidth=0.9, label=look.name)
        for look in looks
    ]
    if "float32" in ds["precision"].values:
        hollow = Mark(color=INK, marker="o", markersize=4.4, linewidth=0.9, markerfacecolor="white")
        handles.append(Line2D([], [], label="float32", **hollow | Mark(linestyle=_SINGLE_PRECISION)))
    if ((ds["status"].values != 0) & np.isfinite(ds["error_worst"].values)).any():
        handles.append(Line2D([], [], color=INK, marker="x", linestyle="none", label="some lanes failed"))
    whisker = Mark(color=INK, marker="|", markersize=9, linestyle="none")
    return [
        *handles,
        Line2D([], [], label="down to the median lane", **whisker),
        Line2D([], [], color=INK, linewidth=1.6, alpha=0.45, label="range of the repeats"),
        Line2D([], [], label="Pareto front", **_BAND),
        Patch(color=_FLOOR, label="below what the reference can tell"),
    ]


class AccuracyStudy(Analysis):
    """Study of speed against error on this machine: a dataset, a table and a picture."""

    kind = "accuracy"
    view = "plots"
    pictures = (PictureRule("accuracy", lambda held: True, work_precision),)

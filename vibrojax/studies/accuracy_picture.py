"""Work-precision diagram: all settings of all methods, with the Pareto front, in one panel per scene."""

from textwrap import fill

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from vibrojax.errors import counted, printable
from vibrojax.io.attributes import table_of, title_of
from vibrojax.pictures.contents import SETTING
from vibrojax.pictures.style import FAINT, INK, Mark, new_figure, styled
from vibrojax.studies.analysis import Analysis, PictureRule

_MOST_COLUMNS = 3
_FLOOR = "#E8E8E8"
_BAND = Mark(color="#F2C94C", linewidth=4.5, alpha=0.65)
_RANGE = Mark(linewidth=1.6, alpha=0.45)

# Name in the legend, marker and colour, by method and varied setting; the markers are distinct in greyscale.
_LOOKS = {
    ("located", "tolerance"): ("located, over tolerance", "o", "#004488"),
    ("located", "stride"): ("located, over fixed stride", "D", "#3F8FA3"),
    ("smoothed", "width"): ("smoothed, over width", "s", "#D1570A"),
    ("smoothed", "step"): ("smoothed, over step", "p", "#9C6B1E"),
    ("smoothed", "stride"): ("Runge–Kutta, over stride", "h", "#D9A441"),
    ("diffrax Tsit5", "width"): ("diffrax Tsit5, adaptive", "^", "#7A5195"),
    ("diffrax Dopri8", "width"): ("diffrax Dopri8, adaptive", "v", "#C2185B"),
    ("diffrax Kvaerno5", "width"): ("diffrax Kvaerno5, adaptive", "<", "#4D4D4D"),
    ("diffrax Tsit5, fixed steps", "width"): ("diffrax Tsit5, fixed steps", ">", "#2E8B57"),
}


@styled
def work_precision(ds: xr.Dataset) -> Figure:
    """Draw the worst error over the time per lane-second, both logarithmic, in one panel per scene.

    A whisker goes down from each setting's marker to the median lane's error. The Pareto front is in the background.
    Errors in the grey area are smaller than the error of the reference. Hollow markers are float32; crosses mark
    settings with failed lanes.
    """
    ds = ds.assign({name: 1e6 * ds[name] for name in ds.data_vars if str(name).startswith("time_per_lane_second")})
    scenes = list(dict.fromkeys(ds["scene"].values.tolist()))
    wide = min(_MOST_COLUMNS, len(scenes) + 1)
    deep = -(-(len(scenes) + 1) // wide)
    figure = new_figure(3.1 * wide, 3.0 * deep + 0.35)
    panels = figure.subplots(deep, wide, squeeze=False, sharex=True, sharey=True).ravel()
    panels[0].set(xscale="log", yscale="log")
    for index, (axes, scene) in enumerate(zip(panels, scenes, strict=False)):
        _draw_panel(axes, ds.isel({SETTING: ds["scene"].values == scene}), scene)
        if index % wide == 0:
            axes.set_ylabel("worst lane's relative error")
        if index + wide >= len(scenes):
            axes.set_xlabel("time per simulated lane-second [µs]")
            axes.tick_params(labelbottom=True)
    for axes in panels[len(scenes) :]:
        axes.axis("off")
    known = ds.isel({SETTING: ds["error_worst"].values > 0})
    if known.sizes[SETTING]:
        time, worst = known["time_per_lane_second"], known["error_worst"]
        panels[0].set(xlim=(time.min() / 1.6, time.max() * 1.6), ylim=(worst.min() / 5, worst.max() * 5))
    named = (zip(*axes.get_legend_handles_labels(), strict=True) for axes in panels)
    handles = {label: handle for pairs in named for handle, label in pairs} | {
        "down to the median lane": Line2D([], [], color=INK, marker="|", markersize=9, linestyle="none"),
        "range of the repeats": Line2D([], [], color=INK, **_RANGE),
        "Pareto front": Line2D([], [], **_BAND),
        "below what the reference can tell": Patch(color=_FLOOR),
    }
    panels[len(scenes)].legend(handles.values(), handles.keys(), loc="upper left", fontsize=8)
    machine = {"processor": "machine unknown", "cores": "?", "jax": "?"} | table_of(ds, "machine")
    computer = fill(printable("{processor}, {cores} cores, jax {jax}".format(**machine), 180), 90)
    figure.suptitle(f"{title_of(ds, 'Speed against error')} · {computer}", fontsize=10)
    return figure


def _draw_panel(axes: Axes, ds: xr.Dataset, scene: str) -> None:
    axes.set_title(scene, loc="left", fontweight="bold")
    axes.set_title(counted(int(ds["lanes"].values[0]), "periodic lane"), loc="right", fontsize=8, color=FAINT)
    axes.grid(which="major")
    front = ds.isel({SETTING: ds["on_front"].values == 1}).sortby("time_per_lane_second")
    if front.sizes[SETTING]:  # a staircase; settings above and to the right of it are worse
        x, y = front["time_per_lane_second"].values, front["error_worst"].values
        steps = [x[0], *x, 1e9], [1e9, *y, y[-1]]
        axes.step(*steps, where="post", solid_joinstyle="round", zorder=1, **_BAND)
    axes.axhspan(1e-30, max(float(ds["reference_spread"].values[0]), 1e-16), color=_FLOOR, linewidth=0, zorder=0)
    absent = np.isnan(ds["time_per_lane_second"].values)
    if absent.any():
        text = f"{ds['method'].values[absent][0].split()[0]}: cannot run this scene"
        axes.text(0.97, 0.97, text, transform=axes.transAxes, ha="right", va="top", fontsize=7.5, color="#666666")
        ds = ds.isel({SETTING: ~absent})
    keys = list(zip(*(ds[name].values.tolist() for name in ("method", "varied", "precision")), strict=True))
    for key in dict.fromkeys(keys):
        here = ds.isel({SETTING: [index for index, other in enumerate(keys) if other == key]}).sortby("value")
        time, worst, failed = here["time_per_lane_second"], here["error_worst"], here["status"].values != 0
        name, marker, colour = _LOOKS.get(key[:2], (f"{key[0]}, over {key[1]}", "h", INK))
        look = Mark(color=colour, marker=marker, markersize=4.4, linewidth=0.9, label=name)
        if key[2] == "float32":
            look |= Mark(label=f"{name}, float32", linestyle=(0.0, (3.0, 1.5)), markerfacecolor="white")
        axes.plot(time, worst, zorder=3, **look)
        axes.vlines(time, here["error_median"], worst, color=colour, linewidth=0.6, alpha=0.55, zorder=2)
        fastest, slowest = here["time_per_lane_second_min"], here["time_per_lane_second_max"]
        axes.hlines(worst, fastest, slowest, color=colour, zorder=2, **_RANGE)
        if failed.any():
            axes.plot(time[failed], worst[failed], "x", color=INK, markersize=6, zorder=4, label="some lanes failed")


class AccuracyStudy(Analysis):
    """Study of speed against error on this machine: a dataset, a table and a picture."""

    kind = "accuracy"
    view = "plots"
    pictures = (PictureRule("accuracy", lambda held: True, work_precision),)

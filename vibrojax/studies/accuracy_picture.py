"""Work-precision diagram: all settings of all methods, with the Pareto front, in one panel per scene."""

import numpy as np
import xarray as xr

from vibrojax.errors import counted, printable
from vibrojax.io.attributes import table_of, title_of
from vibrojax.pictures.contents import SETTING
from vibrojax.pictures.plots import (
    INK,
    Area,
    Axis,
    Layer,
    Line,
    Look,
    Picture,
    Plot,
    Sheet,
    Text,
    bars,
    dots,
    key,
    patch,
)
from vibrojax.studies.analysis import Analysis, PictureRule

_MOST_COLUMNS = 3
_FLOOR = "#E8E8E8"
_BAND: Look = {"colour": "#F2C94C", "width": 4.5, "alpha": 0.65}
_RANGE: Look = {"width": 1.6, "alpha": 0.45}
_EDGES = 1e-30, 1e9  # far outside the panels

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


def work_precision(ds: xr.Dataset) -> Picture:
    """Draw the worst error over the time per lane-second, both logarithmic, in one panel per scene.

    A whisker goes down from each setting's marker to the median lane's error. The Pareto front is in the background.
    Errors in the grey area are smaller than the error of the reference. Hollow markers are float32; crosses mark
    settings with failed lanes.
    """
    ds = ds.assign({name: 1e6 * ds[name] for name in ds.data_vars if str(name).startswith("time_per_lane_second")})
    scenes = list(dict.fromkeys(ds["scene"].values.tolist()))
    wide = min(_MOST_COLUMNS, len(scenes) + 1)
    deep = -(-(len(scenes) + 1) // wide)
    known = ds.isel({SETTING: ds["error_worst"].values > 0})
    times, errors = (0.1, 1.0), (0.1, 1.0)
    if known.sizes[SETTING]:
        time, worst = known["time_per_lane_second"], known["error_worst"]
        times = float(time.min()) / 1.6, float(time.max()) * 1.6
        errors = float(worst.min()) / 5, float(worst.max()) * 5
    across = Axis("time per simulated lane-second [µs]", limits=times, log=True, group="time")
    up = Axis("worst lane's relative error", limits=errors, log=True, group="error")
    plots = []
    for index, scene in enumerate(scenes):
        rows = ds.isel({SETTING: ds["scene"].values == scene})
        count = counted(int(rows["lanes"].values[0]), "periodic lane")
        plots.append(Plot(_layers(rows), across, up, scene, divmod(index, wide), remark=count))
    keys: list[Layer] = [
        dots(label="down to the median lane", marker="|", size=9.0),
        key("range of the repeats", **_RANGE),
        key("Pareto front", **_BAND),
        patch(_FLOOR, "below what the reference can tell", edge=""),
    ]
    machine = {"processor": "machine unknown", "cores": "?", "jax": "?"} | table_of(ds, "machine")
    computer = printable("{processor}, {cores} cores, jax {jax}".format(**machine), 180)
    title, place = title_of(ds, "Speed against error"), divmod(len(scenes), wide)
    size = 3.1 * wide, 3.0 * deep + 0.35
    return Sheet(plots, size, (1.0,) * wide, (1.0,) * deep, [keys], place, title=title, note=computer)


def _layers(ds: xr.Dataset) -> list[Layer]:
    layers: list[Layer] = []
    front = ds.isel({SETTING: ds["on_front"].values == 1}).sortby("time_per_lane_second")
    if front.sizes[SETTING]:  # a staircase; settings above and to the right of it are worse
        x, y = front["time_per_lane_second"].values, front["error_worst"].values
        places, heights = [x[0], *x, _EDGES[1]], [_EDGES[1], *y, y[-1]]
        layers.append(Line(np.repeat(places, 2)[1:], np.repeat(heights, 2)[:-1], order=1.0, **_BAND))
    spread = max(float(ds["reference_spread"].values[0]), 1e-16)
    layers.append(Area([-np.inf, np.inf], [_EDGES[0]] * 2, [spread] * 2, _FLOOR, order=0.0))
    absent = np.isnan(ds["time_per_lane_second"].values)
    if absent.any():
        text = f"{ds['method'].values[absent][0].split()[0]}: cannot run this scene"
        layers.append(Text(0.97, 0.97, text, "right", "top", size=7.5, relative=True))
        ds = ds.isel({SETTING: ~absent})
    columns = list(zip(*(ds[name].values.tolist() for name in ("method", "varied", "precision")), strict=True))
    for column in dict.fromkeys(columns):
        here = ds.isel({SETTING: [index for index, other in enumerate(columns) if other == column]}).sortby("value")
        time, worst, failed = (here[name].values for name in ("time_per_lane_second", "error_worst", "status"))
        name, marker, colour = _LOOKS.get(column[:2], (f"{column[0]}, over {column[1]}", "h", INK))
        look: Look = {"marker": marker, "size": 4.4, "width": 0.9, "order": 3.0, "label": name}
        if column[2] == "float32":
            look |= {"label": f"{name}, float32", "dash": (0.0, (3.0, 1.5)), "face": "white"}
        fastest, slowest = (here[f"time_per_lane_second_{end}"].values for end in ("min", "max"))
        layers += [
            Line(time, worst, colour, **look),
            Line(*bars(time, here["error_median"].values, worst), colour, 0.6, alpha=0.55),
            Line(*bars(worst, fastest, slowest)[::-1], colour, **_RANGE),
        ]
        if (failed != 0).any():
            crosses = time[failed != 0], worst[failed != 0]
            layers.append(dots(*crosses, marker="x", size=6.0, order=4.0, label="some lanes failed"))
    return layers


class AccuracyStudy(Analysis):
    """Study of speed against error on this machine: a dataset, a table and a picture."""

    kind = "accuracy"
    view = "plots"
    pictures = (PictureRule("accuracy", lambda held: True, work_precision),)

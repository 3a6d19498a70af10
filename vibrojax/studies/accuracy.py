"""The analysis `accuracy`: times and errors of all settings, their table in Markdown, and a work-precision diagram."""

import json
import platform
import re
import time
from collections.abc import Sequence
from functools import reduce
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float, Int
from numpy.typing import ArrayLike

from vibrojax.compile.xla import usable_cores, workers
from vibrojax.errors import Place, counted, printable
from vibrojax.io.attributes import table_of, title_of
from vibrojax.io.variables import Variable
from vibrojax.pictures.contents import SETTING
from vibrojax.pictures.plots import FAINT, INK, Area, Axis, Key, Layer, Line, Look, Plot, Sheet, bars, dots, key
from vibrojax.progress import Progress
from vibrojax.scenes import HasRock
from vibrojax.settings.values import check_distinct, choice
from vibrojax.stepping import Accuracy
from vibrojax.studies import accuracy_programs as programs
from vibrojax.studies.accuracy_programs import DiffraxProgram, Features, Program, Setting, settings_of
from vibrojax.studies.analysis import Analysis, PictureRule

QUICK_SCENES = ("vibro-impact", "penetration")
REPEATS, QUICK_REPEATS, LONG_REPEATS = 5, 2, 0.6  # numbers of runs, and time [s] from which two suffice
OTHER_MOTION_ERROR = 0.5  # relative error from which a lane counts as another motion than the reference
TRUSTED_WITHIN = 1e-4  # relative difference of the two references up to which a lane is used for comparisons
FINE, SECOND = programs.REFERENCE, programs.SECOND_REFERENCE
REFERENCE_TEXT = (
    f"the located method, float64, at a tolerance of {FINE.tolerance:g} and a stride of {FINE.stride:g}; "
    f"reference_spread is its difference from another one (tolerance {SECOND.tolerance:g}, stride {SECOND.stride:g})"
)
STATUSES = {
    "done": "",
    "not-finite": "did not stay finite",
    "out-of-steps": "did not reach the end within the steps allowed",
    "other-regime": "moved in another way than the reference",
    "unsupported": "plain integration knows no rock that yields: its ratchet needs events",
}
_ERROR = "relative error of the larger of period and impact velocity; in penetration of the rate of penetration"
_VARIABLES = {
    **{name: Variable("1", name, np.str_) for name in ("scene", "method", "precision")},
    "varied": Variable("1", "varied quantity", np.str_),
    "value": Variable("1", "value of the varied quantity: tolerance and stride [1], width [m s-1], step [s]"),
    "time_per_lane_second": Variable("s", "median time per lane-second"),
    "time_per_lane_second_min": Variable("s", "shortest time per lane-second"),
    "time_per_lane_second_max": Variable("s", "longest time per lane-second"),
    "compile_time": Variable("s", "compile time"),
    "error_worst": Variable("1", f"worst {_ERROR}"),
    "error_median": Variable("1", f"median {_ERROR}"),
    "lanes": Variable("1", "periodic lanes", np.int32),
    "agreeing": Variable("1", "lanes that move like the reference, over which errors are counted", np.int32),
    "status": Variable("1", "outcome", np.int8, tuple(STATUSES)),
    "remark": Variable("1", "why lanes failed", np.str_),
    "reference_spread": Variable("1", "difference of two references, below which errors mean nothing"),
    "on_front": Variable("1", "no setting of the scene is faster and as exact", np.int8, ("no", "yes")),
}
_READING = (
    "Time is that of all lanes on all cores, copied until each core has a block of them, divided by their number and "
    "the simulated seconds of each, without compiling and without a check run: the median of the repeats, and half "
    "their range as its spread. Worst and median are over the lanes that move like the reference, of the larger "
    "relative error of period and impact velocity (penetration: of the rate of penetration). Settings in bold are on "
    "the Pareto front of time and worst error. Rows with a remark had lanes that failed; they are never on the front."
)


def run_accuracy(scenes: Sequence[str] | None = None, quick: bool = False, progress: bool = True) -> xr.Dataset:
    """Measure run time and error of all methods, for a work-precision diagram.

    **Arguments:**

    - `scenes`: names of the scenes to measure; by default all scenes, or two scenes if `quick`.
    - `quick`: True to run only a few settings and lanes, which takes a few seconds, as a test of the installation.

    **Returns:** a dataset along the dimension `setting`, with run times, errors, and reasons of failures. Each setting
    has the coordinates `scene`, `method`, `precision`, `varied` (name of the varied quantity) and `value` (value of
    this quantity).

    **Raises:** `InputError` for an unknown scene.

    **Example:**

    >>> study = vj.run_accuracy(["penetration"], quick=True, progress=False)
    >>> located = study.isel(setting=study.method == "located")
    >>> bool((located.error_worst[located.precision == "float64"] < 1e-6).all())
    True
    """
    scenes = tuple(scenes or (QUICK_SCENES if quick else programs.SCENES))
    for index, scene in enumerate(scenes):
        choice(Place("accuracy", "scenes").item(index), scene, programs.SCENES)
    check_distinct(Place("accuracy", "scenes"), scenes, "scene")
    began = time.monotonic()
    bar = Progress(sum(len(settings_of(scene, quick)) for scene in scenes), "settings", progress, pace=False)
    rows = [row for scene in scenes for row in _measured_scene(scene, quick, bar)]
    missing = {name: 0 if variable.dtype is np.int32 else np.nan for name, variable in _VARIABLES.items()}
    columns = {name: (SETTING, [row.get(name, x) for row in rows]) for name, x in missing.items()}
    coordinates = {name: columns.pop(name) for name in Setting._fields}
    about: dict[str, Any] = {"reference": REFERENCE_TEXT, "settings": programs.SETTINGS_TEXT}
    about |= {"machine": json.dumps(machine()), "wall_time_s": time.monotonic() - began}
    return AccuracyStudy().dataset(columns, coordinates, title="Speed against error", **about)


def _measured_scene(scene: str, quick: bool, bar: Progress) -> list[dict[str, Any]]:
    """Return the values of the dataset's variables for each setting of a scene; undefined ones are left out."""
    fine = Program(scene, "located", "float64", quick)
    fine.compile(FINE)
    reference, second = (fine.features(accuracy, fine.run(accuracy)) for accuracy in (FINE, SECOND))
    status, error = compared(second, reference)
    usable = (status == 0) & (error < TRUSTED_WITHIN)  # and periodic
    if "cycles" in reference:
        usable &= (reference["cycles"] > 0) & (reference["cycles"] == second["cycles"])
    else:
        usable &= reference["rate_of_penetration"] > 0
    spread = error[usable].max()
    rows, compiled = [], dict[tuple[str, str], tuple[Program, float]]()
    for setting in settings_of(scene, quick):
        key, by_diffrax = (setting.method, setting.precision), setting.method.startswith("diffrax")
        row = {"lanes": usable.sum(), "status": len(STATUSES) - 1, "remark": STATUSES["unsupported"]}
        if not (by_diffrax and isinstance(fine.sweep.system, HasRock)):
            if key not in compiled:
                program = (DiffraxProgram if by_diffrax else Program)(scene, *key, quick)
                began = time.perf_counter()
                program.compile(setting.accuracy)
                compiled[key] = program, time.perf_counter() - began
            program, compile_time = compiled[key]
            row = _measured(program, setting.accuracy, QUICK_REPEATS if quick else REPEATS, reference, usable)
            row["compile_time"] = compile_time
        outcome = row["remark"]
        if "error_worst" in row:
            outcome = f"error {row['error_worst']:.1e}, {1e6 * row['time_per_lane_second']:.3g} µs/lane-s"
        rows.append(setting._asdict() | row | {"reference_spread": spread})
        bar.add(1, f"{scene}: {setting.method}, {setting.precision}, {setting.varied} {setting.value:g}: {outcome}")
    # Only settings whose lanes all agree with the reference can be on the front.
    worst = [row["error_worst"] if row["status"] == 0 else np.nan for row in rows]
    front = pareto([row.get("time_per_lane_second", np.nan) for row in rows], worst)
    return [row | {"on_front": on_front} for row, on_front in zip(rows, front, strict=True)]


def _measured(
    program: Program, accuracy: Accuracy, repeats: int, reference: Features, usable: Bool[np.ndarray, " lanes"]
) -> dict[str, Any]:
    """Run a program up to `repeats` times, once if lanes do not reach the end, and compare its usable lanes."""
    seconds: list[float] = []
    ran: Any = {}
    while len(seconds) < (repeats if sum(seconds) < LONG_REPEATS else 2):
        began = time.perf_counter()
        ran = program.run(accuracy)
        seconds.append(time.perf_counter() - began)
        if not ran["finished"].all():
            break
    pair = program.features(accuracy, ran), reference
    features, expected = ({name: x[usable] for name, x in found.items()} for found in pair)
    status, error = compared(features, expected)
    agrees, times = status == 0, np.array(seconds) / (program.sweep.lanes * (program.settle + program.observe))
    lanes, counts = counted(len(status), "lane"), np.bincount(status, minlength=len(STATUSES))
    remarks = [f"{n} of {lanes} {why}" for n, why in zip(counts, STATUSES.values(), strict=True) if n and why]
    row: dict[str, Any] = {"lanes": len(status), "agreeing": agrees.sum(), "remark": "; ".join(remarks)}
    row["status"] = 0 if agrees.all() else status[~agrees].min()
    for end, of in (("", np.median), ("_min", np.min), ("_max", np.max)):
        row[f"time_per_lane_second{end}"] = of(times)
    known = {"error_worst": error[agrees].max(), "error_median": np.median(error[agrees])} if agrees.any() else {}
    return row | known


def compared(features: Features, reference: Features) -> tuple[Int[np.ndarray, " lanes"], Float[np.ndarray, " lanes"]]:
    """Return the status of each lane, an index into `STATUSES`, and its error.

    The error is the larger one of period and impact velocity, or that of the rate of penetration in scenes without
    them. The motions differ if impacts per return differ by more than 5 %, or the error is a half or more. A motion
    need not be periodic to 1e-3: coarse steps cause more jitter, but the means belong to the same motion.
    """
    names = [str(name) for name in ("period", "impact_velocity") if name in reference] or ["rate_of_penetration"]
    pairs = [(np.abs(features[name].astype(float) - reference[name]), np.abs(reference[name])) for name in names]
    with np.errstate(divide="ignore", invalid="ignore"):
        error = reduce(np.fmax, [np.where(x == 0, 0.0, x / size) for x, size in pairs])
    other = ~(error < OTHER_MOTION_ERROR)
    if "impacts" in reference:
        impacts, expected = (np.array(x["impacts"], float) / np.maximum(x["cycles"], 1) for x in (features, reference))
        other |= ~(np.abs(impacts - expected) <= 0.05 * np.maximum(expected, 1))
    return np.select([~features["finite"], ~features["finished"], other], [1, 2, 3], 0), error


def pareto(time: ArrayLike, error: ArrayLike) -> Bool[np.ndarray, " points"]:
    """Return a mask of the points on the Pareto front; points with non-finite values are never on it.

    A point is on the front unless another one is faster and at least as exact, or more exact and at least as fast.
    """
    points = np.stack([np.asarray(time, float), np.asarray(error, float)])
    finite = np.isfinite(points).all(axis=0)
    here, there = points[:, finite, None], points[:, None, :]
    return finite & ~((here <= there).all(axis=0) & (here < there).any(axis=0)).any(axis=0)


def machine() -> dict[str, str | int]:
    """Return the hardware and software that affect timings: processor, cores, accelerator if any, and versions."""
    cpuinfo = Path("/proc/cpuinfo")
    model = re.search(r"model name\s*: *(.*)", cpuinfo.read_text() if cpuinfo.exists() else "")
    about: dict[str, str | int] = {"processor": model[1] if model else platform.processor() or platform.machine()}
    about["cores"], device = usable_cores(), workers()[0]
    if device is not None:
        about["accelerator"] = device.device_kind
    return about | {"python": platform.python_version()} | {name: version(name) for name in ("jax", "diffrax")}


def table(ds: xr.Dataset) -> str:
    """Return the dataset of the study as Markdown: machine, reference, settings, and a table for each scene."""
    about = json.loads(ds.attrs["machine"])
    versions = (f"{name} {value}" for name, value in about.items() if name not in ("processor", "cores"))
    paragraphs = [
        "# Speed against error",
        f"Machine: {about['processor']}, {about['cores']} cores, {', '.join(versions)}",
        f"Reference: {ds.attrs['reference']}.",
        f"Settings: {ds.attrs['settings']}.",
        _READING,
    ]
    for scene, here in ds.to_dataframe().groupby("scene", sort=False):
        unit, ends = here["varied"].map({"width": " m/s", "step": " s"}).fillna(""), ("_max", "_min")
        slowest, fastest = (here[f"time_per_lane_second{end}"] for end in ends)
        cells = {
            "method": here["method"],
            "precision": here["precision"],
            "setting": here["varied"] + here["value"].map(" {:g}".format) + unit,
            "µs per lane-s": (1e6 * here["time_per_lane_second"]).map("{:.3g}".format),
            "spread": (5e5 * (slowest - fastest)).map("± {:.2g}".format),
            "worst": here["error_worst"].map("{:.1e}".format),
            "median": here["error_median"].map("{:.1e}".format),
            "compile s": here["compile_time"].map("{:.1f}".format),
            "remark": here["remark"],
        }
        cells["setting"] = cells["setting"].where(here["on_front"] == 0, "**" + cells["setting"] + "**")
        rule = ["---" if header in ("method", "precision", "setting", "remark") else "---:" for header in cells]
        texts = [f"| {' | '.join(row)} |" for row in (cells, *zip(*cells.values(), strict=True))]
        rows = [re.sub(r"(± )?\bnan\b", "–", text) for text in texts]
        spread = here["reference_spread"].iloc[0]
        paragraphs += [
            f"## {scene}",
            f"{counted(here['lanes'].iloc[0], 'periodic lane')}; two references differ by {spread:.1e}.",
            "\n".join([rows[0], f"|{'|'.join(rule)}|", *rows[1:]]),
        ]
    return "\n\n".join(paragraphs) + "\n"


_MOST_COLUMNS = 3
_FLOOR = "#E8E8E8"
_BAND: Look = {"colour": "#F2C94C", "width": 4.5, "alpha": 0.65}
_RANGE: Look = {"colour": FAINT, "width": 1.6}
_MEDIAN: Look = {"colour": "#767676", "width": 0.7}

# Name in the legend, marker and colour, by method and varied setting; the markers are distinct in greyscale.
_LOOKS = {
    ("located", "tolerance"): ("events located, over tolerance", "o", "#004488"),
    ("located", "stride"): ("events located, over fixed stride", "D", "#3F8FA3"),
    ("smoothed", "width"): ("friction smoothed, over width", "s", "#D1570A"),
    ("smoothed", "step"): ("friction smoothed, over step", "p", "#9C6B1E"),
    ("smoothed", "stride"): ("Runge–Kutta, over stride", "h", "#D9A441"),
    ("diffrax Tsit5", "width"): ("diffrax Tsit5, adaptive", "^", "#7A5195"),
    ("diffrax Dopri8", "width"): ("diffrax Dopri8, adaptive", "v", "#C2185B"),
    ("diffrax Kvaerno5", "width"): ("diffrax Kvaerno5, adaptive", "<", "#4D4D4D"),
    ("diffrax Tsit5, fixed steps", "width"): ("diffrax Tsit5, fixed steps", ">", "#2E8B57"),
}


def work_precision(ds: xr.Dataset) -> Sheet:
    """Draw the worst error over the time per lane-second, both logarithmic, in one panel per scene.

    A whisker goes down from each setting's marker to the median lane's error. The Pareto front is in the background.
    Errors in the grey area are smaller than the error of the reference. Hollow markers are float32; crosses mark
    settings with failed lanes.
    """
    ds = ds.assign({name: 1e6 * ds[name] for name in ds.data_vars if str(name).startswith("time_per_lane_second")})
    scenes = list(dict.fromkeys(ds["scene"].values.tolist()))
    wide = min(_MOST_COLUMNS, max(len(scenes), 1))
    deep = -(-len(scenes) // wide)
    known = ds.isel({SETTING: ds["error_worst"].values > 0})
    times, errors = (0.1, 1.0), (0.1, 1.0)
    if known.sizes[SETTING]:
        fastest, slowest = (known[f"time_per_lane_second_{end}"] for end in ("min", "max"))
        worst = known["error_worst"]
        times = float(fastest.min()) / 1.2, float(slowest.max()) * 1.2
        errors = float(worst.min()) / 5, float(worst.max()) * 5
    across = Axis("time per simulated lane-second [µs]", limits=times, log=True, group="time")
    up = Axis("worst lane's relative error", limits=errors, log=True, group="error")
    plots = []
    for index, scene in enumerate(scenes):
        rows = ds.isel({SETTING: ds["scene"].values == scene})
        count = counted(int(rows["lanes"].values[0]), "periodic lane")
        plots.append(Plot(_layers(rows, errors[0]), across, up, f"{scene}: {count}", divmod(index, wide)))
    keys: list[Key] = [
        key("down to the error of the median lane", **_MEDIAN),
        key("range of the measured times", **_RANGE),
        key("Pareto front", **_BAND),
    ]
    machine = {"processor": "machine unknown", "cores": "?", "jax": "?"} | table_of(ds, "machine")
    computer = printable("{processor}, {cores} cores, jax {jax}".format(**machine), 180)
    absent = ds.isel({SETTING: ds["time_per_lane_second"].isnull().values})
    pairs = dict.fromkeys(zip(absent["method"].values.tolist(), absent["scene"].values.tolist(), strict=True))
    cannot = dict.fromkeys(f"{method.split()[0]} cannot run {scene}" for method, scene in pairs)
    title, size = title_of(ds, "Speed against error"), (3.1 * wide + 2.2, 3.0 * deep + 0.35)
    return Sheet(plots, size, keys=[keys], title=title, note=". ".join([computer, *cannot]))


def _layers(ds: xr.Dataset, least: float) -> list[Layer]:
    """Return the marks of one scene, above the `least` error of the panels."""
    layers: list[Layer] = []
    front = ds.isel({SETTING: ds["on_front"].values == 1}).sortby("time_per_lane_second")
    if front.sizes[SETTING]:  # a staircase; settings above and to the right of it are worse
        x, y = front["time_per_lane_second"].values, front["error_worst"].values
        places, heights = [x[0], *x, np.inf], [np.inf, *y, y[-1]]
        layers.append(Line(np.repeat(places, 2)[1:], np.repeat(heights, 2)[:-1], order=1.0, **_BAND))
    spread = max(float(ds["reference_spread"].values[0]), 1e-16)
    if spread > 2 * least:  # else it cannot be seen
        floor = Look(colour=_FLOOR, order=0.0, label="below the error of the reference")
        layers.append(Area([-np.inf, np.inf], [-np.inf] * 2, [spread] * 2, **floor))
    ds = ds.isel({SETTING: ds["time_per_lane_second"].notnull().values})
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
            Line(*bars(time, here["error_median"].values, worst), **_MEDIAN),
            Line(*bars(worst, fastest, slowest)[::-1], **_RANGE),
        ]
        if (failed != 0).any():
            crosses = time[failed != 0], worst[failed != 0]
            layers.append(dots(*crosses, marker="x", size=6.0, order=4.0, label="some lanes failed"))
    return layers


class AccuracyStudy(Analysis):
    """Study of speed against error on this machine: a dataset, a table and a picture."""

    kind = "accuracy"
    variables = _VARIABLES
    view = "plots"
    pictures = (PictureRule("accuracy", lambda held: True, work_precision),)

"""Accuracy study: measured times and errors of all settings, the dataset of results, and its Markdown table."""

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
from vibrojax.errors import InputError, Place, counted, suggestion
from vibrojax.io.kinds import dataset_attributes
from vibrojax.io.variables import Variable, described
from vibrojax.pictures.contents import SETTING
from vibrojax.progress import Progress
from vibrojax.scenes import HasRock
from vibrojax.settings.values import check_distinct
from vibrojax.stepping import Accuracy
from vibrojax.studies.accuracy_programs import REFERENCE as FINE
from vibrojax.studies.accuracy_programs import (
    SCENES,
    SETTINGS_TEXT,
    DiffraxProgram,
    Features,
    Program,
    Setting,
    settings_of,
)
from vibrojax.studies.accuracy_programs import SECOND_REFERENCE as SECOND

QUICK_SCENES = ("vibro-impact", "penetration")
REPEATS, QUICK_REPEATS, LONG_REPEATS = 5, 2, 0.6  # numbers of runs, and time [s] from which two suffice
OTHER_MOTION_ERROR = 0.5  # relative error from which a lane counts as another motion than the reference
TRUSTED_WITHIN = 1e-4  # relative difference of the two references up to which a lane is used for comparisons
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
_RELATIVE = {"period": "period", "impact_velocity": "impact velocity", "peak_impact_force": "peak force"}
_ERRORS = _RELATIVE | {"stick_fraction": "stick fraction", "rate_of_penetration": "ROP"}  # feature: name in the table
_MEANINGS = {  # errors, by the prefix of their variables
    "": "relative error of the larger of period and impact velocity; in penetration of the rate of penetration",
    **{f"{name}_": f"relative error of {name.replace('_', ' ')}" for name in _ERRORS},
    "stick_fraction_": "error of stick fraction",
}
_VARIABLES = {
    **{name: Variable("1", name, np.str_) for name in ("scene", "method", "precision")},
    "varied": Variable("1", "varied quantity", np.str_),
    "value": Variable("1", "value of the varied quantity: tolerance and stride [1], width [m s-1], step [s]"),
    "time_per_lane_second": Variable("s", "median time per lane-second"),
    "time_per_lane_second_min": Variable("s", "shortest time per lane-second"),
    "time_per_lane_second_max": Variable("s", "longest time per lane-second"),
    "repeats": Variable("1", "repeats", np.int32),
    "compile_time": Variable("s", "compile time"),
    "steps_per_second": Variable("s-1", "steps of a lane per simulated second"),
    **{
        f"{prefix}error_{which}": Variable("1", f"{which} {meaning}")
        for prefix, meaning in _MEANINGS.items()
        for which in ("worst", "median")
    },
    "lanes": Variable("1", "periodic lanes", np.int32),
    "agreeing": Variable("1", "lanes that move like the reference, over which errors are counted", np.int32),
    "repeating": Variable("1", "lanes that also repeat like the reference, to 1e-3", np.int32),
    "status": Variable("1", "outcome", np.int8, tuple(STATUSES)),
    "remark": Variable("1", "why lanes failed", np.str_),
    "reference_spread": Variable("1", "difference of two references, below which errors mean nothing"),
    "on_front": Variable("1", "no setting of the scene is faster and as exact", np.int8, ("no", "yes")),
}
_READING = (
    "Time is that of all lanes on all cores, copied until each core has a block of them, divided by their number and "
    "the simulated seconds of each, without compiling and without a check run: the median of the repeats, and half "
    "their range as its spread. Worst and median are over the lanes that move like the reference, of the larger "
    "relative error of period and impact velocity (penetration: of the rate of penetration, ROP); the columns after "
    "them are the worst lane's, relative, of the stick fraction the difference. Settings in bold are on the Pareto "
    "front of time and worst error. Rows with a remark had lanes that failed; they are never on the front."
)


def run_accuracy(scenes: Sequence[str] | None = None, quick: bool = False, progress: bool = True) -> xr.Dataset:
    """Measure run time and error of all methods, for a work-precision diagram.

    **Arguments:**

    - `scenes`: names of the scenes; None: all scenes, or two scenes if `quick`.
    - `quick`: whether to run only few settings and lanes, which takes some seconds: a test of the installation rather
      than a measurement.
    - `progress`: whether to report progress on stderr.

    **Returns:** a dataset along `setting` with run times, errors, and failures with their reasons. Its coordinates are
    the strings scene, method, precision and varied, and the `value` of the varied quantity.

    **Raises:** `InputError` for an unknown scene.

    **Example:**

    >>> study = vj.run_accuracy(["penetration"], quick=True, progress=False)
    >>> located = study.isel(setting=study.method == "located")
    >>> bool((located.error_worst[located.precision == "float64"] < 1e-6).all())
    True
    """
    scenes = tuple(scenes or (QUICK_SCENES if quick else SCENES))
    for scene in scenes:
        if scene not in SCENES:
            raise InputError(f'accuracy: "{scene}" is not a scene; {suggestion(scene, SCENES)}')
    check_distinct(Place("accuracy", "scenes"), scenes, "scene")
    began = time.monotonic()
    bar = Progress(sum(len(settings_of(scene, quick)) for scene in scenes), "settings", progress, pace=False)
    rows = [row for scene in scenes for row in _measured_scene(scene, quick, bar)]
    attributes = {
        **dataset_attributes("accuracy", "Speed against error", "accuracy"),
        "reference": REFERENCE_TEXT,
        "settings": SETTINGS_TEXT,
        "machine": json.dumps(machine()),
        "wall_time_s": time.monotonic() - began,
    }
    missing = {name: 0 if variable.dtype is np.int32 else np.nan for name, variable in _VARIABLES.items()}
    data = described({name: (SETTING, [row.get(name, x) for row in rows]) for name, x in missing.items()}, _VARIABLES)
    coordinates = {name: data.pop(name) for name in Setting._fields}
    return xr.Dataset(data, coordinates, attributes)


def _measured_scene(scene: str, quick: bool, bar: Progress) -> list[dict[str, Any]]:
    """Return the values of the dataset's variables for each setting of a scene; undefined ones are left out."""
    fine = Program(scene, "located", "float64", quick)
    fine.compile(FINE)
    reference, second = (fine.features(accuracy, fine.run(accuracy)) for accuracy in (FINE, SECOND))
    status, errors = compared(second, reference)
    usable = (status == 0) & (errors[""] < TRUSTED_WITHIN)  # and periodic
    if "cycles" in reference:
        usable &= (reference["cycles"] > 0) & (reference["cycles"] == second["cycles"])
    else:
        usable &= reference["rate_of_penetration"] > 0
    spread = errors[""][usable].max()
    rows, programs = [], dict[tuple[str, str], tuple[Program, float]]()
    for setting in settings_of(scene, quick):
        key, by_diffrax = (setting.method, setting.precision), setting.method.startswith("diffrax")
        row = {"lanes": usable.sum(), "status": len(STATUSES) - 1, "remark": STATUSES["unsupported"]}
        if not (by_diffrax and isinstance(fine.sweep.system, HasRock)):
            if key not in programs:
                program = (DiffraxProgram if by_diffrax else Program)(scene, *key, quick)
                began = time.perf_counter()
                program.compile(setting.accuracy)
                programs[key] = program, time.perf_counter() - began
            program, compile_time = programs[key]
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
    status, errors = compared(features, expected)
    agrees, times = status == 0, np.array(seconds) / (program.sweep.lanes * (program.settle + program.observe))
    lanes, counts = counted(len(status), "lane"), np.bincount(status, minlength=len(STATUSES))
    row: dict[str, Any] = {
        "time_per_lane_second": np.median(times),
        "time_per_lane_second_min": times.min(),
        "time_per_lane_second_max": times.max(),
        "repeats": len(seconds),
        "steps_per_second": np.mean(ran["steps"]) / (program.settle + program.observe),
        "lanes": len(status),
        "agreeing": agrees.sum(),
        "repeating": (agrees & np.equal(*(found.get("cycles", 0) for found in (features, expected)))).sum(),
        "status": 0 if agrees.all() else status[~agrees].min(),
        "remark": "; ".join(
            f"{n} of {lanes} {why}" for n, why in zip(counts, STATUSES.values(), strict=True) if n and why
        ),
    }
    for name, x in errors.items() if agrees.any() else ():
        row |= {f"{name}error_worst": x[agrees].max(), f"{name}error_median": np.median(x[agrees])}
    return row


def compared(
    features: Features, reference: Features
) -> tuple[Int[np.ndarray, " lanes"], dict[str, Float[np.ndarray, " lanes"]]]:
    """Return the status of each lane, an index into `STATUSES`, and its errors by the prefix of their variables.

    The error without prefix is the larger one of period and impact velocity, or that of the rate of penetration in
    scenes without them. A motion is another one if impacts per return differ by more than 5 %, or that error is a half
    or more. It need not be periodic to 1e-3: coarse steps cause more jitter, but the means belong to the same motion.
    """
    errors = {}
    for name in _ERRORS:
        if name in reference and name in features:
            difference = np.abs(features[name].astype(float) - reference[name])
            size = 1.0 if name == "stick_fraction" else np.abs(reference[name])
            with np.errstate(divide="ignore", invalid="ignore"):
                errors[f"{name}_"] = np.where(difference == 0, 0.0, difference / size)
    main = [errors[name] for name in ("period_", "impact_velocity_") if name in errors]
    errors[""] = reduce(np.fmax, main or [errors["rate_of_penetration_"]])
    other = ~(errors[""] < OTHER_MOTION_ERROR)
    if "impacts" in reference:
        found, expected = (np.asarray(x["impacts"], float) / np.maximum(x["cycles"], 1) for x in (features, reference))
        other |= ~(np.abs(found - expected) <= 0.05 * np.maximum(expected, 1))
    return np.select([~features["finite"], ~features["finished"], other], [1, 2, 3], 0), errors


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
    if device.platform != "cpu":
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
        shown = {f"{name}_": text for name, text in _ERRORS.items() if here[f"{name}_error_worst"].notna().any()}
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
            **{text: here[f"{prefix}error_worst"].map("{:.1e}".format) for prefix, text in shown.items()},
            "compile s": here["compile_time"].map("{:.1f}".format),
            "remark": here["remark"],
        }
        cells["setting"] = cells["setting"].where(here["on_front"] == 0, "**" + cells["setting"] + "**")
        rule = ["---" if header in ("method", "precision", "setting", "remark") else "---:" for header in cells]
        rows = [
            re.sub(r"(± )?\bnan\b", "–", f"| {' | '.join(row)} |")
            for row in (cells, *zip(*cells.values(), strict=True))
        ]
        spread = here["reference_spread"].iloc[0]
        paragraphs += [
            f"## {scene}",
            f"{counted(here['lanes'].iloc[0], 'periodic lane')}; two references differ by {spread:.1e}.",
            "\n".join([rows[0], f"|{'|'.join(rule)}|", *rows[1:]]),
        ]
    return "\n\n".join(paragraphs) + "\n"

"""The accuracy study: measurement of all settings of all scenes, the dataset of results, and its Markdown table."""

import json
import platform
import time
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Bool
from numpy.typing import ArrayLike

from vibrojax.compile.xla import usable_cores, workers
from vibrojax.errors import InputError, Place, counted, suggestion
from vibrojax.io.kinds import dataset_attributes
from vibrojax.io.variables import Variable
from vibrojax.progress import Progress
from vibrojax.settings.values import check_distinct
from vibrojax.stepping import Accuracy
from vibrojax.studies.accuracy_cases import (
    REFERENCE,
    SCENES,
    SECOND_REFERENCE,
    SETTINGS_TEXT,
    SOLVERS,
    lanes_of,
    settings_of,
)
from vibrojax.studies.accuracy_measurement import (
    COMPARED,
    RELATIVE,
    STATUSES,
    Row,
    error_name,
    errors_of,
    measure,
    usable,
)
from vibrojax.studies.accuracy_programs import DiffraxProgram, Program

REPEATS, QUICK_REPEATS = 5, 2
QUICK_SCENES = ("vibro-impact", "penetration")
NO_ROCK = ("rotary", "vibro-impact")
SETTING = "setting"
REFERENCE_TEXT = (
    f"the located method, float64, at a tolerance of {REFERENCE.tolerance:g} and a stride of {REFERENCE.stride:g}; "
    "reference_spread is its difference from another one "
    f"(tolerance {SECOND_REFERENCE.tolerance:g}, stride {SECOND_REFERENCE.stride:g})"
)

_COORDINATES = {
    "scene": Variable("1", "scene", np.str_),
    "method": Variable("1", "method", np.str_),
    "precision": Variable("1", "precision", np.str_),
    "varied": Variable("1", "varied quantity", np.str_),
    "value": Variable("1", "value of the varied quantity: tolerance and stride [1], width [m s-1], step [s]"),
}


def _error_variables() -> dict[str, Variable]:
    """Return the variables with the errors of the features: the worst lane's and the median."""
    variables = {}
    for name in ("overall", *COMPARED):
        kind = name.replace("_", " ")
        if name == "overall":
            kind = "the larger of period and impact velocity; in penetration of the rate of penetration"
        error = "relative error" if name in (*RELATIVE, "overall") else "error"
        for statistic in ("worst", "median"):
            variables[error_name(name, statistic)] = Variable("1", f"{statistic} {error} of {kind}")
    return variables


_VARIABLES = {
    "time_per_lane_second": Variable("s", "median time per lane-second"),
    "time_per_lane_second_min": Variable("s", "shortest time per lane-second"),
    "time_per_lane_second_max": Variable("s", "longest time per lane-second"),
    "repeats": Variable("1", "repeats", np.int32),
    "compile_time": Variable("s", "compile time"),
    "steps_per_second": Variable("s-1", "steps of a lane per simulated second"),
    **_error_variables(),
    "lanes": Variable("1", "periodic lanes", np.int32),
    "agreeing": Variable("1", "lanes that move like the reference, over which errors are counted", np.int32),
    "repeating": Variable("1", "lanes that also repeat like the reference, to 1e-3", np.int32),
    "status": Variable("1", "outcome", np.int8, STATUSES),
    "remark": Variable("1", "why lanes failed", np.str_),
    "reference_spread": Variable("1", "difference of two references, below which errors mean nothing"),
    "on_front": Variable("1", "no setting of the scene is faster and as exact", np.int8, ("no", "yes")),
}

_ERRORS = {
    "period": "period",
    "impact_velocity": "impact velocity",
    "peak_impact_force": "peak force",
    "stick_fraction": "stick fraction",
    "rate_of_penetration": "ROP",
}
_UNITS = {"width": " m/s", "step": " s"}
_READING = (
    "Time is that of all lanes on all cores, copied until each core has a block of them, divided by their number "
    "and the simulated seconds of each, without compiling and without a check run: the median of the "
    "repeats, and half their range as its spread. Worst and median are over the lanes that move like the "
    "reference, of the larger relative error of period and impact velocity (penetration: of the rate of "
    "penetration, ROP); the columns after them are the worst lane's, relative, of the stick fraction the "
    "difference. Settings in bold are on the Pareto front of time and worst error. Rows with a remark had lanes "
    "that failed; they are never on the front."
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
    rows: list[Row] = []
    for scene in scenes:
        rows += _measure_scene(scene, quick, bar)
    return dataset_of(rows, time.monotonic() - began)


def _measure_scene(scene: str, quick: bool, bar: Progress) -> list[Row]:
    """Return the results of a scene's settings."""
    lanes = lanes_of(scene, quick)
    programs: dict[tuple[str, str], tuple[Program, float]] = {}

    def compiled(method: str, precision: str, accuracy: Accuracy) -> tuple[Program, float]:
        """Return the program of a method and precision, and its compile time [s]; any accuracy can be used."""
        if (method, precision) not in programs:
            program = (DiffraxProgram if method in SOLVERS else Program)(lanes, method, precision)
            began = time.perf_counter()
            program.compile(accuracy)
            programs[method, precision] = program, time.perf_counter() - began
        return programs[method, precision]

    program, _ = compiled("located", "float64", REFERENCE)
    reference, second = (program.features(fine, program.run(fine)) for fine in (REFERENCE, SECOND_REFERENCE))
    trusted = usable(reference, second)
    spread = errors_of(second, reference)["overall"][trusted].max()
    rows = []
    for setting in settings_of(scene, quick):
        row: Row = vars(setting) | {"lanes": trusted.sum(), "status": STATUSES.index("unsupported")}
        row["remark"] = outcome = "plain integration knows no rock that yields: its ratchet needs events"
        if setting.method not in SOLVERS or scene in NO_ROCK:
            program, compile_time = compiled(setting.method, setting.precision, setting.accuracy)
            row = measure(setting, program, compile_time, reference, trusted, QUICK_REPEATS if quick else REPEATS)
            outcome = row["remark"]
        if "error_worst" in row:
            outcome = f"error {row['error_worst']:.1e}, {1e6 * row['time_per_lane_second']:.3g} µs/lane-s"
        rows.append(row | {"reference_spread": spread})
        bar.add(1, f"{scene}: {setting.method}, {setting.precision}, {setting.varied} {setting.value:g}: {outcome}")
    return rows


def dataset_of(rows: Sequence[Row], wall_time: float) -> xr.Dataset:
    """Return the dataset of the study, given the result of each setting and the duration of the study [s]."""

    def column(name: str, about: Variable) -> xr.Variable:
        missing = np.nan if about.dtype is np.float64 else 0
        values = np.array([row.get(name, missing) for row in rows], about.dtype)
        return xr.Variable(SETTING, values, about.attributes())

    variables = {name: column(name, about) for name, about in _VARIABLES.items()}
    coordinates = {name: column(name, about) for name, about in _COORDINATES.items()}
    # Only settings whose lanes all agree with the reference can be on the front.
    worst = np.where(variables["status"].values == 0, variables["error_worst"].values, np.nan)
    seconds, scenes = variables["time_per_lane_second"].values, coordinates["scene"].values
    for scene in np.unique(scenes):
        here = scenes == scene
        variables["on_front"].values[here] = pareto(seconds[here], worst[here])
    attributes = {
        **dataset_attributes("accuracy", "Speed against error", "accuracy"),
        "reference": REFERENCE_TEXT,
        "settings": SETTINGS_TEXT,
        "machine": json.dumps(machine()),
        "wall_time_s": float(wall_time),
    }
    return xr.Dataset(variables, coordinates, attributes)


def pareto(time: ArrayLike, error: ArrayLike) -> Bool[np.ndarray, " points"]:
    """Return which points are on the Pareto front; points with non-finite values are never on it.

    A point is on the front unless another one is faster and at least as exact, or more exact and at least as fast.
    """
    times, errors = np.asarray(time, float), np.asarray(error, float)
    finite = np.isfinite(times) & np.isfinite(errors)
    more_exact = (times[:, None] <= times) & (errors[:, None] < errors)
    faster = (times[:, None] < times) & (errors[:, None] <= errors)
    return finite & ~np.any((more_exact | faster) & finite[:, None], axis=0)


def machine() -> dict[str, str | int]:
    """Return the hardware and software that affect timings: processor, cores, accelerator if any, and versions."""
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text().splitlines() if cpuinfo.exists() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    processor = names[0] if names else platform.processor() or platform.machine()
    about: dict[str, str | int] = {"processor": processor, "cores": usable_cores()}
    device = workers()[0]
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
    for scene in dict.fromkeys(ds["scene"].values.tolist()):
        here = ds.isel(setting=ds["scene"].values == scene)
        shown = [name for name in _ERRORS if np.isfinite(here[f"{name}_error_worst"].values).any()]
        numbers = ["µs per lane-s", "spread", "worst", "median", *(_ERRORS[name] for name in shown), "compile s"]
        rows = [_cells(row, shown) for row in here.to_dataframe().to_dict("records")]
        lines = [
            f"| {' | '.join(cells)} |" for cells in (["method", "precision", "setting", *numbers, "remark"], *rows)
        ]
        lines.insert(1, "|---|---|---|" + "---:|" * len(numbers) + "---|")
        lanes, spread = int(here["lanes"][0]), float(here["reference_spread"][0])
        paragraphs += [
            f"## {scene}",
            f"{counted(lanes, 'periodic lane')}; two references differ by {_format(spread, '.1e')}.",
            "\n".join(lines),
        ]
    return "\n\n".join(paragraphs) + "\n"


def _cells(row: Mapping[Any, Any], shown: Sequence[str]) -> list[str]:
    """Return the cells of the table for a setting; `shown`: the features with a column of their errors."""
    name = f"{row['varied']} {row['value']:g}{_UNITS.get(row['varied'], '')}"
    spread = (row["time_per_lane_second_max"] - row["time_per_lane_second_min"]) / 2e-6
    errors = ["error_worst", "error_median", *(f"{error}_error_worst" for error in shown)]
    return [
        row["method"],
        row["precision"],
        f"**{name}**" if row["on_front"] else name,
        _format(1e6 * row["time_per_lane_second"], ".3g"),
        _format(spread, ".2g", "± "),
        *(_format(row[error], ".1e") for error in errors),
        _format(row["compile_time"], ".1f"),
        row["remark"],
    ]


def _format(value: float, spec: str, prefix: str = "") -> str:
    return f"{prefix}{value:{spec}}" if np.isfinite(value) else "–"

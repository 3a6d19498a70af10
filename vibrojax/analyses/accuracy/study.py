"""The accuracy study: measurement of all settings of all scenes, and the dataset of results."""

import json
import platform
import time
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path

import numpy as np
import xarray as xr
from jaxtyping import Bool
from numpy.typing import ArrayLike

from vibrojax.analyses.accuracy.cases import (
    NO_ROCK,
    REFERENCE,
    SCENES,
    SECOND_REFERENCE,
    SETTINGS_TEXT,
    SOLVERS,
    lanes_of,
    settings_of,
)
from vibrojax.analyses.accuracy.measurement import (
    COMPARED,
    RELATIVE,
    STATUSES,
    Measurement,
    errors_of,
    measure,
    usable,
)
from vibrojax.analyses.accuracy.programs import StudyPrograms
from vibrojax.compile.xla import usable_cores, workers
from vibrojax.errors import InputError, suggestion
from vibrojax.io.kinds import dataset_attributes
from vibrojax.io.variables import Variable
from vibrojax.progress import Progress

REPEATS, QUICK_REPEATS = 5, 2
QUICK_SCENES = ("vibro-impact", "penetration")
SETTING = "setting"
REFERENCE_TEXT = (
    f"the located method, float64, at a tolerance of {REFERENCE.tolerance:g} and a stride of {REFERENCE.stride:g}; "
    "reference_spread is its difference from another one "
    f"(tolerance {SECOND_REFERENCE.tolerance:g}, stride {SECOND_REFERENCE.stride:g})"
)
_OVERALL = "the larger of period and impact velocity; in penetration of the rate of penetration"


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
    began = time.monotonic()
    bar = Progress(sum(len(settings_of(scene, quick)) for scene in scenes), "settings", progress, pace=False)
    results: list[Measurement] = []
    spreads = {}
    for scene in scenes:
        measured, spreads[scene] = _measure_scene(scene, quick, bar)
        results += measured
    return dataset_of(results, spreads, time.monotonic() - began)


def _measure_scene(scene: str, quick: bool, bar: Progress) -> tuple[list[Measurement], float]:
    """Return the results of a scene's settings, and the largest difference between the two references."""
    programs = StudyPrograms(lanes_of(scene, quick))
    program, _ = programs.of("located", "float64", REFERENCE)
    reference, second = (program.features(fine, program.run(fine)) for fine in (REFERENCE, SECOND_REFERENCE))
    trusted = usable(reference, second)
    results = []
    for setting in settings_of(scene, quick):
        if setting.method not in SOLVERS or scene in NO_ROCK:
            program, compile_time = programs.of(setting.method, setting.precision, setting.accuracy)
            repeats = QUICK_REPEATS if quick else REPEATS
            result = measure(setting, program, compile_time, reference, trusted, repeats)
        else:
            reason = "plain integration knows no rock that yields: its ratchet needs events"
            result = Measurement(setting, "unsupported", reason, int(trusted.sum()))
        results.append(result)
        outcome = result.reason
        if result.agreeing:
            cost = f"{1e6 * np.median(result.seconds):.3g} µs/lane-s"
            outcome = f"error {result.errors['overall'].max():.1e}, {cost}"
        bar.add(1, f"{scene}: {setting.method}, {setting.precision}, {setting.varied} {setting.value:g}: {outcome}")
    return results, float(errors_of(second, reference)["overall"][trusted].max())


def dataset_of(results: Sequence[Measurement], spreads: Mapping[str, float], wall_time: float) -> xr.Dataset:
    """Return the dataset of the study.

    **Arguments:** `spreads`: largest difference between the two references, by scene.
    """

    def along(values: Sequence[object], long_name: str, units: str = "1", dtype: type | None = None) -> xr.Variable:
        return xr.Variable(SETTING, np.array(values, dtype), Variable(units, long_name).attributes())

    def over_repeats(reduce: Callable[[tuple[float, ...]], float], text: str) -> xr.Variable:
        values = [reduce(result.seconds) if result.seconds else np.nan for result in results]
        return along(values, f"{text} time per lane-second", "s", float)

    settings = [result.setting for result in results]
    meaning = "value of the varied quantity: tolerance and stride [1], width [m s-1], step [s]"
    coordinates = {
        "scene": along([setting.scene for setting in settings], "scene"),
        "method": along([setting.method for setting in settings], "method"),
        "precision": along([setting.precision for setting in settings], "precision"),
        "varied": along([setting.varied for setting in settings], "varied quantity"),
        "value": along([setting.value for setting in settings], meaning),
    }
    variables = {
        "time_per_lane_second": over_repeats(np.median, "median"),
        "time_per_lane_second_min": over_repeats(min, "shortest"),
        "time_per_lane_second_max": over_repeats(max, "longest"),
        "repeats": along([len(result.seconds) for result in results], "repeats", dtype=np.int32),
        "compile_time": along([result.compile_time for result in results], "compile time", "s"),
        "steps_per_second": along([result.steps for result in results], "steps of a lane per simulated second", "s-1"),
    }
    for name in ("overall", *COMPARED):
        errors = [result.errors.get(name, np.zeros(0)) for result in results]
        prefix, kind = ("", _OVERALL) if name == "overall" else (f"{name}_", name.replace("_", " "))
        relative = "relative error" if name in (*RELATIVE, "overall") else "error"
        for which, reduce in (("worst", np.max), ("median", np.median)):
            values = [reduce(x) if x.size else np.nan for x in errors]
            variables[f"{prefix}error_{which}"] = along(values, f"{which} {relative} of {kind}", dtype=float)
    statuses = np.array([STATUSES.index(result.status) for result in results], np.int8)
    agreeing = "lanes that move like the reference, over which errors are counted"
    repeating = "lanes that also repeat like the reference, to 1e-3"
    spread = "difference of two references, below which errors mean nothing"
    variables |= {
        "lanes": along([result.lanes for result in results], "periodic lanes", dtype=np.int32),
        "agreeing": along([result.agreeing for result in results], agreeing, dtype=np.int32),
        "repeating": along([result.repeating for result in results], repeating, dtype=np.int32),
        "status": xr.Variable(SETTING, statuses, Variable("1", "outcome", np.int8, STATUSES).attributes()),
        "remark": along([result.reason for result in results], "why lanes failed"),
        "reference_spread": along([spreads[setting.scene] for setting in settings], spread),
    }
    seconds = variables["time_per_lane_second"].values
    # Only settings whose lanes all agree with the reference can be on the front.
    worst = np.where(statuses == 0, variables["error_worst"].values, np.nan)
    front = np.zeros(len(results), np.int8)
    for scene in spreads:
        here = coordinates["scene"].values == scene
        front[here] = pareto(seconds[here], worst[here])
    about = Variable("1", "no setting of the scene is faster and as exact", np.int8, ("no", "yes"))
    variables["on_front"] = xr.Variable(SETTING, front, about.attributes())
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

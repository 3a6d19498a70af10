"""The accuracy study: measurement of all settings of all scenes, the dataset of results, and its Markdown table."""

import json
import platform
import time
from collections.abc import Iterable, Mapping, Sequence
from importlib.metadata import version
from operator import attrgetter
from pathlib import Path
from typing import Any

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
from vibrojax.analyses.accuracy.programs import DiffraxProgram, Program
from vibrojax.compile.xla import usable_cores, workers
from vibrojax.errors import InputError, counted, suggestion
from vibrojax.io.kinds import dataset_attributes
from vibrojax.io.variables import Variable
from vibrojax.progress import Progress
from vibrojax.stepping import Accuracy

REPEATS, QUICK_REPEATS = 5, 2
QUICK_SCENES = ("vibro-impact", "penetration")
SETTING = "setting"
REFERENCE_TEXT = (
    f"the located method, float64, at a tolerance of {REFERENCE.tolerance:g} and a stride of {REFERENCE.stride:g}; "
    "reference_spread is its difference from another one "
    f"(tolerance {SECOND_REFERENCE.tolerance:g}, stride {SECOND_REFERENCE.stride:g})"
)
_OVERALL = "the larger of period and impact velocity; in penetration of the rate of penetration"

_TEXT = ("method", "precision", "setting")
_NUMBERS = ("µs per lane-s", "spread", "worst", "median")
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
    results = []
    for setting in settings_of(scene, quick):
        if setting.method not in SOLVERS or scene in NO_ROCK:
            program, compile_time = compiled(setting.method, setting.precision, setting.accuracy)
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

    def along(
        values: Iterable[object], long_name: str, units: str = "1", dtype: type | None = None, flags: Any = ()
    ) -> xr.Variable:
        attributes = Variable(units, long_name, flags=flags).attributes()
        return xr.Variable(SETTING, np.array(list(values), dtype), attributes)

    def each(field: str, long_name: str, units: str = "1", dtype: type | None = None) -> xr.Variable:
        return along((attrgetter(field)(result) for result in results), long_name, units, dtype)

    coordinates = {
        "scene": each("setting.scene", "scene"),
        "method": each("setting.method", "method"),
        "precision": each("setting.precision", "precision"),
        "varied": each("setting.varied", "varied quantity"),
        "value": each(
            "setting.value", "value of the varied quantity: tolerance and stride [1], width [m s-1], step [s]"
        ),
    }
    variables = {}
    for suffix, text, reduce in (("", "median", np.median), ("_min", "shortest", min), ("_max", "longest", max)):
        times = (reduce(result.seconds) if result.seconds else np.nan for result in results)
        variables[f"time_per_lane_second{suffix}"] = along(times, f"{text} time per lane-second", "s", float)
    variables["repeats"] = along((len(result.seconds) for result in results), "repeats", dtype=np.int32)
    variables["compile_time"] = each("compile_time", "compile time", "s")
    variables["steps_per_second"] = each("steps", "steps of a lane per simulated second", "s-1")
    for name in ("overall", *COMPARED):
        errors = [result.errors.get(name, np.zeros(0)) for result in results]
        prefix, kind = ("", _OVERALL) if name == "overall" else (f"{name}_", name.replace("_", " "))
        relative = "relative error" if name in (*RELATIVE, "overall") else "error"
        for which, statistic in (("worst", np.max), ("median", np.median)):
            values = (statistic(x) if x.size else np.nan for x in errors)
            variables[f"{prefix}error_{which}"] = along(values, f"{which} {relative} of {kind}", dtype=float)
    statuses = np.array([STATUSES.index(result.status) for result in results], np.int8)
    agreeing = "lanes that move like the reference, over which errors are counted"
    repeating = "lanes that also repeat like the reference, to 1e-3"
    spread = "difference of two references, below which errors mean nothing"
    variables |= {
        "lanes": each("lanes", "periodic lanes", dtype=np.int32),
        "agreeing": each("agreeing", agreeing, dtype=np.int32),
        "repeating": each("repeating", repeating, dtype=np.int32),
        "status": along(statuses, "outcome", dtype=np.int8, flags=STATUSES),
        "remark": each("reason", "why lanes failed"),
        "reference_spread": along((spreads[result.setting.scene] for result in results), spread),
    }
    seconds = variables["time_per_lane_second"].values
    # Only settings whose lanes all agree with the reference can be on the front.
    worst = np.where(statuses == 0, variables["error_worst"].values, np.nan)
    front = np.zeros(len(results), np.int8)
    for scene in spreads:
        here = coordinates["scene"].values == scene
        front[here] = pareto(seconds[here], worst[here])
    best = "no setting of the scene is faster and as exact"
    variables["on_front"] = along(front, best, dtype=np.int8, flags=("no", "yes"))
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
        lanes, spread = int(here["lanes"].values[0]), float(here["reference_spread"].values[0])
        shown = [name for name in _ERRORS if np.isfinite(here[f"{name}_error_worst"].values).any()]
        numbers = [*_NUMBERS, *(_ERRORS[name] for name in shown), "compile s"]
        rows = [_row(here.isel(setting=index), shown) for index in range(here.sizes["setting"])]
        lines = [f"| {' | '.join(cells)} |" for cells in ([*_TEXT, *numbers, "remark"], *rows)]
        lines.insert(1, "|" + "---|" * len(_TEXT) + "---:|" * len(numbers) + "---|")
        paragraphs += [
            f"## {scene}",
            f"{counted(lanes, 'periodic lane')}; two references differ by {_format(spread, '.1e')}.",
            "\n".join(lines),
        ]
    return "\n\n".join(paragraphs) + "\n"


def _row(setting: xr.Dataset, shown: list[str]) -> list[str]:
    def number(name: str) -> float:
        return float(setting[name])

    spread = (number("time_per_lane_second_max") - number("time_per_lane_second_min")) / 2e-6
    varied = str(setting["varied"].item())
    name = f"{varied} {number('value'):g}{_UNITS.get(varied, '')}"
    errors = ["error_worst", "error_median", *(f"{error}_error_worst" for error in shown)]
    return [
        str(setting["method"].item()),
        str(setting["precision"].item()),
        f"**{name}**" if setting["on_front"].item() else name,
        _format(1e6 * number("time_per_lane_second"), ".3g"),
        _format(spread, ".2g", "± "),
        *(_format(number(error), ".1e") for error in errors),
        _format(number("compile_time"), ".1f"),
        str(setting["remark"].item()),
    ]


def _format(value: float, spec: str, prefix: str = "") -> str:
    return f"{prefix}{value:{spec}}" if np.isfinite(value) else "–"

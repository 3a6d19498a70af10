"""The study as a labelled dataset, and as a table to read."""

import json
import platform
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

import numpy as np
import xarray as xr
from jaxtyping import Bool, Int
from numpy.typing import ArrayLike

from vibrojax.analyses.accuracy.cases import REFERENCE, SECOND_REFERENCE, SETTINGS_TEXT
from vibrojax.analyses.accuracy.timing import ERRORS, RELATIVE, STATUSES, Measured
from vibrojax.compile.devices import usable_cores, workers
from vibrojax.io.provenance import source
from vibrojax.io.variables import Variable

SETTING = "setting"
REFERENCE_TEXT = (
    f"the located method, float64, at a tolerance of {REFERENCE.tolerance:g} and a stride of {REFERENCE.stride:g}; "
    "reference_spread is what another one differs from it by "
    f"(tolerance {SECOND_REFERENCE.tolerance:g}, stride {SECOND_REFERENCE.stride:g})"
)
_OVERALL = "the larger of period and impact velocity; in penetration of the rate of penetration"

_COLUMNS = ("method", "precision", "setting", "µs per lane-s", "spread", "worst", "median")
_MORE = ("period", "impact_velocity", "peak_impact_force", "stick_fraction", "rate_of_penetration")
_TITLES = ("period", "impact velocity", "peak force", "stick fraction", "ROP")
_READING = (
    "Time is that of all lanes on all cores, copied until each core has a block of them, divided by their number "
    "and the seconds that each is simulated, without compiling and without a check run: the median of the "
    "repeats, and half their range as its spread. Worst and median are over the lanes that move like the "
    "reference, of the larger relative error of period and impact velocity (penetration: of the rate of "
    "penetration, ROP); the columns after them are the worst lane's, relative, of the stick fraction the "
    "difference. Settings in bold are on the Pareto front of time and worst error. Rows with a remark had lanes "
    "that failed; they are never on the front."
)
_UNITS = {"width": " m/s", "step": " s"}


Variables = dict[str, xr.Variable]


def machine() -> dict[str, str | int]:
    """What times are taken on: processor, cores, accelerator if any, and the versions of Python, jax and diffrax."""
    device = workers()[0]
    about: dict[str, str | int] = {"processor": _processor(), "cores": usable_cores()}
    if device.platform != "cpu":
        about["accelerator"] = device.device_kind
    return about | {"python": platform.python_version()} | {name: version(name) for name in ("jax", "diffrax")}


def _processor() -> str:
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text().splitlines() if cpuinfo.exists() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def dataset_of(measured: Sequence[Measured], floors: Mapping[str, float], wall_time: float) -> xr.Dataset:
    """The dataset of the study; `floors`: what the reference is good to, by scene."""
    value = "value of what is varied: tolerance and stride [1], width [m s-1], step [s]"
    coordinates = {
        "scene": _variable([one.setting.scene for one in measured], "scene"),
        "method": _variable([one.setting.method for one in measured], "method"),
        "precision": _variable([one.setting.precision for one in measured], "precision"),
        "varied": _variable([one.setting.varied for one in measured], "what is varied"),
        "value": _variable([one.setting.value for one in measured], value),
    }
    attributes = {
        "title": "Speed against error",
        "source": source(),
        "history": f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ} accuracy",
        "reference": REFERENCE_TEXT,
        "settings": SETTINGS_TEXT,
        "machine": json.dumps(machine()),
        "wall_time_s": float(wall_time),
        "Conventions": "CF-1.11",
    }
    floor = [floors[one.setting.scene] for one in measured]
    text = "difference of two references, below which errors mean nothing"
    variables = _times(measured) | _errors(measured) | _outcomes(measured)
    ds = xr.Dataset(variables | {"reference_spread": _variable(floor, text)}, coordinates, attributes)
    front = Variable("1", "no setting of the scene is faster and as exact", np.int8, ("no", "yes"))
    return ds.assign(on_front=(SETTING, _front(ds), front.attributes()))


def _variable(values: Sequence[object], long_name: str, units: str = "1", dtype: type | None = None) -> xr.Variable:
    return xr.Variable(SETTING, np.array(values, dtype), Variable(units, long_name).attributes())


def _times(measured: Sequence[Measured]) -> Variables:
    def over_repeats(of: Callable[[tuple[float, ...]], float], text: str) -> xr.Variable:
        values = [of(one.seconds) if one.seconds else np.nan for one in measured]
        return _variable(values, f"{text} time per lane-second", "s", float)

    return {
        "time_per_lane_second": over_repeats(np.median, "median"),
        "time_per_lane_second_min": over_repeats(min, "shortest"),
        "time_per_lane_second_max": over_repeats(max, "longest"),
        "repeats": _variable([len(one.seconds) for one in measured], "repeats", dtype=np.int32),
        "compile_time": _variable([one.compile_time for one in measured], "compile time", "s"),
        "steps_per_second": _variable([one.steps for one in measured], "steps of a lane per simulated second", "s-1"),
    }


def _errors(measured: Sequence[Measured]) -> Variables:
    variables = {}
    for name in ("overall", *ERRORS):
        known = [one.errors.get(name, np.zeros(0)) for one in measured]
        kind = _OVERALL if name == "overall" else name.replace("_", " ")
        relative = "relative error" if name in (*RELATIVE, "overall") else "error"
        for which, of in (("worst", np.max), ("median", np.median)):
            values = [of(x) if x.size else np.nan for x in known]
            key = f"{'' if name == 'overall' else f'{name}_'}error_{which}"
            variables[key] = _variable(values, f"{which} {relative} of {kind}", dtype=float)
    return variables


def _outcomes(measured: Sequence[Measured]) -> Variables:
    agreeing = "lanes that move like the reference, over which errors are counted"
    status = Variable("1", "what became of the setting", np.int8, STATUSES)
    statuses = np.array([STATUSES.index(one.status) for one in measured], np.int8)
    return {
        "lanes": _variable([one.lanes for one in measured], "periodic lanes", dtype=np.int32),
        "agreeing": _variable([one.agreeing for one in measured], agreeing, dtype=np.int32),
        "repeating": _variable(
            [one.repeating for one in measured], "lanes that also repeat as it does, to 1e-3", dtype=np.int32
        ),
        "status": xr.Variable(SETTING, statuses, status.attributes()),
        "remark": _variable([one.reason for one in measured], "why lanes failed"),
    }


def _front(ds: xr.Dataset) -> Int[np.ndarray, " settings"]:
    """Which settings are on the front of their scene: of those whose lanes all agree with the reference."""
    error = np.where(ds["status"].values == 0, ds["error_worst"].values, np.nan)
    scenes = ds["scene"].values
    front = np.zeros(scenes.size, np.int8)
    for scene in np.unique(scenes):
        here = scenes == scene
        front[here] = pareto(ds["time_per_lane_second"].values[here], error[here])
    return front


def pareto(time: ArrayLike, error: ArrayLike) -> Bool[np.ndarray, " points"]:
    """Whether each point is on the Pareto front; points that are not finite never are.

    On it is a point than which no other is faster and at least as exact, or more exact and at least as fast.
    """
    times, errors = np.asarray(time, float), np.asarray(error, float)
    finite = np.isfinite(times) & np.isfinite(errors)
    quicker = (times[:, None] <= times) & (errors[:, None] < errors)
    finer = (times[:, None] < times) & (errors[:, None] <= errors)
    beaten = np.any((quicker | finer) & finite[:, None], axis=0)
    return finite & ~beaten


def table(ds: xr.Dataset) -> str:
    """The dataset of the study as Markdown: what was measured, how, on what, and a table for each scene."""
    about = json.loads(ds.attrs["machine"])
    lines = [
        "# Speed against error",
        "",
        f"Machine: {about['processor']}, {about['cores']} cores, "
        + ", ".join(f"{name} {value}" for name, value in about.items() if name not in ("processor", "cores")),
        "",
        f"Reference: {ds.attrs['reference']}.",
        "",
        f"Settings: {ds.attrs['settings']}.",
        "",
        _READING,
    ]
    for scene in dict.fromkeys(ds["scene"].values.tolist()):
        lines += ["", f"## {scene}", "", *_scene(ds.isel(setting=ds["scene"].values == scene))]
    return "\n".join([*lines, ""])


def _scene(ds: xr.Dataset) -> list[str]:
    shown = [name for name in _MORE if np.isfinite(ds[f"{name}_error_worst"].values).any()]
    titles = [title for name, title in zip(_MORE, _TITLES, strict=True) if name in shown]
    header = [*_COLUMNS, *titles, "compile s", "remark"]
    lanes, floor = int(ds["lanes"].values[0]), float(ds["reference_spread"].values[0])
    numbers = [column in _COLUMNS[3:] or column in titles or column == "compile s" for column in header]
    return [
        f"{lanes} periodic lanes; two references differ by {_error(floor)}.",
        "",
        "| " + " | ".join(header) + " |",
        "|" + "|".join("---:" if number else "---" for number in numbers) + "|",
        *("| " + " | ".join(_row(ds.isel(setting=index), shown)) + " |" for index in range(ds.sizes["setting"])),
    ]


def _row(one: xr.Dataset, shown: list[str]) -> list[str]:
    time = 1e6 * float(one["time_per_lane_second"])
    spread = (float(one["time_per_lane_second_max"]) - float(one["time_per_lane_second_min"])) / 2e-6
    varied = str(one["varied"].item())
    setting = f"{varied} {float(one['value']):g}{_UNITS.get(varied, '')}"
    compiling = float(one["compile_time"])
    return [
        str(one["method"].item()),
        str(one["precision"].item()),
        f"**{setting}**" if one["on_front"].item() else setting,
        f"{time:.3g}" if np.isfinite(time) else "–",
        f"± {spread:.2g}" if np.isfinite(spread) else "–",
        *(_error(float(one[name])) for name in ("error_worst", "error_median")),
        *(_error(float(one[f"{name}_error_worst"])) for name in shown),
        f"{compiling:.1f}" if np.isfinite(compiling) else "–",
        str(one["remark"].item()),
    ]


def _error(value: float) -> str:
    return f"{value:.1e}" if np.isfinite(value) else "–"

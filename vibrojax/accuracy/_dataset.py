"""What came of the settings, as a labelled dataset."""

import json
from collections.abc import Callable
from datetime import UTC, datetime

import numpy as np
import xarray as xr

from vibrojax.accuracy._errors import ERRORS, RELATIVE, STATUSES
from vibrojax.accuracy._front import pareto
from vibrojax.accuracy._machine import machine
from vibrojax.accuracy._measure import Measured
from vibrojax.accuracy._settings import REFERENCE, SECOND_REFERENCE, SETTINGS_TEXT
from vibrojax.store.provenance import source

SETTING = "setting"
REFERENCE_TEXT = (
    f"the located method, float64, at a tolerance of {REFERENCE.tolerance:g} and a stride of {REFERENCE.stride:g}; "
    "reference_spread is what another one differs from it by "
    f"(tolerance {SECOND_REFERENCE.tolerance:g}, stride {SECOND_REFERENCE.stride:g})"
)
_OVERALL = "the larger of period and impact velocity; in penetration of the rate of penetration"


def dataset_of(measured: list[Measured], floors: dict[str, float], wall_time: float) -> xr.Dataset:
    """The dataset of the study; `floors`: what the reference is good to, by scene."""
    coordinates = {
        "scene": ([one.setting.scene for one in measured], "scene"),
        "method": ([one.setting.method for one in measured], "method"),
        "precision": ([one.setting.precision for one in measured], "precision"),
        "varied": ([one.setting.varied for one in measured], "what is varied"),
    }
    found = {name: (SETTING, np.array(x), _about("1", text)) for name, (x, text) in coordinates.items()}
    about = _about("1", "value of what is varied: tolerance and stride [1], width [m s-1], step [s]")
    found["value"] = (SETTING, np.array([one.setting.value for one in measured]), about)
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
    variables = _times(measured) | _errors(measured) | _outcomes(measured)
    floor = np.array([floors[one.setting.scene] for one in measured])
    text = "difference of two references, below which errors mean nothing"
    variables["reference_spread"] = (SETTING, floor, _about("1", text))
    ds = xr.Dataset(variables, found, attributes)
    about = _about("1", "no setting of the scene is faster and as exact") | _flags(("no", "yes"))
    return ds.assign(on_front=(SETTING, _front(ds), about))


def _about(units: str, long_name: str) -> dict:
    return {"units": units, "long_name": long_name}


def _flags(meanings: tuple[str, ...]) -> dict:
    return {"flag_values": np.arange(len(meanings), dtype=np.int8), "flag_meanings": " ".join(meanings)}


def _times(measured: list[Measured]) -> dict:
    def over_repeats(of: Callable, text: str):
        values = [of(one.seconds) if one.seconds else np.nan for one in measured]
        return SETTING, np.array(values, float), _about("s", f"{text} time per lane-second")

    per_second = np.array([one.steps for one in measured])
    return {
        "time_per_lane_second": over_repeats(np.median, "median"),
        "time_per_lane_second_min": over_repeats(min, "shortest"),
        "time_per_lane_second_max": over_repeats(max, "longest"),
        "repeats": (SETTING, np.array([len(one.seconds) for one in measured], np.int32), _about("1", "repeats")),
        "compile_time": (SETTING, np.array([one.compile_time for one in measured]), _about("s", "compile time")),
        "steps_per_second": (SETTING, per_second, _about("s-1", "steps of a lane per simulated second")),
    }


def _errors(measured: list[Measured]) -> dict:
    found = {}
    for name in ("overall", *ERRORS):
        known = [one.errors.get(name, np.zeros(0)) for one in measured]
        kind = _OVERALL if name == "overall" else name.replace("_", " ")
        relative = "relative error" if name in (*RELATIVE, "overall") else "error"
        for which, of in (("worst", np.max), ("median", np.median)):
            values = np.array([of(x) if x.size else np.nan for x in known], float)
            found[f"{'' if name == 'overall' else f'{name}_'}error_{which}"] = (
                SETTING,
                values,
                _about("1", f"{which} {relative} of {kind}"),
            )
    return found


def _outcomes(measured: list[Measured]) -> dict:
    status = np.array([STATUSES.index(one.status) for one in measured], np.int8)
    counts = {
        "lanes": "periodic lanes",
        "agreeing": "lanes that move like the reference, over which errors are told",
        "repeating": "lanes that also repeat as it does, to 1e-3",
    }
    found = {
        name: (SETTING, np.array([getattr(one, name) for one in measured], np.int32), _about("1", text))
        for name, text in counts.items()
    }
    about = _about("1", "what became of the setting")
    found["status"] = (SETTING, status, about | _flags(STATUSES))
    found["reason"] = (SETTING, np.array([one.reason for one in measured]), _about("1", "why lanes failed"))
    return found


def _front(ds: xr.Dataset) -> np.ndarray:
    """Which settings are on the front of their scene: of those whose lanes all agree with the reference."""
    error = np.where(ds["status"].values == 0, ds["error_worst"].values, np.nan)
    scenes = ds["scene"].values
    front = np.zeros(scenes.size, np.int8)
    for scene in np.unique(scenes):
        here = scenes == scene
        front[here] = pareto(ds["time_per_lane_second"].values[here], error[here])
    return front

"""Measurement of one setting: times of several runs, and errors of the lanes relative to the reference."""

import time
from collections.abc import Mapping
from functools import reduce
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from vibrojax.errors import counted
from vibrojax.studies.accuracy_cases import Setting
from vibrojax.studies.accuracy_programs import Outcome, Program

LONG_REPEATS = 0.6  # total run time [s] from which two runs suffice

RELATIVE = ("period", "impact_velocity", "peak_impact_force", "rate_of_penetration")
COMPARED = ("period", "impact_velocity", "peak_impact_force", "stick_fraction", "rate_of_penetration")
"""Features whose errors are measured: relative errors, but the absolute error of the stick fraction."""

OTHER_MOTION_ERROR = 0.5
"""Relative error from which a lane counts as another motion than the reference."""

TRUSTED_WITHIN = 1e-4
"""Relative difference of the two references up to which a lane is used for comparisons."""

STATUSES = ("done", "not-finite", "out-of-steps", "other-regime", "unsupported")

_FAILURES = {
    "not-finite": "did not stay finite",
    "out-of-steps": "did not reach the end within the steps allowed",
    "other-regime": "moved in another way than the reference",
}

LaneFeatures = Mapping[str, Shaped[np.ndarray, " lanes"]]
"""Features of lanes by name."""

Row = dict[str, Any]
"""The result of a setting: values of the dataset's variables by name; undefined variables are left out."""


def error_name(feature: str, statistic: str) -> str:
    """Return the name of the variable with a statistic of the lanes' errors, "worst" or "median"."""
    return f"error_{statistic}" if feature == "overall" else f"{feature}_error_{statistic}"


def measure(
    setting: Setting,
    program: Program,
    compile_time: float,
    reference: LaneFeatures,
    usable: Bool[np.ndarray, " lanes"],
    repeats: int,
) -> Row:
    """Run a setting up to `repeats` times, and compare its usable lanes with the reference.

    Two runs suffice if they take long, one if some lanes did not reach the end. Only lanes with the
    same motion as the reference have errors.
    """
    seconds: list[float] = []
    ran: Outcome = {}
    while len(seconds) < (repeats if sum(seconds) < LONG_REPEATS else 2):
        began = time.perf_counter()
        ran = program.run(setting.accuracy)
        seconds.append(time.perf_counter() - began)
        if not ran["finished"].all():
            break
    features = {name: x[usable] for name, x in program.features(setting.accuracy, ran).items()}
    expected = {name: x[usable] for name, x in reference.items()}
    errors = errors_of(features, expected)
    status = statuses_of(features, expected, errors)
    lanes, agrees = int(usable.sum()), status == 0
    repeating = agrees & (features["cycles"] == expected["cycles"]) if "cycles" in expected else agrees
    failures = {what: int((status == STATUSES.index(name)).sum()) for name, what in _FAILURES.items()}
    times = np.array(seconds) / program.lane_seconds
    row: Row = vars(setting) | {
        "time_per_lane_second": np.median(times),
        "time_per_lane_second_min": times.min(),
        "time_per_lane_second_max": times.max(),
        "repeats": len(seconds),
        "compile_time": compile_time,
        "steps_per_second": np.mean(ran["steps"]) / (program.lanes.settle + program.lanes.observe),
        "lanes": lanes,
        "agreeing": agrees.sum(),
        "repeating": repeating.sum(),
        "status": 0 if agrees.all() else status[~agrees].min(),
        "remark": "; ".join(f"{n} of {counted(lanes, 'lane')} {what}" for what, n in failures.items() if n),
    }
    for name, x in errors.items() if agrees.any() else ():
        row |= {error_name(name, "worst"): x[agrees].max(), error_name(name, "median"): np.median(x[agrees])}
    return row


def errors_of(features: LaneFeatures, reference: LaneFeatures) -> dict[str, Float[np.ndarray, " lanes"]]:
    """Return the errors of the features that the scene has, by name, and `overall`.

    `overall` is the larger error of period and impact velocity, or the error of the rate of penetration in scenes
    without them.
    """
    errors = {}
    for name in COMPARED:
        if name in reference and name in features:
            errors[name] = np.abs(features[name].astype(float) - reference[name])
            if name in RELATIVE:
                with np.errstate(divide="ignore", invalid="ignore"):
                    relative = errors[name] / np.abs(reference[name])
                errors[name] = np.where(errors[name] == 0, 0.0, relative)
    main = [errors[name] for name in ("period", "impact_velocity") if name in errors]
    return errors | {"overall": reduce(np.fmax, main or [errors["rate_of_penetration"]])}


def statuses_of(
    features: LaneFeatures, reference: LaneFeatures, errors: Mapping[str, Float[np.ndarray, " lanes"]]
) -> Int[np.ndarray, " lanes"]:
    """Return the status of each lane, an index into `STATUSES`.

    The regime counts as different if impacts per return differ by more than 5 %, or the overall error is a half or
    more. The motion need not be periodic to 1e-3: coarse steps cause more jitter, but the means still belong to the
    same motion.
    """
    other = ~(errors["overall"] < OTHER_MOTION_ERROR)
    if "impacts" in reference:
        per_return = [np.asarray(x["impacts"], float) / np.maximum(x["cycles"], 1) for x in (features, reference)]
        other |= ~(np.abs(per_return[0] - per_return[1]) <= 0.05 * np.maximum(per_return[1], 1))
    conditions = [~features["finite"], ~features["finished"], other]
    return np.select(conditions, [STATUSES.index(name) for name in STATUSES[1:4]], 0)


def usable(reference: LaneFeatures, second: LaneFeatures) -> Bool[np.ndarray, " lanes"]:
    """Return which lanes have a reliable reference: periodic, and equal to four digits in both references."""
    errors = errors_of(second, reference)
    alike = (statuses_of(second, reference, errors) == 0) & (errors["overall"] < TRUSTED_WITHIN)
    if "cycles" in reference:
        return alike & (reference["cycles"] > 0) & (reference["cycles"] == second["cycles"])
    return alike & (reference["rate_of_penetration"] > 0)

"""Measurement of one setting: times of several runs, and errors of the lanes relative to the reference."""

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import reduce

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from vibrojax.analyses.accuracy.cases import Setting
from vibrojax.analyses.accuracy.programs import Outcome, Program
from vibrojax.errors import counted

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


@dataclass(frozen=True)
class Measurement:
    """Result of a setting.

    - `seconds`: time of every run, per lane-second; `compile_time` [s] of the program; `steps` per lane-second.
    - `errors`: errors by feature, of the lanes with the same motion as the reference.
    - `lanes`: number of lanes; `agreeing`: number with the same motion as the reference; `repeating`: number that also
      have the same period in returns.
    - `status`: "done", or the first failure; `reason`: all failures in words.
    """

    setting: Setting
    status: str
    reason: str
    lanes: int
    compile_time: float = np.nan
    seconds: tuple[float, ...] = ()
    steps: float = np.nan
    agreeing: int = 0
    repeating: int = 0
    errors: dict[str, Float[np.ndarray, " agreeing"]] = field(default_factory=dict)


def measure(
    setting: Setting,
    program: Program,
    compile_time: float,
    reference: LaneFeatures,
    usable: Bool[np.ndarray, " lanes"],
    repeats: int,
) -> Measurement:
    """Run a setting up to `repeats` times, and compare its usable lanes with the reference.

    Two runs suffice if they take long, one if some lanes did not reach the end.
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
    counts = {name: int((status == STATUSES.index(name)).sum()) for name in _FAILURES}
    length = program.lanes.settle + program.lanes.observe
    return Measurement(
        setting,
        status="done" if agrees.all() else STATUSES[status[~agrees].min()],
        reason="; ".join(f"{n} of {counted(lanes, 'lane')} {_FAILURES[name]}" for name, n in counts.items() if n),
        lanes=lanes,
        compile_time=compile_time,
        seconds=tuple(x / program.lane_seconds for x in seconds),
        steps=float(np.mean(ran["steps"])) / length,
        agreeing=int(agrees.sum()),
        repeating=int(repeating.sum()),
        errors={name: x[agrees] for name, x in errors.items()},
    )


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

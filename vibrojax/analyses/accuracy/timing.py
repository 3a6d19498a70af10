"""One setting: its time over a few runs, and the errors of its lanes against the reference."""

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import reduce

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from vibrojax.analyses.accuracy.cases import NO_ROCK, SOLVERS, Setting
from vibrojax.analyses.accuracy.programs import Program, Ran
from vibrojax.stepping import Accuracy

LONG = 0.6  # s of repeats, from which on two are enough

RELATIVE = ("period", "impact_velocity", "peak_impact_force", "rate_of_penetration")
ERRORS = ("period", "impact_velocity", "peak_impact_force", "stick_fraction", "rate_of_penetration")
"""What has errors: relative ones; of the stick fraction (a share already) the difference."""

ANOTHER = 0.5
"""A relative error from which on a lane is taken to move in another way than the reference."""

STATUSES = ("done", "not-finite", "out-of-steps", "other-regime", "unsupported")

_WORDS = {
    "not-finite": "did not stay finite",
    "out-of-steps": "did not reach the end within the steps allowed",
    "other-regime": "moved in another way than the reference",
}

OfLanes = Mapping[str, Shaped[np.ndarray, " lanes"]]
"""Features of some lanes, by name."""


@dataclass(frozen=True)
class Measured:
    """What came of a setting.

    - `seconds`: of every repeat, per lane-second; `compile_time` [s] of its program; `steps` per lane-second.
    - `errors`: (lanes that move like the reference,) by name; `lanes`: how many there are, `agreeing`, `repeating`.
    - `status`: "done", or what went wrong first; `reason`: in words.
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


def is_supported(setting: Setting) -> bool:
    """Whether the method has the scene's equations."""
    return setting.method not in SOLVERS or setting.scene in NO_ROCK


def unsupported(setting: Setting, lanes: int) -> Measured:
    """What is said of a method that cannot run the scene."""
    reason = "plain integration knows no rock that yields: its ratchet needs events"
    return Measured(setting, "unsupported", reason, lanes)


def measure(
    setting: Setting,
    program: Program,
    compile_time: float,
    reference: OfLanes,
    usable: Bool[np.ndarray, " lanes"],
    repeats: int,
) -> Measured:
    """Run `setting` up to so many `repeats`, and compare the lanes that are `usable` with the `reference`."""
    ran, seconds = _timed(program, setting.accuracy, repeats)
    features = {name: x[usable] for name, x in program.features(setting.accuracy, ran).items()}
    expected = {name: x[usable] for name, x in reference.items()}
    errors = errors_of(features, expected)
    status = statuses_of(features, expected, errors)
    lanes, agrees = int(usable.sum()), status == 0
    repeating = agrees & (features["cycles"] == expected["cycles"]) if "cycles" in expected else agrees
    length = program.lanes.settle + program.lanes.observe
    return Measured(
        setting,
        status="done" if agrees.all() else STATUSES[status[~agrees].min()],
        reason="" if agrees.all() else _reason(status, lanes),
        lanes=lanes,
        compile_time=compile_time,
        seconds=tuple(one / program.lane_seconds for one in seconds),
        steps=float(np.mean(ran["steps"])) / length,
        agreeing=int(agrees.sum()),
        repeating=int(repeating.sum()),
        errors={name: x[agrees] for name, x in errors.items()},
    )


def _timed(program: Program, accuracy: Accuracy, repeats: int) -> tuple[Ran, list[float]]:
    """What a run gave, and the seconds of every repeat: two of long ones, one where lanes did not get to the end."""
    seconds: list[float] = []
    ran: Ran = {}
    while len(seconds) < (repeats if sum(seconds) < LONG else 2):
        began = time.perf_counter()
        ran = program.run(accuracy)
        seconds.append(time.perf_counter() - began)
        if not ran["finished"].all():
            break
    return ran, seconds


def _reason(status: Int[np.ndarray, " lanes"], lanes: int) -> str:
    """How many lanes failed in which way."""
    counts = {name: int((status == index).sum()) for index, name in enumerate(STATUSES)}
    return "; ".join(f"{counts[name]} of {lanes} lanes {words}" for name, words in _WORDS.items() if counts[name])


def errors_of(features: OfLanes, reference: OfLanes) -> dict[str, Float[np.ndarray, " lanes"]]:
    """Errors of what the scene has, by name, and `overall`.

    That is the larger of period's and impact velocity's; in penetration that of the rate of penetration.
    """
    errors = {}
    for name in ERRORS:
        if name not in reference or name not in features:
            continue
        difference = np.abs(features[name].astype(float) - reference[name])
        errors[name] = _over(difference, np.abs(reference[name])) if name in RELATIVE else difference
    main = [errors[name] for name in ("period", "impact_velocity") if name in errors]
    return errors | {"overall": reduce(np.fmax, main or [errors["rate_of_penetration"]])}


def statuses_of(
    features: OfLanes, reference: OfLanes, errors: Mapping[str, Float[np.ndarray, " lanes"]]
) -> Int[np.ndarray, " lanes"]:
    """What became of each lane, indices into `STATUSES`.

    Another regime: impacts per return differ by over 5 %, or an error is a half or more. Whether the motion repeats to
    1e-3 is not asked: coarse steps jitter by more, and their means are still of the same motion.
    """
    other = ~(errors["overall"] < ANOTHER)
    if "impacts" in reference:
        expected = _per_return(reference)
        other |= ~(np.abs(_per_return(features) - expected) <= 0.05 * np.maximum(expected, 1))
    conditions = [~features["finite"], ~features["finished"], other]
    return np.select(conditions, [STATUSES.index(name) for name in STATUSES[1:4]], 0)


def usable(reference: OfLanes, second: OfLanes) -> Bool[np.ndarray, " lanes"]:
    """Which lanes the reference can be trusted on: periodic ones, to four digits at least, that both find alike."""
    errors = errors_of(second, reference)
    alike = (statuses_of(second, reference, errors) == 0) & (errors["overall"] < 1e-4)
    if "cycles" in reference:
        return alike & (reference["cycles"] > 0) & (reference["cycles"] == second["cycles"])
    return alike & (reference["rate_of_penetration"] > 0)


def _per_return(features: OfLanes) -> Float[np.ndarray, " lanes"]:
    return np.asarray(features["impacts"], float) / np.maximum(features["cycles"], 1)


def _over(difference: Float[np.ndarray, " lanes"], scale: Float[np.ndarray, " lanes"]) -> Float[np.ndarray, " lanes"]:
    """The quotient; 0 where both are zero, infinite where only the scale is."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(difference == 0, 0.0, difference / scale)

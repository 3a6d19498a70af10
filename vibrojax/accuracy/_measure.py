"""One setting: run it a few times, and tell its time and its errors."""

import time
from dataclasses import dataclass, field

import numpy as np

from vibrojax.accuracy._diffrax import Diffrax
from vibrojax.accuracy._errors import STATUSES, errors_of, statuses_of
from vibrojax.accuracy._lanes import Lanes
from vibrojax.accuracy._programs import Own, Program
from vibrojax.accuracy._settings import NO_ROCK, SOLVERS, Setting
from vibrojax.sweep import Accuracy

LONG = 0.6  # s of repeats, from which on two are enough


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
    errors: dict[str, np.ndarray] = field(default_factory=dict)


class Programs:
    """The programs of one scene's lanes, each compiled once, and how long [s] that took."""

    def __init__(self, lanes: Lanes):
        self._lanes = lanes
        self._compiled: dict[tuple[str, str], tuple[Program, float]] = {}

    def of(self, method: str, precision: str, accuracy: Accuracy) -> tuple[Program, float]:
        """The program of a method in a precision, and its compile time; `accuracy` only fills in its numbers."""
        if (method, precision) not in self._compiled:
            program = (Diffrax if method in SOLVERS else Own)(self._lanes, method, precision)
            began = time.perf_counter()
            program.compile(accuracy)
            self._compiled[method, precision] = program, time.perf_counter() - began
        return self._compiled[method, precision]


def is_supported(setting: Setting) -> bool:
    """Whether the method has the scene's equations."""
    return setting.method not in SOLVERS or setting.scene in NO_ROCK


def unsupported(setting: Setting, lanes: int) -> Measured:
    """What is told of a method that cannot run the scene."""
    reason = "plain integration knows no rock that yields: its ratchet needs events"
    return Measured(setting, "unsupported", reason, lanes)


def measure(setting: Setting, program: Program, compile_time: float, reference: dict, usable, repeats: int) -> Measured:
    """Run `setting` up to so many `repeats`, and compare the lanes that are `usable` with the `reference`."""
    ran, seconds = _timed(program, setting.accuracy, repeats)
    features = program.features(setting.accuracy, ran)
    features = {name: x[usable] for name, x in features.items()}
    expected = {name: x[usable] for name, x in reference.items()}
    errors = errors_of(features, expected)
    status = statuses_of(features, expected, errors)
    lanes = int(usable.sum())
    good = status == 0
    worst = STATUSES[status[~good].min()] if not good.all() else "done"
    length = program.lanes.settle + program.lanes.observe
    return Measured(
        setting,
        worst,
        "" if good.all() else _reason(status, lanes),
        lanes,
        compile_time,
        tuple(one / program.lane_seconds for one in seconds),
        float(np.mean(ran["steps"])) / length,
        int(good.sum()),
        int((good & (features["cycles"] == expected["cycles"])).sum()) if "cycles" in expected else int(good.sum()),
        {name: x[good] for name, x in errors.items()},
    )


def _timed(program: Program, accuracy: Accuracy, repeats: int) -> tuple[dict, list[float]]:
    """What a run gave, and the seconds of every repeat: two of long ones, one where lanes did not get to the end."""
    seconds: list[float] = []
    ran: dict = {}
    while len(seconds) < (repeats if sum(seconds) < LONG else 2):
        began = time.perf_counter()
        ran = program.run(accuracy)
        seconds.append(time.perf_counter() - began)
        if not ran["finished"].all():
            break
    return ran, seconds


_WORDS = {
    "not-finite": "did not stay finite",
    "out-of-steps": "did not reach the end within the steps allowed",
    "other-regime": "moved in another way than the reference",
}


def _reason(status: np.ndarray, lanes: int) -> str:
    """How many lanes failed in which way."""
    counts = {name: int((status == index).sum()) for index, name in enumerate(STATUSES)}
    return "; ".join(f"{counts[name]} of {lanes} lanes {words}" for name, words in _WORDS.items() if counts[name])

"""Settings of a run: the table [run] of a sweep file."""

from dataclasses import dataclass, fields
from typing import Any

from vibrojax.errors import Place, shown
from vibrojax.models.physics.parameters import not_negative, positive, table
from vibrojax.models.scenes import Scene
from vibrojax.stepping import STEPPERS, Accuracy, AccuracyRequest, Located, Stepper, stepper_named
from vibrojax.sweep.input.values import choice, count, flag, known_keys, quantity

MEANINGS = {
    "settle": "time before the observation [s]",
    "observe": "time of the observation [s]",
    "error": "accepted error_estimate of a lane that repeats; the steps follow from it",
    "end_early": "whether a settled lane may stop before its time",
    "keep_returns": "number of last returns to store",
    "orbits": "whether to find the periodic orbits of lanes that repeat, with multipliers",
    "carry": "axis along which lanes run one after another, up and down, each from the end of the previous one",
    "lyapunov": "whether to find the largest Lyapunov exponents of lanes, and the natures of those that do not repeat",
    "method": "stepping method: located or smoothed",
    "step": "length of the steps [s]; left out, it follows from error",
    "smoothing": "width of the friction switch of the smoothed method [m/s]; left out, it follows from error",
    "precision": "float64 or float32",
    "chunk": "lanes computed together and stored as one; left out, the program decides",
}
"""Meanings of the keys of [run]."""


@dataclass(frozen=True)
class RunSettings:
    """The table [run] of a sweep file. `MEANINGS` describes the keys."""

    settle: float = 40.0
    observe: float = 8.0
    error: float = 1e-4
    end_early: bool = True
    keep_returns: int = 0
    orbits: bool = False
    lyapunov: bool = False
    carry: str | None = None
    method: str | Stepper = "located"
    step: float | None = None
    smoothing: float | None = None
    precision: str = "float64"
    chunk: int | None = None

    @property
    def stepper(self) -> Stepper:
        """The stepper that `method` selects."""
        return stepper_named(self.method)

    def described(self) -> dict[str, object]:
        """Return the settings, including defaults, as JSON values.

        The chunk size is omitted because it does not change results. Keys that earlier versions did not have are
        omitted if they have their default, so that datasets of these versions keep their identity.
        """
        later: dict[str, object] = {"orbits": False, "lyapunov": False, "carry": None}
        settings = {name: value for name, value in vars(self).items() if name != "chunk"}
        settings = {name: value for name, value in settings.items() if name not in later or value != later[name]}
        return settings | {"method": self.stepper.name}

    def accuracy(self, scene: Scene[Any]) -> Accuracy:
        """Return the accuracy of the steps in `scene`: as specified, or else derived from the accepted error."""
        return self.stepper.accuracy(AccuracyRequest(self.error, self.step, self.smoothing, self.precision), scene)


_QUANTITIES = table(
    not_negative("settle", 40.0, "s", "time before the observation", "t"),
    positive("observe", 8.0, "s", "time of the observation", "t"),
    positive("error", 1e-4, "1", "accepted relative error", "e"),
    positive("step", 1e-3, "s", "time step", "h"),
    positive("smoothing", 1e-3, "m s-1", "width of the smoothed friction switch", "w"),
)


def read_settings(place: Place, values: dict[str, object]) -> RunSettings:
    """Return the validated table [run], which is at `place`, completed with defaults."""
    known_keys(place, values, [field.name for field in fields(RunSettings)])
    checked: dict[str, Any] = {name: _read_setting(place.at(name), name, value) for name, value in values.items()}
    settings = RunSettings(**checked)
    unused = f"has no use with method {shown(settings.stepper.name)}"
    if settings.smoothing is not None and not settings.stepper.smooths:
        raise place.at("smoothing").error(f'{settings.smoothing:g} {unused}; leave it out, or set method = "smoothed"')
    for name in ("orbits", "lyapunov"):
        if getattr(settings, name) and not isinstance(settings.stepper, Located):
            raise place.at(name).error(
                f'true {unused}, whose events are not located; leave it out, or set method = "located"'
            )
    return settings


def _read_setting(place: Place, name: str, value: object) -> object:
    """Return the validated value of a key of [run]."""
    match name:
        case "keep_returns":
            return count(place, value, 0, most=2**31 - 1)
        case "chunk":
            return count(place, value, 1, most=2**31 - 1)
        case "method":
            return value if isinstance(value, Stepper) else choice(place, value, tuple(STEPPERS))
        case "precision":
            return choice(place, value, ("float64", "float32"))
        case "carry":
            if not isinstance(value, str):
                raise place.error(f'{shown(value)} is not a name; write that of an axis of [grid], like "gamma"')
            return value
    if name not in _QUANTITIES:
        return flag(place, value)
    checked = quantity(place, value, _QUANTITIES[name])
    if name == "error" and checked >= 1:
        raise place.error(f"is {checked:g}; it must be below 1")
    return checked

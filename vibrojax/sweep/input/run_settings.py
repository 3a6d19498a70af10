"""How a sweep is run: the table [run]."""

from collections.abc import Collection
from dataclasses import dataclass, fields
from typing import Any

from vibrojax.errors import Place, shown
from vibrojax.models.physics.parameters import Parameter, not_negative, positive, table
from vibrojax.models.scenes import Scene
from vibrojax.stepping import STEPPERS, Accuracy, Located, Stepper, Wanted, stepper_named
from vibrojax.sweep.input.values import choice, count, known_keys, quantity

PRECISIONS = ("float64", "float32")


MEANINGS = {
    "settle": "time before anything is observed [s]",
    "observe": "time of the observation [s]",
    "error": "accepted error_estimate of a lane that repeats; the steps follow from it",
    "end_early": "whether a lane that has settled may stop before its time",
    "keep_returns": "how many of the last returns to store",
    "orbits": "whether to find the periodic orbits of lanes that repeat, with multipliers",
    "carry": "an axis along which lanes run one after another, each from where the last one ended, up and down",
    "lyapunov": "whether to find the greatest Lyapunov exponents of lanes, and the natures of those that do not repeat",
    "method": "how to step: located or smoothed",
    "step": "length of the steps [s]; left out, it follows from error",
    "smoothing": "width of the friction switch of the smoothed method [m/s]; left out, it follows from error",
    "precision": "float64 or float32",
    "chunk": "lanes computed together and kept on disk as one; left out, the program decides",
}
"""What the keys of [run] mean."""


@dataclass(frozen=True)
class RunSettings:
    """The table [run] of a sweep file; what each key means is in `MEANINGS`."""

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
        """The stepper itself."""
        return stepper_named(self.method)

    def described(self) -> dict[str, object]:
        """What is set, with defaults, as JSON values; the chunk is no part of it."""
        given = {name: value for name, value in vars(self).items() if name != "chunk"}
        # As it was before there were any.
        given = {name: value for name, value in given.items() if name not in _LATER or value != _LATER[name]}
        return given | {"method": self.stepper.name}

    def accuracy(self, scene: Scene[Any]) -> Accuracy:
        """Steps that keep the accepted error in `scene`, unless the user chose them."""
        wanted = Wanted(self.error, self.step, self.smoothing, self.precision)
        return self.stepper.accuracy(wanted, scene)


_QUANTITIES: dict[str, Parameter] = table(
    not_negative("settle", 40.0, "s", "time before the observation", "t"),
    positive("observe", 8.0, "s", "time of the observation", "t"),
    positive("error", 1e-4, "1", "accepted relative error", "e"),
    positive("step", 1e-3, "s", "time step", "h"),
    positive("smoothing", 1e-3, "m s-1", "width of the smoothed friction switch", "w"),
)
_COUNTS = {"keep_returns": 0, "chunk": 1}
_LATER: dict[str, object] = {"orbits": False, "lyapunov": False, "carry": None}
_CHOICES: dict[str, Collection[str]] = {"method": STEPPERS, "precision": PRECISIONS}


def read_setting(place: Place, name: str, value: object) -> object:
    """The value of one key of [run], checked."""
    if name in _COUNTS:
        return count(place, value, _COUNTS[name], most=2**31 - 1)
    if name == "method" and isinstance(value, Stepper):
        return value
    if name in _CHOICES:
        return choice(place, value, tuple(_CHOICES[name]))
    if name in _QUANTITIES:
        checked = quantity(place, value, _QUANTITIES[name])
        if name == "error" and checked >= 1:
            raise place.error(f"is {checked:g}; it must be below 1")
        return checked
    if name == "carry":
        if not isinstance(value, str):
            raise place.error(f'{shown(value)} is not a name; write that of an axis of [grid], like "gamma"')
        return value
    if not isinstance(value, bool):
        raise place.error(f"{shown(value)} is neither true nor false; write one of them")
    return value


def read_settings(place: Place, given: dict[str, object]) -> RunSettings:
    """The table [run], checked and complete; `place` is where the table stands."""
    known_keys(place, given, [field.name for field in fields(RunSettings)])
    checked: dict[str, Any] = {name: read_setting(place.at(name), name, value) for name, value in given.items()}
    settings = RunSettings(**checked)
    if settings.smoothing is not None and not settings.stepper.smooths:
        raise place.at("smoothing").error(
            f"{settings.smoothing:g} has no use with method {shown(settings.stepper.name)}; "
            'leave it out, or set method = "smoothed"'
        )
    for name in ("orbits", "lyapunov"):
        if getattr(settings, name) and not isinstance(settings.stepper, Located):
            raise place.at(name).error(
                f"true has no use with method {shown(settings.stepper.name)}, whose events are not located; "
                'leave it out, or set method = "located"'
            )
    return settings

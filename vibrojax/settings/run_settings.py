"""Settings of a run: the table [run] of a sweep file."""

from collections.abc import Callable
from dataclasses import dataclass, field, fields
from functools import partial
from typing import Any

from vibrojax.errors import Place, shown
from vibrojax.physics.parameters import Parameter
from vibrojax.scenes import Scene
from vibrojax.settings.values import choice, count, flag, known_keys, quantity
from vibrojax.stepping import STEPPERS, Accuracy, AccuracyRequest, Located, Stepper, stepper_named


def _read_method(place: Place, value: object) -> str | Stepper:
    return value if isinstance(value, Stepper) else choice(place, value, tuple(STEPPERS))


def _read_carry(place: Place, value: object) -> str:
    if not isinstance(value, str):
        raise place.error(f'{shown(value)} is not a name; write that of an axis of [grid], like "gamma"')
    return value


def _number(unit: str, below: float | None = None, zero: bool = False) -> Callable[[Place, object], float]:
    """Return a reader of a positive number, or of zero as well, less than `below`."""
    limits = Parameter("", 0.0, unit, "", "", lowest=0.0, open_below=not zero, below=below)
    return partial(quantity, parameter=limits)


def _key(default: Any, meaning: str, read: Callable[[Place, Any], Any]) -> Any:
    """Declare a key of [run]; `read` validates its value at a place."""
    return field(default=default, metadata={"meaning": meaning, "read": read})


@dataclass(frozen=True)
class RunSettings:
    """The table [run] of a sweep file. `MEANINGS` describes the keys."""

    settle: float = _key(40.0, "time before the observation [s]", _number("s", zero=True))
    observe: float = _key(8.0, "time of the observation [s]", _number("s"))
    error: float = _key(
        1e-4, "accepted error_estimate of a lane that repeats; the steps follow from it", _number("1", below=1.0)
    )
    end_early: bool = _key(True, "whether a settled lane may stop before its time", flag)
    keep_returns: int = _key(0, "number of last returns to store", partial(count, least=0, most=2**31 - 1))
    orbits: bool = _key(False, "whether to find the periodic orbits of lanes that repeat, with multipliers", flag)
    lyapunov: bool = _key(
        False,
        "whether to find the largest Lyapunov exponents of lanes, and the natures of those that do not repeat",
        flag,
    )
    carry: str | None = _key(
        None,
        "axis along which lanes run one after another, up and down, each from the end of the previous one",
        _read_carry,
    )
    method: str | Stepper = _key("located", "stepping method: located or smoothed", _read_method)  # noqa: RUF009
    step: float | None = _key(None, "length of the steps [s]; left out, it follows from error", _number("s"))
    smoothing: float | None = _key(
        None,
        "width of the friction switch of the smoothed method [m/s]; left out, it follows from error",
        _number("m s-1"),
    )
    precision: str = _key("float64", "float64 or float32", partial(choice, choices=("float64", "float32")))
    chunk: int | None = _key(
        None,
        "lanes computed together and stored as one; left out, the program decides",
        partial(count, least=1, most=2**31 - 1),
    )

    @property
    def stepper(self) -> Stepper:
        return stepper_named(self.method)

    @property
    def requested(self) -> AccuracyRequest:
        return AccuracyRequest(self.error, self.step, self.smoothing, self.precision)

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
        return self.stepper.accuracy(self.requested, scene)


MEANINGS: dict[str, str] = {field.name: field.metadata["meaning"] for field in fields(RunSettings)}
"""Meanings of the keys of [run]."""


def read_settings(place: Place, values: dict[str, object], scene: Scene[Any]) -> RunSettings:
    """Return the validated table [run], which is at `place`, completed with defaults, some of which the scene sets."""
    known_keys(place, values, MEANINGS)
    keys = RunSettings.__dataclass_fields__
    values = dict(zip(("settle", "observe"), scene.usual_times, strict=True)) | values
    settings = RunSettings(**{name: keys[name].metadata["read"](place.at(name), x) for name, x in values.items()})
    unused = f"has no use with method {shown(settings.stepper.name)}"
    if settings.smoothing is not None and not settings.stepper.smooths:
        raise place.at("smoothing").error(f'{settings.smoothing:g} {unused}; leave it out, or set method = "smoothed"')
    for name in ("orbits", "lyapunov"):
        if getattr(settings, name) and not isinstance(settings.stepper, Located):
            raise place.at(name).error(
                f'true {unused}, whose events are not located; leave it out, or set method = "located"'
            )
    requested = settings.requested
    check_error(place.at("error"), settings.stepper.name, requested, settings.stepper.least_error(requested))
    return settings


def check_error(place: Place, method: str, wanted: AccuracyRequest, least: float) -> None:
    """Raise at `place` if the error tolerance in `wanted` is below `least`, the least that lanes of `method` meet."""
    if wanted.error < least * (1 - 1e-9):
        smallest = f"{1.005 * least:.2g}"  # rounded up
        reach = f"method {shown(method)} reaches {smallest} in {wanted.precision}"
        raise place.error(f"{wanted.error:g} cannot be reached; {reach}: give {smallest} or more")

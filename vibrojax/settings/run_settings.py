"""Settings of a run: the table [run] of a sweep file."""

from dataclasses import dataclass
from typing import Any

from vibrojax.errors import Place, shown
from vibrojax.scenes import Scene
from vibrojax.settings.fields import Settings, setting
from vibrojax.settings.values import choice
from vibrojax.stepping import STEPPERS, Accuracy, AccuracyRequest, Located, Stepper, stepper_named
from vibrojax.stepping.located import HIGH_ORDER, HIGH_ORDER_ERROR


def _read_method(place: Place, value: object) -> str | Stepper:
    return value if isinstance(value, Stepper) else choice(place, value, tuple(STEPPERS))


def _read_carry(place: Place, value: object) -> str:
    if not isinstance(value, str):
        raise place.error(f'{shown(value)} is not a name; write that of an axis of [grid], like "gamma"')
    return value


@dataclass(frozen=True, kw_only=True)
class RunSettings(Settings):
    """The table [run] of a sweep file."""

    settle: float = setting(40.0, "simulated time before the observation [s]", unit="s", least=0.0)
    observe: float = setting(8.0, "duration of the observation [s]", unit="s", above=0.0)
    error: float = setting(
        1e-4, "accepted error_estimate of a periodic lane; it determines the length of the steps", above=0.0, below=1.0
    )
    end_early: bool = setting(True, "whether a lane may end early once it has settled")
    keep_returns: int = setting(0, "number of section crossings to store, counted from the end", least=0)
    orbits: bool = setting(False, "whether to compute the orbits of periodic lanes and their multipliers", later=True)
    lyapunov: bool = setting(
        False,
        "whether to compute the largest Lyapunov exponent of each lane, and classify its motion by it",
        later=True,
    )
    carry: str | None = setting(
        None,
        "axis along which lanes run in order, up and then down; each starts in the final state of the previous lane",
        read=_read_carry,
        later=True,
    )
    method: str | Stepper = setting("located", "stepping method: located or smoothed", read=_read_method)
    step: float | None = setting(
        None, "length of the steps [s]; by default it is derived from the setting error", unit="s", above=0.0
    )
    smoothing: float | None = setting(
        None,
        "range of velocities [m/s] over which the smoothed method spreads the jump of friction; by default it is "
        "derived from the setting error",
        unit="m s-1",
        above=0.0,
    )
    precision: str = setting("float64", "type of numbers: float64 or float32", choices=("float64", "float32"))
    chunk: int | None = setting(
        None,
        "number of lanes that are computed and stored together; by default the program chooses it",
        least=1,
        results=False,
    )

    @property
    def stepper(self) -> Stepper:
        """The stepper; the order of the one that is called located follows from the accepted error."""
        high = self.method == Located.name and self.error <= HIGH_ORDER_ERROR
        return Located(HIGH_ORDER) if high else stepper_named(self.method)

    @property
    def requested(self) -> AccuracyRequest:
        return AccuracyRequest(self.error, self.step, self.smoothing, self.precision)

    def described(self) -> dict[str, object]:
        return super().described() | {"method": self.stepper.name}

    def accuracy(self, scene: Scene[Any]) -> Accuracy:
        """Return the accuracy of the steps in `scene`: as specified, or else derived from the accepted error."""
        return self.stepper.accuracy(self.requested, scene)


def read_settings(place: Place, values: dict[str, object], scene: Scene[Any]) -> RunSettings:
    """Return the validated table [run], which is at `place`, completed with defaults, some of which the scene sets."""
    settings = RunSettings.read(place, dict(zip(("settle", "observe"), scene.usual_times, strict=True)) | values)
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


def check_error(place: Place, method: str, request: AccuracyRequest, least: float) -> None:
    """Raise at `place` if the error tolerance in `request` is below `least`, the least that lanes of `method` meet."""
    if request.error < least * (1 - 1e-9):
        smallest = f"{1.005 * least:.2g}"  # rounded up
        reach = f"method {shown(method)} reaches {smallest} in {request.precision}"
        raise place.error(f"{request.error:g} cannot be reached; {reach}: give {smallest} or more")

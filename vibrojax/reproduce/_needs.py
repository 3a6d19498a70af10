"""What entries and pictures ask to be computed, told apart by value, so that each is computed once."""

from dataclasses import dataclass

SETTLE, OBSERVE = 40.0, 8.0
STARTS = {"rotary": ("drive", "stuck"), "penetration": ()}
"""The starts that every lane of a scene runs from; all three where it is not said."""
ALL_STARTS = ("drive", "stuck", "touching")


@dataclass(frozen=True)
class Lane:
    """The features of one point of a scene, from one start.

    `parameters`: pairs of names and values, of numbers and of what is chosen by name; see `lane`.
    """

    scene: str
    parameters: tuple[tuple[str, float | str], ...]
    start: str
    settle: float
    observe: float


@dataclass(frozen=True)
class Motion:
    """The motion of one point in time, over `duration` [s], sampled every `sampling` [s] (None: as `simulate` does)."""

    scene: str
    parameters: tuple[tuple[str, float | str], ...]
    start: str | tuple[float, ...]
    duration: float
    sampling: float | None


@dataclass(frozen=True)
class Map:
    """A grid of lanes: `axes` are pairs of names and values."""

    name: str
    scene: str
    parameters: tuple[tuple[str, float | str], ...]
    axes: tuple[tuple[str, tuple[float, ...]], ...]
    starts: tuple[str, ...]
    settle: float
    observe: float


@dataclass(frozen=True)
class StruckMass:
    """The impacts of a mass on a stop (see [vibrojax.reproduce._struck][]) from (x, x') over `duration` [s]."""

    start: tuple[float, float]
    duration: float
    parameters: tuple[tuple[str, float], ...]


def lane(scene: str, start: str = "drive", settle: float = SETTLE, observe: float = OBSERVE, **parameters) -> Lane:
    """A `Lane` by keywords; what is left out has the scene's default."""
    return Lane(scene, tuple(sorted(parameters.items())), start, settle, observe)


def motion(scene: str, duration: float, start="drive", sampling: float | None = None, **parameters) -> Motion:
    """A `Motion` by keywords."""
    return Motion(scene, tuple(sorted(parameters.items())), start, duration, sampling)


def grid(name: str, scene: str, axes: dict, starts=(), settle=SETTLE, observe=OBSERVE, **parameters) -> Map:
    """A `Map` by keywords."""
    values = tuple((axis, tuple(float(x) for x in axes[axis])) for axis in axes)
    return Map(name, scene, tuple(sorted(parameters.items())), values, tuple(starts), settle, observe)


def struck(start: tuple[float, float], duration: float, **parameters) -> StruckMass:
    """A `StruckMass` by keywords."""
    return StruckMass(start, duration, tuple(sorted(parameters.items())))


def starts_of(scene: str) -> tuple[str, ...]:
    """The starts that lanes of a scene are run from, all together: one compiled program, and how much they matter."""
    return STARTS.get(scene, ALL_STARTS)

"""What entries and pictures ask to be computed, compared by value, so that each is computed once; and the answers."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
import xarray as xr

from vibrojax.reproduce.struck_mass import Blows

SETTLE, OBSERVE = 40.0, 8.0
STARTS = {"rotary": ("drive", "stuck"), "penetration": ()}
"""The starts that every lane of a scene runs from; all three where it is not said."""
ALL_STARTS = ("drive", "stuck", "touching")

Parameters = tuple[tuple[str, float | str], ...]
"""Pairs of names and values, of numbers and of what is chosen by name, such as a friction law; sorted by name."""

Shared = Mapping[str, float | str]
"""Parameters that several needs have in common."""


@dataclass(frozen=True)
class Lane:
    """The features of one point of a scene, from one start; see `lane`. Answered by `Features`."""

    scene: str
    parameters: Parameters
    start: str
    settle: float
    observe: float


@dataclass(frozen=True)
class Motion:
    """The motion of one point in time, over `duration` [s], sampled every `sampling` [s] (None: as `simulate` does).

    Answered by the dataset of `simulate`.
    """

    scene: str
    parameters: Parameters
    start: str | tuple[float, ...]
    duration: float
    sampling: float | None


@dataclass(frozen=True)
class Map:
    """A grid of lanes: `axes` are pairs of names and values. Answered by the dataset of `run_sweep`."""

    name: str
    scene: str
    parameters: Parameters
    axes: tuple[tuple[str, tuple[float, ...]], ...]
    starts: tuple[str, ...]
    settle: float
    observe: float


@dataclass(frozen=True)
class StruckMass:
    """The impacts of a mass on a stop (see [vibrojax.reproduce.struck_mass][]) from (x, x') over `duration` [s].

    Answered by `Blows`.
    """

    start: tuple[float, float]
    duration: float
    parameters: tuple[tuple[str, float], ...]


class Features:
    """The features of one lane, by name, in SI units."""

    def __init__(self, dataset: xr.Dataset) -> None:
        self._dataset = dataset

    def __getitem__(self, name: str) -> float:
        return float(self._dataset[name])

    @property
    def regime(self) -> str:
        """The regime's name."""
        return self._dataset["regime"].attrs["flag_meanings"].split()[int(self["regime"])]

    @property
    def frequency(self) -> float:
        """1/period [Hz]."""
        return 1 / self["period"]

    @property
    def angular_frequency(self) -> float:
        """2 pi/period [rad/s]."""
        return 2 * np.pi / self["period"]


@dataclass(frozen=True)
class Unanswered:
    """What takes the place of an answer that could not be computed, and why."""

    why: str


Need = Lane | Motion | Map | StruckMass
Answer = Features | xr.Dataset | Blows | Unanswered


def lane(
    scene: str,
    *shared: Shared,
    start: str = "drive",
    settle: float = SETTLE,
    observe: float = OBSERVE,
    **parameters: float | str,
) -> Lane:
    """A `Lane` by parameters, `shared` ones and keywords; what is left out has the scene's default."""
    return Lane(scene, _together(shared, parameters), start, settle, observe)


def motion(
    scene: str,
    duration: float,
    *shared: Shared,
    start: str | tuple[float, ...] = "drive",
    sampling: float | None = None,
    **parameters: float | str,
) -> Motion:
    """A `Motion` by parameters."""
    return Motion(scene, _together(shared, parameters), start, duration, sampling)


def grid(
    name: str,
    scene: str,
    axes: Mapping[str, Iterable[float]],
    *shared: Shared,
    starts: tuple[str, ...] = (),
    settle: float = SETTLE,
    observe: float = OBSERVE,
    **parameters: float | str,
) -> Map:
    """A `Map` by parameters."""
    values = tuple((axis, tuple(float(x) for x in axes[axis])) for axis in axes)
    return Map(name, scene, _together(shared, parameters), values, starts, settle, observe)


def _together(shared: tuple[Shared, ...], parameters: Shared) -> Parameters:
    together: dict[str, float | str] = {}
    for some in (*shared, parameters):  # the later ones count
        together |= some
    return tuple(sorted(together.items()))


def struck(start: tuple[float, float], duration: float, **parameters: float) -> StruckMass:
    """A `StruckMass` by keywords."""
    return StruckMass(start, duration, tuple(sorted(parameters.items())))


def starts_of(scene: str) -> tuple[str, ...]:
    """The starts that lanes of a scene are run from, all together: one compiled program, and how much they matter."""
    return STARTS.get(scene, ALL_STARTS)

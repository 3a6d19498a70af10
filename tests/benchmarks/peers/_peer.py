"""Interface of the peers: ladders of settings, and runs of lanes at one setting."""

import os
from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

CORES = min(2, len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1)
"""Number of cores that each peer may use."""


@dataclass(frozen=True)
class Points:
    """Lanes of the vibro-impact scene that start "stuck" (x1' = -v, all else 0): arrays (lanes,) of its parameters."""

    beta: np.ndarray
    gamma: np.ndarray
    v: np.ndarray
    delta: np.ndarray

    def __len__(self) -> int:
        return len(self.beta)

    def __getitem__(self, index) -> "Points":
        return Points(*(np.ascontiguousarray(column[index]) for column in self.columns))

    @property
    def columns(self) -> tuple[np.ndarray, ...]:
        return self.beta, self.gamma, self.v, self.delta


@dataclass(frozen=True)
class Ran:
    """`period` [s] and `impact_velocity` [m/s] of at least the first lanes, NaN for lanes without one.

    `seconds` is the time of a run of all lanes without compilation. `compiling` [s] is the compile time, if any.
    """

    period: np.ndarray
    impact_velocity: np.ndarray
    seconds: float
    compiling: float = 0.0


class Peer(ABC):
    """One method for the period and the impact velocity of many lanes.

    `name` and `about` are for the table. `lanes` is the number of timed lanes. `settings` are any objects with a `str`.
    """

    name: str
    about: str
    lanes: int

    def missing(self) -> str | None:
        """Return why the peer cannot run here, or None."""
        return None

    @abstractmethod
    def ladders(self, quick: bool) -> list[list]:
        """Return lists of settings, each from coarse to fine."""

    @abstractmethod
    def run(self, points: Points, setting, settle: float, observe: float, judged: int) -> Ran:
        """Run all lanes from t = 0 to `settle` + `observe` [s]; the first `judged` are measured in the observation."""

    def close(self) -> None:
        """Release resources."""
        return


class Returns:
    """Period and impact velocity over whole returns to the section, updated event by event."""

    def __init__(self):
        self.first = self.last = 0.0
        self.number = self.impacts = self.pending = 0
        self.total = self.pending_total = 0.0

    def section(self, t: float) -> None:
        """Record that the bit overtakes the drive at t [s]; impacts since the previous return now count."""
        if self.number == 0:
            self.first = t
        else:
            self.impacts += self.pending
            self.total += self.pending_total
        self.number += 1
        self.last = t
        self.pending, self.pending_total = 0, 0.0

    def impact(self, velocity: float) -> None:
        """Record that the striker touches the bit at `velocity` [m/s]; impacts before the first return do not count."""
        if self.number:
            self.pending += 1
            self.pending_total += velocity

    def read(self) -> tuple[float, float]:
        """Return period [s] and mean impact velocity [m/s]."""
        period = (self.last - self.first) / (self.number - 1) if self.number > 1 else np.nan
        return period, self.total / self.impacts if self.impacts else np.nan

"""What every peer is: a ladder of settings, and a run of some lanes at one of them."""

import os
from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

CORES = min(2, len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1)
"""Cores that every peer may use."""


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
    """`period` [s] and `impact_velocity` [m/s] of the first lanes at least, NaN where a lane has none.

    `seconds`: what the run of all lanes took, without compiling. `compiling` [s]: what that took, where it had to be.
    """

    period: np.ndarray
    impact_velocity: np.ndarray
    seconds: float
    compiling: float = 0.0


class Peer(ABC):
    """One way to compute period and impact velocity of many lanes.

    `name` and `about` for the table; `lanes`: how many it is timed on; `settings` are any objects with a `str`.
    """

    name: str
    about: str
    lanes: int

    def missing(self) -> str | None:
        """Why it cannot run here, or None."""
        return None

    @abstractmethod
    def ladders(self, quick: bool) -> list[list]:
        """Settings, in each list from coarse to fine."""

    @abstractmethod
    def run(self, points: Points, setting, settle: float, observe: float, judged: int) -> Ran:
        """Run all lanes from t = 0 to `settle` + `observe` [s]; the first `judged` are measured in the observation."""

    def close(self) -> None:
        """Let go of what it holds."""
        return


class Returns:
    """Period and impact velocity over whole returns to the section, taken in as they come."""

    def __init__(self):
        self.first = self.last = 0.0
        self.number = self.impacts = self.pending = 0
        self.total = self.pending_total = 0.0

    def section(self, t: float) -> None:
        """The bit overtakes the drive at t [s]: what has come since the return before counts."""
        if self.number == 0:
            self.first = t
        else:
            self.impacts += self.pending
            self.total += self.pending_total
        self.number += 1
        self.last = t
        self.pending, self.pending_total = 0, 0.0

    def impact(self, velocity: float) -> None:
        """The striker touches the bit at `velocity` [m/s]; before the first return it does not count."""
        if self.number:
            self.pending += 1
            self.pending_total += velocity

    def read(self) -> tuple[float, float]:
        """Period [s] and mean impact velocity [m/s]."""
        period = (self.last - self.first) / (self.number - 1) if self.number > 1 else np.nan
        return period, self.total / self.impacts if self.impacts else np.nan

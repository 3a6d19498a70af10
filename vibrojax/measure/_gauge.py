"""What measuring in the loop is made of."""

from abc import ABC, abstractmethod
from typing import Any, NamedTuple

from vibrojax.stepping import Lane, Step


class Moment(NamedTuple):
    """A step just taken: the lane after it, the step, and what is known of the cycle that it lies in.

    `since` [s] is the time since the last return when it ends; `frequency` [rad/s] that of the returns (0 before there
    are two) and `phase` [rad] what has passed of it, when the step ends, since the observation's first return.
    """

    lane: Lane
    step: Step
    since: Any
    frequency: Any
    phase: Any


class Return(NamedTuple):
    """Lanes that stand at the section (`here`), and what gauges share of it; every leaf has shape (lanes,).

    `number` counts returns in the observation, from 0 at the first; `interval` [s] is the time since the one before and
    `bit_amplitude`, `striker_amplitude` [m] half the swings in it; `share` is the part of the observation that is over;
    `sums` holds what the ledger summed since the return before.
    """

    here: Any
    number: Any
    interval: Any
    bit_amplitude: Any
    striker_amplitude: Any
    share: Any
    lane: Lane
    sums: dict


class Whole(NamedTuple):
    """The observation's whole returns: their number, their total time [s], their `sums`, and the lane's `cycles`."""

    returns: Any
    time: Any
    sums: dict
    cycles: Any


class Gauge(ABC):
    """One group of quantities, accumulated while stepping; nothing is stored per step.

    A gauge provides `increments` (what to sum over whole returns), `begin`, `step` and `section` (what else it carries:
    a dict of arrays whose last axis is lanes) and `read`; everything else just works. All are pure functions.
    """

    summed: tuple[str, ...] = ()

    def increments(self, scene, p, moment: Moment) -> dict:
        """What a step adds to the ledger's sums, by the names in `summed`."""
        return {}

    def begin(self, scene, p, lane: Lane) -> dict:
        """What it carries at the start of the observation."""
        return {}

    def step(self, scene, p, carry: dict, moment: Moment) -> dict:
        """Take in a step; where its `dt` is 0 and nothing is hit, nothing changes."""
        return carry

    def section(self, scene, p, carry: dict, at: Return) -> dict:
        """Take in a return to the section, where `at.here`."""
        return carry

    @abstractmethod
    def read(self, scene, p, carry: dict, whole: Whole) -> dict:
        """The features, by name, each (lanes,)."""

"""What measuring in the loop is made of."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar

from vibrojax.models.arrays import Counts, Flags, Lanes
from vibrojax.models.scenes.scene import Scene
from vibrojax.stepping import Lane, Step

Sums = dict[str, Lanes]
"""What is summed over steps, by name."""


class Moment(NamedTuple):
    """A step just taken: the lane after it, the step, and what is known of the cycle that it lies in.

    `since` [s] is the time since the last return when it ends; `frequency` [rad/s] that of the returns (0 before there
    are two) and `phase` [rad] what has passed of it, when the step ends, since the observation's first return.
    """

    lane: Lane
    step: Step
    since: Lanes
    frequency: Lanes
    phase: Lanes


class Return(NamedTuple):
    """Lanes that stand at the section (`here`), and what gauges share of it; every leaf has shape (lanes,).

    `number` counts returns in the observation, from 0 at the first; `interval` [s] is the time since the one before and
    `amplitudes` [m] half the swings in it, in the order of the section's; `share` is the part of the observation that
    is over; `sums` holds what the ledger summed since the return before.
    """

    here: Flags
    number: Lanes
    interval: Lanes
    amplitudes: tuple[Lanes, ...]
    share: Lanes
    lane: Lane
    sums: Sums


class Whole(NamedTuple):
    """The observation's whole returns: their number, their total time [s], their `sums`, and the lane's `cycles`."""

    returns: Lanes
    time: Lanes
    sums: Sums
    cycles: Counts | Lanes


K = TypeVar("K", bound=Scene[Any])
"""The kind of scene that a gauge measures."""


class Gauge(ABC, Generic[K]):
    """A group of quantities, accumulated while stepping; nothing is stored per step.

    A gauge must provide `read`. `increments` returns what a step adds to the sums over whole returns; `close` replaces
    the sums of a return at its end. `begin`, `step` and `section` update the gauge's carry: a pytree of arrays whose
    last axis is lanes. All methods are pure functions. A gauge is a frozen dataclass, because it is a static argument
    of programs. A scene lists gauges, or their names, in `measures`. `needs` lists the capabilities that the scene must
    have. `variables` gives the units and long names of those features that go to the dataset and are not in
    [vibrojax.io.variables][].

    **Example:**

    >>> class Returns(vj.Gauge):  # how many whole returns were observed; `step` and `section` would take in more
    ...     variables = {"returns": ("1", "whole returns in the observation")}
    ...
    ...     def read(self, scene, c, carry, whole):
    ...         return {"returns": whole.returns}
    >>> class Counted(vj.SCENES["rotary"]):
    ...     name = "counted"
    ...     measures = (*vj.SCENES["rotary"].measures, Returns())
    >>> ds = vj.run_sweep({"scene": Counted(), "starts": ["drive"], "grid": {"v": [1.0, 1.5]}}, progress=False)
    >>> ds.returns.values.ravel().tolist()
    [38.0, 10.0]
    """

    summed: ClassVar[tuple[str, ...]] = ()
    variables: ClassVar[Mapping[str, tuple[str, str]]] = {}
    needs: ClassVar[tuple[type[Scene[Any]], ...]] = ()

    def increments(self, scene: K, c: Any, moment: Moment) -> Sums:
        """What a step adds to the ledger's sums, by the names in `summed`; `c`: the scene's constants."""
        return {}

    def close(self, sums: Sums, interval: Lanes) -> Sums:
        """Return replacements for the `sums` of a return that ends, by name; `interval` [s] is its duration."""
        return {}

    def begin(self, scene: K, c: Any, lane: Lane) -> Any:
        """What it carries at the start of the observation."""
        return ()

    def step(self, scene: K, c: Any, carry: Any, moment: Moment) -> Any:
        """Take in a step; where its `dt` is 0 and nothing is hit, nothing changes."""
        return carry

    def section(self, scene: K, c: Any, carry: Any, at: Return) -> Any:
        """Take in a return to the section, where `at.here`."""
        return carry

    @abstractmethod
    def read(self, scene: K, c: Any, carry: Any, whole: Whole) -> dict[str, Lanes]:
        """The features, by name, each (lanes,)."""

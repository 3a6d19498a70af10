"""The interface of gauges, which accumulate quantities in the time loop."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar

from vibrojax.models.arrays import Counts, Flags, Lanes
from vibrojax.models.scenes.scene import Scene
from vibrojax.stepping import Lane, Step

Sums = dict[str, Lanes]
"""Sums over steps, by name."""


class Moment(NamedTuple):
    """A step just taken, with the lane after it and its place in the cycle.

    - `since` [s]: time from the last return to the end of the step.
    - `frequency` [rad/s]: of the returns, 0 before there are two.
    - `phase` [rad]: phase of that frequency at the end of the step, from the observation's first return.
    """

    lane: Lane
    step: Step
    since: Lanes
    frequency: Lanes
    phase: Lanes


class Return(NamedTuple):
    """A return of the lanes in the mask `here`; every leaf has shape (lanes,).

    - `number`: of returns in the observation, from 0 at the first.
    - `interval` [s]: time since the return before; `amplitudes` [m]: half the section's swings in it.
    - `share`: part of the observation that is over.
    - `sums`: the ledger's sums since the return before.
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
"""The type of scene that a gauge measures."""


class Gauge(ABC, Generic[K]):
    """A group of quantities, accumulated while stepping; nothing is stored per step.

    A gauge must define `read`. `increments` returns the increments of the sums over whole returns; `close` replaces the
    sums of a return at its end. `begin`, `step` and `section` update the gauge's carry: a pytree of arrays whose last
    axis is lanes. All methods are pure functions. A gauge is a frozen dataclass, because it is a static argument of
    programs. A scene lists gauges, or their names, in `measures`.

    - `summed`: names of the sums; `needs`: the capabilities that the scene must have.
    - `variables`: units and long names of the dataset's variables that are not in [vibrojax.io.variables][].

    **Example:**

    >>> class Returns(vj.Gauge):  # the number of whole returns; `step` and `section` would record more
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
        """Return a step's increments of the sums in `summed`, by name; `c`: the scene's constants."""
        return {}

    def close(self, sums: Sums, interval: Lanes) -> Sums:
        """Return replacements for the `sums` of a return that ends, by name; `interval` [s] is its duration."""
        return {}

    def begin(self, scene: K, c: Any, lane: Lane) -> Any:
        """Return the carry at the start of the observation."""
        return ()

    def step(self, scene: K, c: Any, carry: Any, moment: Moment) -> Any:
        """Return the carry after a step; a step with `dt` 0 that hits nothing must not change it."""
        return carry

    def section(self, scene: K, c: Any, carry: Any, at: Return) -> Any:
        """Return the carry after a return to the section, for the lanes in `at.here`."""
        return carry

    @abstractmethod
    def read(self, scene: K, c: Any, carry: Any, whole: Whole) -> dict[str, Lanes]:
        """Return the features, by name, each (lanes,)."""

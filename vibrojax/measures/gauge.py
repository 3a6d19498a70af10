"""The interface of gauges, which accumulate quantities over the steps of a lane."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar

from vibrojax.physics.arrays import Counts, Flags, Lanes
from vibrojax.scenes.scene import Scene
from vibrojax.stepping import Lane, Step

Sums = dict[str, Lanes]
"""Sums over steps, by name."""


class Moment(NamedTuple):
    """Input of a gauge: a step, the lane after the step, and the phase of the oscillation.

    - `since` [s]: time from the last section crossing to the end of the step.
    - `frequency` [rad/s]: angular frequency of the section crossings, 0 before the second crossing.
    - `phase` [rad]: phase since the first observed section crossing, at the angular frequency of the crossings.
    """

    lane: Lane
    step: Step
    since: Lanes
    frequency: Lanes
    phase: Lanes


class Return(NamedTuple):
    """A section crossing in the lanes that the mask `here` selects; every array has shape (lanes,).

    - `number`: index of the crossing in the observation, from 0.
    - `interval` [s]: time since the previous crossing.
    - `amplitudes` [m]: half the peak-to-peak range of each oscillating position since the previous crossing.
    - `share`: elapsed fraction of the observation.
    - `lane`: the lane at the crossing; `sums`: the gauges' sums since the previous crossing.
    """

    here: Flags
    number: Lanes
    interval: Lanes
    amplitudes: tuple[Lanes, ...]
    share: Lanes
    lane: Lane
    sums: Sums


class Whole(NamedTuple):
    """All complete return intervals, between successive section crossings, of an observation.

    - `returns`: number of complete return intervals. `time` [s]: total duration of the intervals. `sums`: sums over the
      intervals.
    - `cycles`: number of return intervals per period of the motion, 0 if the motion is not periodic.
    """

    returns: Lanes
    time: Lanes
    sums: Sums
    cycles: Counts | Lanes


K = TypeVar("K", bound=Scene[Any])
"""The type of scene that a gauge measures."""


class Gauge(ABC, Generic[K]):
    """A group of measured quantities that are accumulated over the steps of a lane, without storing the steps.

    A gauge must define the method `read`. The method `increments` returns what a step adds to the sums of a return
    interval, which lasts from one section crossing to the next. The method `close` may replace the sums at the end of a
    return interval. The method `begin` creates the *carry*, which is the state of the gauge during the observation; the
    methods `step` and `section` update it. The carry is a pytree of arrays whose last axis is lanes. All methods of a
    gauge are pure functions. A gauge is a frozen dataclass, because gauges are static arguments of compiled programs. A
    scene lists its gauges, or their names, in `measures`.

    - `summed`: names of the sums; `needs`: capabilities that the scene must have.
    - `variables`: unit and long name of each dataset variable that is not in [vibrojax.io.variables][].
    - `checked`: whether error estimates or labels compare the measured quantities with the check run.

    **Example:**

    >>> class Returns(vj.Gauge):  # the number of whole returns; `step` and `section` would record more
    ...     variables = {"whole_returns": ("1", "whole returns in the observation")}
    ...
    ...     def read(self, scene, c, carry, whole):
    ...         return {"whole_returns": whole.returns}
    >>> class Counted(vj.SCENES["rotary"]):
    ...     name = "counted"
    ...     measures = (*vj.SCENES["rotary"].measures, Returns())
    >>> ds = vj.run_sweep({"scene": Counted(), "starts": ["drive"], "grid": {"v": [1.0, 1.5]}}, progress=False)
    >>> ds.whole_returns.values.ravel().tolist()
    [37.0, 9.0]
    """

    summed: ClassVar[tuple[str, ...]] = ()
    variables: ClassVar[Mapping[str, tuple[str, str]]] = {}
    needs: ClassVar[tuple[type[Scene[Any]], ...]] = ()
    checked: ClassVar[bool] = False

    def increments(self, scene: K, c: Any, moment: Moment) -> Sums:
        """Return what a step adds to each sum in `summed`, by name; `c`: the constants of the scene."""
        return {}

    def close(self, sums: Sums, interval: Lanes) -> Sums:
        """Return new values, by name, for the sums of a complete return interval of duration `interval` [s]."""
        return {}

    def begin(self, scene: K, c: Any, lane: Lane) -> Any:
        """Return the carry with which the gauge begins the observation."""
        return ()

    def step(self, scene: K, c: Any, carry: Any, moment: Moment) -> Any:
        """Return the gauge's carry after a step; an empty step (`dt` 0, and no hits) must not change the carry."""
        return carry

    def section(self, scene: K, c: Any, carry: Any, crossing: Return) -> Any:
        """Return the gauge's carry after a section crossing in the lanes that the mask `crossing.here` selects."""
        return carry

    def for_check(self) -> "Gauge[K] | None":
        """Return the gauge of the check run, or None if the gauge is not `checked`."""
        return self if self.checked else None

    @abstractmethod
    def read(self, scene: K, c: Any, carry: Any, whole: Whole) -> dict[str, Lanes]:
        """Return the measured quantities, by name, as arrays (lanes,)."""

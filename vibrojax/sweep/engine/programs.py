"""The programs of lanes: start, settle up to a time, observe."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from vibrojax.measures.recorder import Features, Recorder, Records
from vibrojax.measures.run import Effort, Underway, observe_block, settle_block, start_block
from vibrojax.measures.section import on_orbit
from vibrojax.models.arrays import Array, Counts, Lanes
from vibrojax.models.scenes import Scene
from vibrojax.models.scenes.declared import Values
from vibrojax.stepping import Lane, Stepper, lane_at


class Kind(NamedTuple):
    """What programs are compiled for: scene, stepper, recorder, the names of the starts there are, and whether lanes
    that have been observed are asked where they ended."""

    scene: Scene[Any]
    stepper: Stepper
    recorder: Records
    starts: tuple[str, ...]
    tells_end: bool = False


CARRIED = -1
"""The number of a start where another lane ended."""

END = "end_state"
"""What the feature is called that says where a lane ended: (states, lanes)."""


class Given(NamedTuple):
    """Parameters by name, which of the starts by name, and the states of one without a name, of each lane (lanes,).

    `carried`: all states of lanes that start where others ended, where `start` is `CARRIED`.
    """

    parameters: dict[str, Lanes]
    start: Counts
    states: tuple[Lanes, ...] = ()
    carried: tuple[Lanes, ...] = ()


class Programs(ABC):
    """The programs of one kind, compiled; they take and return arrays whose last axis is lanes, as many as there are.

    - `block`: lanes that step together, so that each waits for the slowest.
    - `hand`: lanes per call: so many that a call itself costs little.
    - `compiler`: what compiles them.
    """

    block: int
    hand: int
    compiler: str

    def __init__(self, kind: Kind) -> None:
        self.kind = kind

    def start(self, given: Given) -> tuple[Lane, Any]:
        """See `start_lanes`."""
        return self._run(start_lanes, given)

    def settle(self, given: Given, begun: Underway, until: Lanes, effort: Effort) -> Underway:
        """See `settle_lanes`."""
        return self._run(settle_lanes, given, begun, until, effort)

    def observe(self, given: Given, begun: Underway, begin: Lanes, duration: Lanes, effort: Effort) -> Features:
        """See `observe_lanes`."""
        return self._run(observe_lanes, given, begun, begin, duration, effort)

    def on_orbit(self, given: Given, state: Values, states: Array, times: Array, period: Lanes) -> tuple[Lane, Any]:
        """See `lanes_on_orbit`."""
        return self._run(lanes_on_orbit, given, state, states, times, period)

    @abstractmethod
    def check_arithmetic(self, dtype: np.dtype) -> None:
        """Compare what equations are written in with numpy, compiled as lanes are; `InputError` where it is wrong."""

    @abstractmethod
    def _run(self, program: Callable[..., Any], *arguments: Any) -> Any:
        """What a program gives for lanes, on the device and in the precision in use."""


def start_lanes(kind: Kind, given: Given) -> tuple[Lane, Any]:
    """(lane, what its recorder carries) at t = 0."""
    constants = kind.scene.constants(given.parameters)
    return start_block(kind.scene, kind.recorder, constants, state_of(kind, constants, given))


def lanes_on_orbit(
    kind: Kind, given: Given, state: Values, states: Array, times: Array, period: Lanes
) -> tuple[Lane, Any]:
    """(lane, what its recorder carries) at t = 0, from all states at the section of a periodic orbit; see
    [vibrojax.measures.section.on_orbit][] for the last returns, which under pulses are not asked for."""
    lane = lane_at(kind.scene, constants_of(kind, given), state)
    begun = kind.recorder.settling(kind.scene, lane)
    return lane, on_orbit(begun, states, times, period) if isinstance(kind.recorder, Recorder) else begun


def settle_lanes(kind: Kind, given: Given, begun: Underway, until: Lanes, effort: Effort) -> Underway:
    """The lanes at the times `until` [s]; see `settle_block`."""
    return settle_block(kind.scene, kind.stepper, kind.recorder, constants_of(kind, given), begun, until, effort)


def observe_lanes(kind: Kind, given: Given, begun: Underway, begin: Lanes, duration: Lanes, effort: Effort) -> Features:
    """Features by name, (lanes,), or (returns, lanes) for the last returns; see `observe_block`."""
    constants = constants_of(kind, given)
    lane, features = observe_block(kind.scene, kind.stepper, kind.recorder, constants, begun, begin, duration, effort)
    return features | ({END: jnp.stack(lane.state)} if kind.tells_end else {})


def constants_of(kind: Kind, given: Given) -> Any:
    """The scene's constants, for a motion from the lane's start."""
    constants = kind.scene.constants(given.parameters)
    return kind.scene.scaled(constants, state_of(kind, constants, given))


def state_of(kind: Kind, constants: Any, given: Given) -> Values:
    """The state at t = 0 of each lane, from the start that it takes; the scene's own where it has no starts."""
    start = given.start
    starts = (*kind.starts, *((given.states,) if given.states else ())) or (None,)
    candidates = [kind.scene.start(constants, one, start.shape) for one in starts]
    state = candidates[0]
    for index, other in enumerate(candidates[1:], start=1):
        state = tuple(jnp.where(start == index, new, old) for new, old in zip(other, state, strict=True))
    if given.carried:
        state = tuple(jnp.where(start == CARRIED, new, old) for new, old in zip(given.carried, state, strict=True))
    return state

"""Programs of lanes: functions to be compiled that initialize lanes, settle them up to a time, and observe them."""

from typing import Any, NamedTuple

from vibrojax.lazy import jnp
from vibrojax.measures.recorder import (
    Effort,
    Features,
    LaneState,
    Recorder,
    Records,
    observe_block,
    settle_block,
    start_block,
)
from vibrojax.measures.section import on_orbit
from vibrojax.physics.arrays import Array, Counts, Lanes
from vibrojax.scenes import Scene
from vibrojax.scenes.declared import Values
from vibrojax.stepping import Lane, Stepper, lane_at


class ProgramKey(NamedTuple):
    """The static arguments of programs.

    `tells_end`: True if the final states of observed lanes are returned as a feature.
    """

    scene: Scene[Any]
    stepper: Stepper
    recorder: Records
    tells_end: bool = False


CARRIED = -1
"""Value of `LaneArguments.start` for a lane that begins in the final state of another lane."""

END = "end_state"
"""Name of the feature that holds a lane's final state: (states, lanes)."""


class LaneArguments(NamedTuple):
    """Parameters and initial condition of each lane, arrays (lanes,).

    `start`: index of the initial condition in the names of the scene, the number of these names for `states`, or
    `CARRIED` for `carried`, the final state of another lane.
    """

    parameters: dict[str, Lanes]
    start: Counts
    states: tuple[Lanes, ...] = ()
    carried: tuple[Lanes, ...] = ()


def start_lanes(kind: ProgramKey, given: LaneArguments) -> tuple[Lane, Any]:
    """Return the lanes and the values of their recorder at t = 0."""
    constants = kind.scene.constants(given.parameters)
    return start_block(kind.scene, kind.recorder, constants, state_of(kind, constants, given))


def lanes_on_orbit(
    kind: ProgramKey, given: LaneArguments, state: Values, states: Array, times: Array, period: Lanes
) -> tuple[Lane, Any]:
    """Return the lanes and the values of their recorder at t = 0, with all states given on the section of an orbit.

    `states` (8, states, lanes), `times` (8, lanes) [s] and `period` [s] describe the last section crossings, see
    [vibrojax.measures.section.on_orbit][]. Pulses do not need them.
    """
    lane = lane_at(kind.scene, constants_of(kind, given), state)
    carry = kind.recorder.settling(kind.scene, lane)
    return lane, on_orbit(carry, states, times, period) if isinstance(kind.recorder, Recorder) else carry


def settle_lanes(
    kind: ProgramKey, given: LaneArguments, underway: LaneState, until: Lanes, effort: Effort
) -> LaneState:
    """Return the lanes at the times `until` [s]; see `settle_block`."""
    return settle_block(kind.scene, kind.stepper, kind.recorder, constants_of(kind, given), underway, until, effort)


def observe_lanes(
    kind: ProgramKey, given: LaneArguments, underway: LaneState, begin: Lanes, duration: Lanes, effort: Effort
) -> Features:
    """Return features by name, (lanes,), or (returns, lanes) for the last section crossings; see `observe_block`."""
    constants = constants_of(kind, given)
    lane, features = observe_block(
        kind.scene, kind.stepper, kind.recorder, constants, underway, begin, duration, effort
    )
    return features | ({END: jnp.stack(lane.state)} if kind.tells_end else {})


def check_lanes(
    kind: ProgramKey, given: LaneArguments, underway: LaneState, begin: Lanes, duration: Lanes, effort: Effort
) -> Features:
    """Return the features of the check run, see `Records.for_check`."""
    checked = kind._replace(recorder=kind.recorder.for_check(), tells_end=False)
    return observe_lanes(checked, given, underway, begin, duration, effort)


def constants_of(kind: ProgramKey, given: LaneArguments) -> Any:
    """Return the scene's constants for a motion from each lane's initial state."""
    constants = kind.scene.constants(given.parameters)
    return kind.scene.scaled(constants, state_of(kind, constants, given))


def state_of(kind: ProgramKey, constants: Any, given: LaneArguments) -> Values:
    """Return the state of each lane at t = 0. A scene without named initial conditions has a default state."""
    start = given.start
    starts = (*kind.scene.starts, *((given.states,) if given.states else ())) or (None,)
    state, *others = [kind.scene.start(constants, name, start.shape) for name in starts]
    numbered = [*enumerate(others, start=1), *([(CARRIED, given.carried)] if given.carried else [])]
    for number, other in numbered:
        state = tuple(jnp.where(start == number, new, old) for new, old in zip(other, state, strict=True))
    return state

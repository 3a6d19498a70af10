"""Recorders, which update a scene's gauges with every step, and programs of a block of lanes that use them.

A program lets lanes settle (any number of times), then observes them and returns the features.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from vibrojax.errors import InputError, asked, number_of, shown
from vibrojax.io.variables import VARIABLES
from vibrojax.lazy import jax, jnp
from vibrojax.measures import ledger, repeats, section, since_start
from vibrojax.measures.gauge import Gauge, Moment, Return, Sums, Whole
from vibrojax.measures.ledger import Ledger
from vibrojax.measures.motion import section_of
from vibrojax.measures.repeats import Returns
from vibrojax.measures.section import Settling
from vibrojax.physics.arrays import Array, Flags, Lanes, Real
from vibrojax.scenes.declared import Values
from vibrojax.scenes.scene import Scene
from vibrojax.stepping import Accuracy, Goal, Lane, Step, Stepper, lane_at

Features = dict[str, Any]
"""Features by name: arrays (lanes,), or (rows, lanes) for section crossings that are stored individually."""


class Records(ABC):
    """A recorder: it computes the features of the observation, and may also record while lanes settle.

    While lanes settle, nothing is recorded by default. The carry is a pytree of arrays whose last axis is lanes.
    Recorder objects are static arguments of compiled programs, so a recorder is a frozen dataclass.
    """

    def for_check(self) -> "Records":
        """Return the recorder of the check run, which settles as this one does and may measure less."""
        return self

    def settling(self, scene: Scene[Any], lane: Lane) -> Any:
        """Return the carry for the settling time, at t = 0."""
        return ()

    def settle(self, scene: Scene[Any], c: Any, carry: Any, lane: Lane, step: Step) -> Any:
        """Return the carry updated with a step before the observation."""
        return carry

    def settle_returns(self, carry: Any) -> Any:
        """Return the carry after storing the section crossings passed while settling; called once every few steps."""
        return carry

    def settled(self, begun: Any, observed: Any) -> Any:
        """Return the settling carry for an observation that continues another one.

        It is `begun` with the section crossings that the carry `observed` of the previous observation has stored.
        """
        return begun

    @abstractmethod
    def begin(self, scene: Scene[Any], c: Any, lane: Lane, settled: Any) -> Any:
        """Return the carry at the start of the observation; `settled`: the carry at the end of settling."""

    @abstractmethod
    def step(self, scene: Scene[Any], c: Any, carry: Any, lane: Lane, step: Step) -> Any:
        """Return the carry updated with a step of the observation."""

    @abstractmethod
    def waiting(self, carry: Any) -> Flags:
        """Return a mask of the lanes at a section crossing that must be recorded before the lanes continue."""

    @abstractmethod
    def take_returns(self, scene: Scene[Any], c: Any, carry: Any, lane: Lane, share: Lanes) -> Any:
        """Return the carry updated with the section crossings of the waiting lanes.

        `share`: elapsed fraction of the observation.
        """

    @abstractmethod
    def read(self, scene: Scene[Any], c: Any, carry: Any) -> Features:
        """Return the features of every lane, by name."""


class Observed(NamedTuple):
    """The recorder's carry during the observation: section crossings, sums, and the carry of each gauge."""

    returns: Returns
    ledger: Ledger
    gauges: tuple[Any, ...]


@dataclass(frozen=True)
class Recorder(Records):
    """The recorder of gauges, evaluated over complete return intervals of the scene's section."""

    gauges: tuple[Gauge[Any], ...]

    def for_check(self) -> "Recorder":
        checked = (gauge.for_check() for gauge in self.gauges)
        return replace(self, gauges=tuple(gauge for gauge in checked if gauge is not None))

    def settling(self, scene: Scene[Any], lane: Lane) -> Settling:
        return section.begin(scene, lane)

    def settle(self, scene: Scene[Any], c: Any, carry: Settling, lane: Lane, step: Step) -> Settling:
        return section.pass_by(scene, c, carry, lane, step)

    def settle_returns(self, carry: Settling) -> Settling:
        return section.take_in_passed(carry)

    def settled(self, begun: Settling, observed: Observed) -> Settling:
        return begun._replace(seen=observed.returns.seen)

    def begin(self, scene: Scene[Any], c: Any, lane: Lane, settled: Settling) -> Observed:
        names = ("time", *(name for gauge in self.gauges for name in gauge.summed))
        gauges = tuple(_ask(gauge, "begin", scene, c, lane) for gauge in self.gauges)
        return Observed(section.observe(scene, settled), ledger.begin(names, lane.state[0]), gauges)

    def step(self, scene: Scene[Any], c: Any, carry: Observed, lane: Lane, step: Step) -> Observed:
        returns = section.step(scene, c, carry.returns, lane, step)
        moment = Moment(lane, step, returns.seen.since, returns.seen.frequency, returns.phase)
        increments = {"time": step.dt}
        for gauge in self.gauges:
            increments |= _named(gauge, "increments", gauge.summed, "summed", scene, c, moment)
        own = zip(self.gauges, carry.gauges, strict=True)
        gauges = tuple(_ask(gauge, "step", scene, c, mine, moment) for gauge, mine in own)
        return Observed(returns, ledger.add(carry.ledger, increments), gauges)

    def waiting(self, carry: Observed) -> Flags:
        return carry.returns.waiting

    def take_returns(self, scene: Scene[Any], c: Any, carry: Observed, lane: Lane, share: Lanes) -> Observed:
        returns = carry.returns
        here, number, interval = returns.waiting, returns.number, returns.seen.since

        def close(sums: Sums) -> Sums:
            replaced: Sums = {}
            for gauge in self.gauges:
                replaced |= _ask(gauge, "close", sums, interval)
            return replaced

        totals, sums = ledger.section(carry.ledger, here, number, close)
        crossing = Return(here, number, interval, section.amplitudes(returns.seen.ranges), share, lane, sums)
        own = zip(self.gauges, carry.gauges, strict=True)
        gauges = tuple(_ask(gauge, "section", scene, c, mine, crossing) for gauge, mine in own)
        return Observed(section.take_in(scene, c, returns, lane), totals, gauges)

    def read(self, scene: Scene[Any], c: Any, carry: Observed) -> Features:
        """Return the features of the gauges, and in addition returns, cycles, period and settling_time."""

        def features(whole: Whole) -> Features:
            gauges = zip(self.gauges, carry.gauges, strict=True)
            measured: Features = {}
            for gauge, own in gauges:
                known = (*gauge.variables, *VARIABLES)
                measured |= _named(gauge, "read", known, "variables", scene, c, own, whole)
            return measured

        returns = carry.returns
        everything, intervals = ledger.whole(carry.ledger, returns.number, jnp.zeros_like(returns.number))
        first = features(Whole(intervals, everything["time"], everything, jnp.zeros_like(intervals)))
        period = everything["time"] / intervals
        lasting = since_start.features(scene, c, first, returns.seen.since_start)
        halves = tuple((first | lasting)[name] for name in since_start.half_names(section_of(scene)))
        cycles = repeats.cycles(section_of(scene), returns, halves, period)
        sums, whole_returns = ledger.whole(carry.ledger, returns.number, cycles)
        measured = features(Whole(whole_returns, sums["time"], sums, cycles)) | lasting
        return measured | {
            "returns": returns.number,
            "cycles": cycles,
            "period": sums["time"] / whole_returns,
            "settling_time": repeats.settling_time(returns, cycles),
        }


def _ask(gauge: Gauge[Any], method: str, *arguments: Any) -> Any:
    return asked(f"gauge {type(gauge).__name__}: {method}", getattr(gauge, method), *arguments)


def _named(gauge: Gauge[Any], method: str, known: Collection[str], where: str, *arguments: Any) -> dict[str, Any]:
    """Return the numbers by name that a method gives; names that are not `known` would be lost."""
    values: Any = _ask(gauge, method, *arguments)
    if type(gauge).__module__.split(".")[0] == __name__.split(".")[0]:
        return values
    what = f"gauge {type(gauge).__name__}: {method}"
    if not isinstance(values, Mapping):
        raise InputError(f"{what} gave {type(values).__name__}; it must give a dict of numbers by name")
    for name, value in values.items():
        if name not in known:
            raise InputError(f"{what} gave {shown(name)}, which is not declared; add it to `{where}` of the gauge")
        number_of(f"{what}, {name},", value)
    if where == "summed" and (missing := [name for name in known if name not in values]):
        raise InputError(f"{what} gave no {shown(missing[0])}, which is in `{where}` of the gauge")
    return dict(values)


STEPS_PER_TURN = 4
"""Number of steps between two checks for section crossings during the observation. A lane at the section waits for the
next check, on average for half of these steps."""

STEPS_PER_PASS = 3
"""The corresponding number while settling, when lanes do not wait. It is less than the number of steps per period with
the longest steps, so that no section crossing is missed."""


class Effort(NamedTuple):
    """The settings of the steps, and the greatest number of steps of a lane; the lane then stops early."""

    accuracy: Accuracy
    most_steps: Any


class LaneState(NamedTuple):
    """A block of lanes between two programs: the lanes, the recorder's carry, and the number of steps since t = 0."""

    lane: Lane
    carry: Any
    steps: Lanes


def start_block(scene: Scene[Any], recorder: Records, c: Any, state: Values) -> tuple[Lane, Any]:
    """Return the lanes at t = 0 and the recorder's carry.

    `c`: the scene's constants; `state`: the initial state, a tuple of arrays (lanes,).
    """
    lane = lane_at(scene, scene.scaled(c, state), state)
    return lane, recorder.settling(scene, lane)


def settle_block(
    scene: Scene[Any], stepper: Stepper, recorder: Records, c: Any, begun: LaneState, until: Lanes, effort: Effort
) -> LaneState:
    """Return the lanes at the times `until` [s] (lanes,).

    `c`: the scene's constants after `Scene.scaled` for the initial state.
    """

    def step(lane: Lane, carry: Any, goal: Goal) -> tuple[Lane, Any]:
        lane, step = stepper.step(scene, c, lane, effort.accuracy, goal, False)
        return lane, recorder.settle(scene, c, carry, lane, step)

    return _run(begun, until, effort, STEPS_PER_PASS, step, lambda carry, lane: recorder.settle_returns(carry))


def observe_block(
    scene: Scene[Any],
    stepper: Stepper,
    recorder: Records,
    c: Any,
    begun: LaneState,
    begin: Lanes,
    duration: Lanes,
    effort: Effort,
) -> tuple[Lane, Features]:
    """Return the lanes at the end of their observation, and their features by name.

    **Arguments:** as for `settle_block`; `begin`, `duration` [s]: beginning and length of each lane's observation.
    """
    end = begin + duration
    settled = begun.lane.clock.until(begin) <= 0
    begun = begun._replace(carry=recorder.begin(scene, c, begun.lane, begun.carry))

    def step(lane: Lane, carry: Any, goal: Goal) -> tuple[Lane, Any]:
        lane, step = stepper.step(scene, c, lane, effort.accuracy, goal, True)
        return lane, recorder.step(scene, c, carry, lane, step)

    def turn(carry: Any, lane: Lane) -> Any:
        return recorder.take_returns(scene, c, carry, lane, 1 - lane.clock.until(end) / duration)

    lane, carry, steps = _run(begun, end, effort, STEPS_PER_TURN, step, turn, lambda carry: ~recorder.waiting(carry))
    finite = jnp.all(jnp.stack([jnp.isfinite(y) for y in lane.state]), axis=0)
    return lane, recorder.read(scene, c, carry) | {
        "steps": steps,
        "finite": finite & jnp.isfinite(lane.clock.high),
        "finished": settled & (lane.clock.until(end) <= 0),
    }


def run_block(
    scene: Scene[Any],
    stepper: Stepper,
    recorder: Records,
    c: Any,
    state: Values,
    effort: Effort,
    settle: Real,
    observe: Real,
) -> Features:
    """Return the features of a block of lanes by name.

    `settle`: duration of settling [s]; `observe`: duration of the observation after it [s].
    """
    lane, carry = start_block(scene, recorder, c, state)
    c = scene.scaled(c, state)
    none = jnp.zeros_like(state[0])
    begin, duration = none + settle, none + observe
    begun = settle_block(scene, stepper, recorder, c, LaneState(lane, carry, none), begin, effort)
    return observe_block(scene, stepper, recorder, c, begun, begin, duration, effort)[1]


def _run(
    begun: LaneState,
    end: Lanes,
    effort: Effort,
    steps_per_turn: int,
    step: Callable[[Lane, Any, Goal], tuple[Lane, Any]],
    turn: Callable[[Any, Lane], Any],
    moves: Callable[[Any], Flags | bool] = lambda carry: True,
) -> LaneState:
    """Step every lane to its `end` with `step`, and update the recorder's carry with `turn` every few steps.

    `moves` returns a mask of the lanes that do not wait for `turn`.
    """

    def active(lane: Lane) -> Flags:
        return lane.clock.until(end) > 0  # false for NaN

    def advance(_: Any, now: LaneState) -> LaneState:
        moving = active(now.lane) & moves(now.carry) & (now.steps < effort.most_steps)
        lane, carry = step(now.lane, now.carry, Goal(end, moving))
        return LaneState(lane, carry, jnp.where(moving, now.steps + 1, now.steps))

    def several(now: LaneState) -> LaneState:
        lane, carry, steps = jax.lax.fori_loop(0, steps_per_turn, advance, now)
        return LaneState(lane, turn(carry, lane), steps)

    def continues(now: LaneState) -> Array:
        return jnp.any(active(now.lane) & (now.steps < effort.most_steps))

    return jax.lax.while_loop(continues, several, begun)

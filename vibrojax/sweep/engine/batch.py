"""Batches of lanes: at rest on the host between stretches, in blocks through compiled programs by all workers."""

import threading
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import numpy as np
from jaxtyping import Float, Int

from vibrojax.compile import Untranslatable
from vibrojax.compile.devices import precision
from vibrojax.measures.recorder import Records
from vibrojax.measures.run import Effort, Underway
from vibrojax.models.arrays import Array
from vibrojax.models.scenes.declared import Values
from vibrojax.stepping import Accuracy, Stepper
from vibrojax.sweep.engine.compiler import ByLlvm, ByXla, Programs
from vibrojax.sweep.engine.parallel import in_parallel
from vibrojax.sweep.engine.programs import CARRIED, Given, Kind
from vibrojax.sweep.input.definition import Sweep

MOST_STEPS, MOST_PER_SECOND = 1e6, 1e3
"""Steps after which a lane is given up: so many, and per second, and those that its longest step asks for."""

Report = Callable[[int], None]
"""Is called with a number of lanes, as they come."""

Features = dict[str, np.ndarray]
"""What was measured of lanes, by name: (lanes,), or (lanes, returns) for the last returns."""

Index = Int[np.ndarray, " some"]
PerLane = Float[np.ndarray, " lanes"]


def unreported(lanes: int) -> None:
    """No report."""


@dataclass(frozen=True)
class Batch:
    """Some lanes at one instant, underway at one accuracy; numpy arrays whose last axis is lanes.

    - `accuracy`: what the steps follow from.
    - `given`: parameters and start of every lane.
    - `begin`, `duration`: when each is observed, and for how long [s].
    - `underway`: the lanes, what their recorder carries, and the steps taken so far; None before t = 0.
    - `recent`: steps in the last stretch.
    """

    accuracy: Accuracy
    given: Given
    begin: PerLane
    duration: PerLane
    underway: Underway | None
    recent: Int[np.ndarray, " lanes"]

    def of(self, lanes: Index) -> "Batch":
        """Some of the lanes, by index."""
        arrays = {name: one for name, one in vars(self).items() if name != "accuracy"}
        return Batch(self.accuracy, **jax.tree.map(lambda x: np.take(x, lanes, axis=-1), arrays))

    def observed(self, begin: float, duration: PerLane) -> "Batch":
        """The lanes, to be observed from `begin` on for the times `duration` [s]."""
        return replace(self, begin=np.full_like(self.begin, begin), duration=duration.astype(self.duration.dtype))

    def joined(self, others: "list[Batch]") -> "Batch":
        """These lanes and the others', which are all underway, or none."""
        parts = [{name: one for name, one in vars(batch).items() if name != "accuracy"} for batch in (self, *others)]
        return Batch(self.accuracy, **jax.tree.map(lambda *x: np.concatenate(x, axis=-1), *parts))


def steps_at_most(seconds: float, accuracy: Accuracy, any_lane: float = MOST_STEPS) -> float:
    """Steps after which a lane of so many `seconds` is given up; `any_lane`: those of one that lasts no time."""
    return any_lane + seconds * (MOST_PER_SECOND + 2 / accuracy.step)


def _steps(batch: Batch) -> Array:
    return np.zeros_like(batch.recent) if batch.underway is None else batch.underway.steps


def _call(_: int, program: Callable[[], object]) -> object:
    return program()


class Engine:
    """Runs the lanes of a sweep through its compiled programs, by all `workers`."""

    def __init__(self, sweep: Sweep, stepper: Stepper, recorder: Records, workers: Sequence[jax.Device]) -> None:
        self.sweep, self.workers = sweep, workers
        self.accelerated = workers[0].platform != "cpu"
        self.most_steps = MOST_STEPS
        self._dtype = np.dtype(sweep.run.precision)
        kind = Kind(sweep.system, stepper, recorder, sweep.start_names, sweep.run.carry is not None)
        self.programs: Programs = ByXla(kind, workers[0].platform) if self.accelerated else ByLlvm(kind, self._dtype)

    def given(self, first: int, end: int) -> Given:
        """Parameters and starts of the lanes from `first` to before `end`."""
        values, _ = self.sweep.lane_values(first, end)
        start, states = self.sweep.lane_starts(first, end)
        parameters: dict[str, Array] = {name: x.astype(self._dtype) for name, x in values.items()}
        return Given(parameters, start.astype(np.int32), tuple(x.astype(self._dtype) for x in states))

    def start(self, first: int, end: int, accuracy: Accuracy) -> Batch:
        """The lanes from `first` to before `end`, at t = 0."""
        given = self.given(first, end)
        none = np.zeros(end - first, self._dtype)
        # Counted in integers: float32 has no number after 2^24, at which such a lane would stay for ever.
        steps = np.zeros(end - first, np.int32)
        run = self.sweep.run
        if run.carry is not None:
            given = given._replace(carried=tuple(none for _ in self.sweep.system.states))
        return self.begun(Batch(accuracy, given, none + run.settle, none + run.observe, None, steps))

    def carried(self, batch: Batch, state: Values) -> Batch:
        """The batch's lanes at t = 0 in `state`, all states, (lanes,) each; of a sweep that carries lanes."""
        start = np.full_like(batch.given.start, CARRIED)
        return self.begun(replace(batch, given=batch.given._replace(start=start, carried=state)))

    def begun(self, batch: Batch) -> Batch:
        """Return the lanes at t = 0, in the states that they are given."""

        def program(some: Batch) -> Any:
            return self.programs.start(some.given)

        lane, carry = self._run([batch], program)[0]
        return replace(batch, underway=Underway(lane, carry, np.zeros_like(batch.recent)))

    def on_orbit(self, batch: Batch, state: Values, states: Array, times: Array, period: PerLane) -> Batch:
        """The batch's lanes at t = 0 at the section of a periodic orbit, `state` being all states there, (lanes,) each.

        `states` (8, states, lanes) and `times` (8, lanes) [s]: of the last returns, see
        [vibrojax.measures.section.on_orbit][] (under pulses none is asked for); `period` (lanes,) [s]: between returns.
        """
        lane, carry = self._by_programs(
            self.workers[0], lambda: self.programs.on_orbit(batch.given, state, states, times, period)
        )
        return replace(batch, underway=Underway(lane, carry, np.zeros(len(batch.begin), np.int32)))

    def settle(self, batches: list[Batch], until: float = np.inf, report: Report = unreported) -> list[Batch]:
        """The lanes at the time `until` [s], or when they are to be observed, if that is before.

        `report` is called with the number of lanes that have just come there, those of every batch counted.
        """

        def program(some: Batch) -> Any:
            assert some.underway is not None
            until_when = np.minimum(some.begin, until).astype(self._dtype)
            return self.programs.settle(some.given, some.underway, until_when, self._effort(some.accuracy))

        return [
            replace(batch, underway=underway, recent=underway.steps - _steps(batch))
            for batch, underway in zip(batches, self._run(batches, program, report), strict=True)
        ]

    def observe(self, batches: list[Batch], report: Report = unreported) -> list[Features]:
        """Features of the lanes of each batch.

        `report` is called with the number of lanes that have just been finished, those of every batch counted.
        """

        def program(some: Batch) -> Any:
            assert some.underway is not None
            effort = self._effort(some.accuracy)
            return self.programs.observe(some.given, some.underway, some.begin, some.duration, effort)

        return [
            {name: np.moveaxis(x, -1, 0) for name, x in features.items()}
            for features in self._run(batches, program, report)
        ]

    def compile(self, accuracy: Accuracy) -> None:
        """Compile the programs, once, and not by every thread; nothing is stepped. The one that comes last is compiled
        while others run already: who wants it waits for it.

        **Raises:** `InputError` where what is compiled as lanes are computes wrongly on this machine.
        """
        at_once = replace(self.sweep, run=replace(self.sweep.run, settle=0.0, observe=0.0))
        for worker in dict.fromkeys(self.workers):
            alone = copy(self)
            alone.sweep, alone.workers = at_once, [worker]
            # A whole block: on the first lanes it is decided whether kernels can be trusted.
            still = [alone.start(0, min(self.programs.block, self.sweep.lanes), accuracy)]
            first: list[Callable[[], object]] = [alone._check_arithmetic, partial(alone.settle, still)]
            if self.accelerated:  # where two that want a program both compile it
                first.append(partial(alone.observe, still))
            for _ in in_parallel(_call, first, range(len(first))):
                pass
            self.programs = alone.programs
            if not self.accelerated:
                threading.Thread(target=alone.observe, args=(still,), daemon=True).start()

    def _check_arithmetic(self) -> None:
        with precision(self.sweep.run.precision), jax.default_device(self.workers[0]):
            self.programs.check_arithmetic(self._dtype)

    def _effort(self, accuracy: Accuracy) -> Effort:
        run = self.sweep.run
        traced = Accuracy(*(np.asarray(x, self._dtype) for x in accuracy))
        most = steps_at_most(run.settle + run.observe, accuracy, self.most_steps)
        return Effort(traced, np.int32(min(most, 2**31 - 1)))

    def _run(self, batches: list[Batch], program: Callable[[Batch], Any], report: Report = unreported) -> list[Any]:
        """What `program` gives for the lanes of each batch, run a few blocks at a time."""
        items = [(at, lanes) for at, batch in enumerate(batches) for lanes in self._dealt(batch.recent)]

        def work(worker: jax.Device, item: tuple[int, Index]) -> Any:
            at, lanes = item
            return self._by_programs(worker, lambda: program(batches[at].of(lanes)))

        results: list[Any] = [None] * len(batches)
        for index, part in in_parallel(work, items, self.workers):
            at, lanes = items[index]
            if results[at] is None:
                count = len(batches[at].begin)
                results[at] = jax.tree.map(lambda x, n=count: np.empty((*x.shape[:-1], n), x.dtype), part)
            for whole, mine in zip(jax.tree.leaves(results[at]), jax.tree.leaves(part), strict=True):
                whole[..., lanes] = mine
            report(len(lanes))
        return results

    def _by_programs(self, worker: jax.Device, call: Callable[[], Any]) -> Any:
        """Return what `call` gives on a worker's device; where no kernel can be used, XLA's programs take over."""
        with precision(self.sweep.run.precision), jax.default_device(worker):
            try:
                return call()
            except Untranslatable:
                self.programs = ByXla(self.programs.kind, worker.platform)
                self.programs.check_arithmetic(self._dtype)
                return call()

    def _dealt(self, recent: Int[np.ndarray, " lanes"]) -> list[Index]:
        """The lanes in blocks, dealt into hands of a few blocks.

        Lanes of a block wait for the slowest, so those that took as many steps in the stretch before go together; and
        every hand has slow blocks and fast ones, so that all take about as long.
        """
        by_pace = np.argsort(-recent, kind="stable")
        block = self.programs.block
        blocks = np.split(by_pace, range(block, len(by_pace), block))
        hands = max(-(-len(by_pace) // self.programs.hand), min(len(self.workers), len(blocks)))
        # The last block alone may be short, and only where no other follows it: it is the last of its hand.
        return [np.concatenate(blocks[hand::hands]) for hand in range(hands)]

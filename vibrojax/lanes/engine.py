"""Batches of lanes, and the engine that runs compiled programs on them.

Between calls of the programs, the lanes of a batch are NumPy arrays. For each call they are divided into blocks, which
all workers compute in parallel.
"""

import contextlib
import threading
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Int

from vibrojax.compile.assembly import Untranslatable
from vibrojax.compile.native import BoundKernel
from vibrojax.compile.trees import map_leaves
from vibrojax.compile.xla import BoundProgram, precision
from vibrojax.lanes.compiler import Programs
from vibrojax.lanes.inputs import Features, Index, LaneInputs, Mask, PerLane, Report, unreported
from vibrojax.lanes.programs import (
    CARRIED,
    LaneArguments,
    ProgramKey,
    check_lanes,
    lanes_on_orbit,
    observe_lanes,
    settle_lanes,
    start_lanes,
)
from vibrojax.lazy import jax
from vibrojax.measures.recorder import Effort, LaneState, Records
from vibrojax.physics.arrays import Array
from vibrojax.scenes import Scene
from vibrojax.scenes.declared import Values
from vibrojax.settings.run_settings import RunSettings
from vibrojax.stepping import Accuracy, Stepper
from vibrojax.threads import by_drivers, in_parallel

LANE_MAX_STEPS, LANE_MAX_RATE = 1e6, 1e3
"""Limit on the steps of a lane before it is abandoned: a fixed number, and a number per simulated second [1/s]. A
typical map takes 60 steps per simulated second."""


@dataclass(frozen=True)
class Batch:
    """Lanes between two calls of compiled programs, as NumPy arrays whose last axis is the lane axis.

    - `accuracy`: accuracy of the time steps, the same for all lanes; `lanes`: index of each lane in its chunk.
    - `begin`, `duration`: beginning and length of each lane's observation [s].
    - `underway`: state of the lanes, values of their recorder, and number of steps so far; None before initialization.
    - `recent`: number of steps in the last call of a program.
    - `is_check`: True for a check run.
    """

    accuracy: Accuracy
    lanes: Index
    given: LaneArguments
    begin: PerLane
    duration: PerLane
    underway: LaneState | None
    recent: Int[np.ndarray, " lanes"]
    is_check: bool = False

    def of(self, lanes: Index) -> "Batch":
        return replace(self, **map_leaves(lambda x: np.take(x, lanes, axis=-1), self._arrays()))

    def split(self, mask: Mask) -> "tuple[Batch, Batch]":
        """Return the lanes in the mask, and the other lanes."""
        return self.of(np.flatnonzero(mask)), self.of(np.flatnonzero(~mask))

    def observed(self, begin: float, duration: PerLane) -> "Batch":
        """Return the lanes with observations that begin at `begin` [s] and last `duration` [s]."""
        return replace(self, begin=np.full_like(self.begin, begin), duration=duration.astype(self.duration.dtype))

    def joined(self, others: "list[Batch]") -> "Batch":
        """Return one batch of these lanes and the others. `underway` must be set in all batches or in none."""
        parts = [batch._arrays() for batch in (self, *others)]
        return replace(self, **map_leaves(lambda *x: np.concatenate(x, axis=-1), *parts))

    def _arrays(self) -> dict[str, Any]:
        return {name: x for name, x in vars(self).items() if name not in ("accuracy", "is_check")}


def steps_at_most(seconds: float, accuracy: Accuracy, fixed: float = LANE_MAX_STEPS) -> float:
    """Return the number of steps after which a lane with `seconds` of simulated time is abandoned.

    To `fixed` add a number per simulated second, and twice the number of steps of maximum length.
    """
    return fixed + seconds * (LANE_MAX_RATE + 2 / accuracy.step)


Bound = BoundKernel | BoundProgram
"""A program bound to the lanes of a batch."""


class Engine:
    """Compiled programs of the lanes of one scene, run by all `workers`: accelerators, or None for a CPU thread."""

    def __init__(
        self,
        scene: Scene[Any],
        run: RunSettings,
        start_names: tuple[str, ...],
        stepper: Stepper,
        recorder: Records,
        workers: "Sequence[jax.Device | None]",
    ) -> None:
        self.scene, self.run, self.workers = scene, run, workers
        self.accelerated = workers[0] is not None
        self.most_steps = LANE_MAX_STEPS
        self._dtype = np.dtype(run.precision)
        # Programs number the names of the scene, so that lanes with other names need no other program.
        self._starts = np.array([*map(scene.starts.index, start_names), len(scene.starts)], np.int32)
        kind = ProgramKey(scene, stepper, recorder, run.carry is not None)
        self.programs = Programs(kind, self._dtype, None if workers[0] is None else workers[0].platform)

    def given(self, inputs: LaneInputs) -> LaneArguments:
        """Return parameters and initial conditions of lanes, in the precision of the run."""
        parameters: dict[str, Array] = {name: x.astype(self._dtype) for name, x in inputs.parameters.items()}
        states = tuple(x.astype(self._dtype) for x in inputs.states)
        return LaneArguments(parameters, self._starts[inputs.start], states)

    def start(self, inputs: LaneInputs, accuracy: Accuracy) -> Batch:
        """Return lanes at t = 0."""
        given = self.given(inputs)
        zeros = np.zeros(len(inputs), self._dtype)
        # Steps are counted in integers: in float32, a counter would stop at 2^24 and the lane would never finish.
        steps = np.zeros(len(inputs), np.int32)
        if self.run.carry is not None:
            given = given._replace(carried=tuple(zeros for _ in self.scene.states))
        numbers = np.arange(len(inputs))
        return self.begun(
            Batch(accuracy, numbers, given, zeros + self.run.settle, zeros + self.run.observe, None, steps)
        )

    def carried(self, batch: Batch, state: Values) -> Batch:
        """Return the lanes at t = 0 in the final states of other lanes."""
        start = np.full_like(batch.given.start, CARRIED)
        return self.begun(replace(batch, given=batch.given._replace(start=start, carried=state)))

    def begun(self, batch: Batch) -> Batch:
        """Return the lanes at t = 0, in their initial states."""
        lane, carry = self._run([batch], lambda batch: self.programs.bind(start_lanes, batch.given))[0]
        return replace(batch, underway=LaneState(lane, carry, np.zeros_like(batch.recent)))

    def on_orbit(self, batch: Batch, state: Values, states: Array, times: Array, period: PerLane) -> Batch:
        """Return the lanes at t = 0 at the intersection of a periodic orbit with the section, see `lanes_on_orbit`."""
        lane, carry = self._call(
            self.workers[0],
            lambda: self.programs.bind(lanes_on_orbit, batch.given, state, states, times, period).whole(),
        )
        return replace(batch, underway=LaneState(lane, carry, np.zeros(len(batch.begin), np.int32)))

    def settle(self, batches: list[Batch], until: float = np.inf, report: Report = unreported) -> list[Batch]:
        """Return the lanes at the time `until` [s], or at the beginning of their observation if that is earlier.

        `report` is called with the number of lanes that have just reached this time, in any batch.
        """

        def program(batch: Batch) -> Bound:
            assert batch.underway is not None
            goal = np.minimum(batch.begin, until).astype(self._dtype)
            return self.programs.bind(settle_lanes, batch.given, batch.underway, goal, self._effort(batch.accuracy))

        settled = []
        for batch, underway in zip(batches, self._run(batches, program, report), strict=True):
            before = 0 if batch.underway is None else batch.underway.steps
            settled.append(replace(batch, underway=underway, recent=underway.steps - before))
        return settled

    def observe(self, batches: list[Batch], report: Report = unreported) -> list[Features]:
        """Observe the lanes of each batch and return their features; those of check runs only as far as needed.

        `report` is called with the number of lanes that have just been finished, in any batch.
        """

        def program(batch: Batch) -> Bound:
            assert batch.underway is not None
            effort, observe = self._effort(batch.accuracy), observe_lanes
            if batch.is_check and self.programs.compiles_check:
                observe = check_lanes
            return self.programs.bind(observe, batch.given, batch.underway, batch.begin, batch.duration, effort)

        return [{name: x.T for name, x in features.items()} for features in self._run(batches, program, report)]

    def compile(self, inputs: LaneInputs, accuracy: Accuracy) -> None:
        """Compile the programs once, instead of in every thread, without stepping lanes.

        On CPUs, the programs of the observation are compiled in the background while the others already run. A thread
        that needs one of them waits for it.

        **Raises:** `InputError` if the compiled arithmetic is wrong on this machine.
        """
        block = inputs.of(np.arange(min(self.programs.block, len(inputs))))
        for worker in dict.fromkeys(self.workers):
            alone = copy(self)
            alone.run, alone.workers = replace(self.run, settle=0.0, observe=0.0), [worker]
            still = [alone.start(block, accuracy)]
            check = partial(alone._call, worker, alone.programs.check_arithmetic)
            tasks: list[Callable[[], object]] = [check, partial(alone.settle, still)]
            if self.accelerated:  # else two threads that need the program would both compile it
                tasks.append(partial(alone.observe, still))
            for _ in by_drivers(lambda task: task(), tasks, len(tasks)):
                pass
            self.programs = alone.programs
            if not self.accelerated:
                observed = [*still, replace(still[0], is_check=True)]
                threading.Thread(target=_early, args=(partial(alone.observe, observed),), daemon=True).start()

    def _effort(self, accuracy: Accuracy) -> Effort:
        run = self.run
        traced = Accuracy(*(np.asarray(x, self._dtype) for x in accuracy))
        most = steps_at_most(run.settle + run.observe, accuracy, self.most_steps)
        return Effort(traced, np.int32(min(most, 2**31 - 1)))

    def _run(self, batches: list[Batch], program: Callable[[Batch], Bound], report: Report = unreported) -> list[Any]:
        """Return the results of the program that `program` binds to each batch. A call takes a few blocks of lanes."""
        bound = [self._call(self.workers[0], partial(program, batch)) for batch in batches]
        items = [item for pair in zip(bound, batches, strict=True) for item in self._calls(*pair)]

        def work(worker: "jax.Device | None", item: tuple[Bound, Index]) -> None:
            call, lanes = item
            if isinstance(call, BoundKernel):
                call(lanes)
            else:
                self._call(worker, lambda: call(lanes))
            report(len(lanes))

        for _ in in_parallel(work, items, self.workers):
            pass
        return [call.results for call in bound]

    def _call(self, worker: "jax.Device | None", call: Callable[[], Any]) -> Any:
        """Return the result of `call` on a worker's device. If no kernel can be used, switch to XLA and call again."""
        with precision(self.run.precision), jax.default_device(worker) if worker else contextlib.nullcontext():
            try:
                return call()
            except Untranslatable:
                self.programs = Programs(self.programs.kind, self._dtype, worker.platform if worker else "cpu")
                self.programs.check_arithmetic()
                return call()

    def _calls(self, bound: Bound, batch: Batch) -> list[tuple[Bound, Index]]:
        """Split the lanes of a batch into blocks, and return the lanes of each call: some blocks.

        The lanes of a block wait for the slowest of them. So a block holds lanes of similar pace, which is estimated
        from their steps in the last call (`recent`). Every call has slow and fast blocks, so that all calls take about
        the same time.
        """
        by_pace, block = np.argsort(-batch.recent, kind="stable"), self.programs.block
        count = -(-len(by_pace) // block)
        calls = max(-(-len(by_pace) // self.programs.lanes_per_call), min(len(self.workers), count))
        # Only the last block may be incomplete, and it is the last block of its call.
        number = np.arange(len(by_pace)) // block % calls
        return [(bound, by_pace[number == call]) for call in range(calls)]


def _early(task: Callable[[], object]) -> None:
    """Do ahead what is done again when its result is needed; only then are its errors raised."""
    with contextlib.suppress(Exception):
        task()

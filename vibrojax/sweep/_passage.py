"""Lanes on their way from start to end: at rest on the host between stretches, in blocks through compiled programs."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import numpy as np

from vibrojax.devices import precision
from vibrojax.sweep._accuracy import Accuracy
from vibrojax.sweep._parallel import in_parallel
from vibrojax.sweep._program import BLOCK, BLOCK_ON_ACCELERATOR, BLOCKS, compiled

MOST_STEPS, MOST_PER_SECOND = 1e6, 1e3
"""Steps after which a lane is given up: so many, and per second, and those that its longest step asks for."""

Told = Callable[[int], None]
"""Is called with a number of lanes, as they come."""


@dataclass(frozen=True)
class Passage:
    """Some lanes at one instant, on their way at one accuracy; numpy arrays whose last axis is lanes.

    - `accuracy`: what the steps follow from.
    - `parameters`, `start`: of every lane.
    - `begin`, `last`: when each is observed, and for how long [s].
    - `moving`: the lanes, and what their recorder watches; None before t = 0.
    - `steps`: taken so far; `recent`: in the last stretch.
    """

    accuracy: Accuracy
    parameters: dict[str, np.ndarray]
    start: np.ndarray
    begin: np.ndarray
    last: np.ndarray
    moving: Any
    steps: np.ndarray
    recent: np.ndarray

    def of(self, lanes: np.ndarray) -> "Passage":
        """Some of the lanes, by index."""
        arrays = {name: one for name, one in vars(self).items() if name != "accuracy"}
        return Passage(self.accuracy, **jax.tree.map(lambda x: np.take(x, lanes, axis=-1), arrays))

    def observed(self, begin, last) -> "Passage":
        """The lanes, to be observed from `begin` on for the time `last` [s], each (lanes,) or of all."""
        return replace(self, begin=np.full_like(self.begin, begin), last=np.full_like(self.last, last))


class Programs:
    """The compiled programs of a sweep's lanes, run by all `workers`."""

    def __init__(self, sweep, method, recorder, workers: list):
        self.sweep, self.method, self.recorder, self.workers = sweep, method, recorder, workers
        platform = workers[0].platform
        self.accelerated = platform != "cpu"
        self.block, self.blocks = (BLOCK_ON_ACCELERATOR, 1) if self.accelerated else (BLOCK, BLOCKS)
        self._compiled = compiled(platform)
        self.most_steps = MOST_STEPS
        self._static = (sweep.machine, method, recorder, sweep.starts, self.block)
        self._dtype = np.dtype(sweep.run.precision)

    def start(self, first: int, last: int, accuracy: Accuracy) -> Passage:
        """The lanes from `first` to before `last`, at t = 0."""
        values, start = self.sweep.lane_values(first, last)
        parameters = {name: x.astype(self._dtype) for name, x in values.items()}
        none = np.zeros(last - first, self._dtype)
        run = self.sweep.run
        # Counted in integers: float32 has no number after 2^24, at which such a lane would stay for ever.
        steps = np.zeros(last - first, np.int32)
        passage = Passage(
            accuracy, parameters, start.astype(np.int32), none + run.settle, none + run.observe, None, steps, steps
        )

        def program(count, some):
            scene, _, recorder, starts, block = self._static
            return self._compiled.start(scene, recorder, starts, block, count, some.parameters, some.start)

        return replace(passage, moving=self._through([passage], program)[0])

    def settle(self, passages: list[Passage], until: float = np.inf, told: Told = lambda lanes: None) -> list[Passage]:
        """The lanes at the time `until` [s], or when they are to be observed, if that is before.

        `told` is called with the number of lanes that have just come there, those of every passage counted.
        """

        def program(count, some):
            until_when = np.minimum(some.begin, until).astype(self._dtype)
            given = (some.parameters, some.start, *some.moving, some.steps, until_when)
            return self._compiled.settle(*self._static, count, *given, self._settings(some.accuracy))

        found = self._through(passages, program, told)
        return [
            replace(passage, moving=(lane, returns), steps=steps, recent=steps - passage.steps)
            for passage, (lane, returns, steps) in zip(passages, found, strict=True)
        ]

    def observe(self, passages: list[Passage], told: Told = lambda lanes: None) -> list[dict]:
        """Features of the lanes of each passage, by name: (lanes,), or (lanes, rows) for returns that are kept.

        `told` is called with the number of lanes that have just been finished, those of every passage counted.
        """

        def program(count, some):
            given = (some.parameters, some.start, *some.moving, some.steps, some.begin, some.last)
            return self._compiled.observe(*self._static, count, *given, self._settings(some.accuracy))

        return [
            {name: np.moveaxis(x, -1, 0) for name, x in features.items()}
            for features in self._through(passages, program, told)
        ]

    def compile(self, accuracy: Accuracy) -> None:
        """Compile the programs, once, and not by every thread; nothing is stepped."""
        at_once = replace(self.sweep, run=replace(self.sweep.run, settle=0.0, observe=0.0))
        for worker in dict.fromkeys(self.workers):
            alone = Programs(at_once, self.method, self.recorder, [worker])
            still = [alone.start(0, 1, accuracy)]
            compiling = [partial(alone.settle, still), partial(alone.observe, still)]
            for _ in in_parallel(lambda _, program: program(), compiling, range(len(compiling))):
                pass

    def _settings(self, accuracy: Accuracy) -> dict:
        run = self.sweep.run
        asked = (run.settle + run.observe) * (MOST_PER_SECOND + 2 / accuracy.step)
        settings = {name: np.asarray(x, self._dtype) for name, x in accuracy.settings().items()}
        return settings | {"most_steps": np.int32(min(self.most_steps + asked, 2**31 - 1))}

    def _through(self, passages, program, told: Told = lambda lanes: None) -> list:
        """What `program` gives for the lanes of each passage, run a few blocks at a time."""
        items = [(at, lanes) for at, passage in enumerate(passages) for lanes in self._dealt(passage.recent)]

        def work(worker, item):
            at, lanes = item
            count = np.int32(-(-len(lanes) // self.block))
            with precision(self.sweep.run.precision), jax.default_device(worker):
                found = program(count, passages[at].of(np.resize(lanes, self.block * self.blocks)))
                return jax.tree.map(np.asarray, found)

        found: list = [None] * len(passages)
        for index, part in in_parallel(work, items, self.workers):
            at, lanes = items[index]
            if found[at] is None:
                count = len(passages[at].start)
                found[at] = jax.tree.map(lambda x, n=count: np.empty((*x.shape[:-1], n), x.dtype), part)
            for whole, mine in zip(jax.tree.leaves(found[at]), jax.tree.leaves(part), strict=True):
                whole[..., lanes] = mine[..., : len(lanes)]
            told(len(lanes))
        return found

    def _dealt(self, recent: np.ndarray) -> list[np.ndarray]:
        """The lanes in blocks, dealt into hands of a few blocks.

        Lanes of a block wait for the slowest, so those that took as many steps in the stretch before go together; and
        every hand has slow blocks and fast ones, so that all take about as long.
        """
        by_pace = np.argsort(-recent, kind="stable")
        blocks = np.split(by_pace, range(self.block, len(by_pace), self.block))
        hands = max(-(-len(blocks) // self.blocks), min(len(self.workers), len(blocks)))
        # The last block alone may be short, and only where no other follows it: it is the last of its hand.
        return [np.concatenate(blocks[hand::hands]) for hand in range(hands)]

"""What is compiled once and run at many settings: the lanes of a scene with one method in one precision."""

import time
from abc import ABC, abstractmethod
from functools import partial
from typing import NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, PyTree, Shaped

from vibrojax.analyses.accuracy.cases import SOLVERS, TOLERANCE_PER_WIDTH, StudyLanes
from vibrojax.analyses.accuracy.sampled import Constants, features_of
from vibrojax.compile.devices import precision as in_precision
from vibrojax.compile.devices import workers
from vibrojax.models.arrays import Array
from vibrojax.models.scenes import Scene
from vibrojax.stepping import Accuracy
from vibrojax.stepping.adaptive import smoothed_solution, solver_named
from vibrojax.sweep.engine.chunks import Chunks
from vibrojax.sweep.engine.parallel import in_parallel
from vibrojax.sweep.input.read import read_sweep

MOST_STEPS = 1e5
"""Steps after which a lane is given up, beyond those that its longest step asks for: far fewer than in a sweep, because
a setting that is too coarse for a scene should not keep the others waiting."""

MOST_STEPS_DIFFRAX = 300_000

BLOCK = 64
"""Lanes per core: as many as step together in a sweep."""

SAMPLING = 2e-4  # s

Features = dict[str, Shaped[np.ndarray, " lanes"]]
"""Features of lanes by name, `finite`, `finished` and `steps` among them."""

Ran = dict[str, Shaped[np.ndarray, " copies"]]
"""What a run gives of all lanes and their copies, by name: `finished` and `steps` at least."""


class Program(ABC):
    """The lanes of a scene and how to run them all, copied until every core has a block of them."""

    def __init__(self, lanes: StudyLanes) -> None:
        self.lanes = lanes
        self.workers = workers()
        self.copies = max(BLOCK // lanes.count, 1) * len(self.workers)

    @property
    def lane_seconds(self) -> float:
        """Simulated time of all lanes together [s]."""
        return self.copies * self.lanes.count * (self.lanes.settle + self.lanes.observe)

    @abstractmethod
    def compile(self, accuracy: Accuracy) -> None:
        """Compile it; nothing is run."""

    @abstractmethod
    def run(self, accuracy: Accuracy) -> Ran:
        """Run all lanes and their copies: what is timed."""

    @abstractmethod
    def features(self, accuracy: Accuracy, ran: Ran) -> Features:
        """The features of each lane, of what `run` gave."""


class Own(Program):
    """The located or the smoothed stepper, as in a sweep but without the check run."""

    def __init__(self, lanes: StudyLanes, method: str, precision: str) -> None:
        super().__init__(lanes)
        self._chunks = Chunks(read_sweep(lanes.sweep(method, precision, self.copies)))
        self._chunks.engine.most_steps = MOST_STEPS

    def compile(self, accuracy: Accuracy) -> None:
        """Compile it; nothing is run."""
        self._chunks.compile()

    def run(self, accuracy: Accuracy) -> Ran:
        """All features of all lanes and their copies."""
        return self._chunks.at(accuracy)

    def features(self, accuracy: Accuracy, ran: Ran) -> Features:
        """Those of the lanes without their copies."""
        return {name: x[: self.lanes.count] for name, x in ran.items()}


class _Solved(NamedTuple):
    """States at the samples or at the end; steps taken, and whether the end was reached."""

    states: Float[np.ndarray, "states lanes *samples"]
    steps: Shaped[np.ndarray, " lanes"]
    finished: Bool[np.ndarray, " lanes"]


class Diffrax(Program):
    """A diffrax solver on the smoothed equations, vmapped over a block of lanes on each core.

    What is timed saves nothing but the end; features are read off samples of a second run.
    """

    def __init__(self, lanes: StudyLanes, method: str, precision: str) -> None:
        super().__init__(lanes)
        self._precision = precision
        self._solver, self._adapts = SOLVERS[method]
        self._sweep = read_sweep(lanes.sweep("smoothed", precision, self.copies // len(self.workers)))

    def compile(self, accuracy: Accuracy) -> None:
        """Compile it; nothing is run."""
        self._solve(self.workers[0], accuracy, end=0.0)

    def run(self, accuracy: Accuracy) -> Ran:
        """`steps` and `finished` of all lanes and their copies."""
        end = self.lanes.settle + self.lanes.observe
        blocks: list[_Solved] = [
            solved
            for _, solved in in_parallel(
                lambda worker, _: self._solve(worker, accuracy, end), self.workers, self.workers
            )
        ]
        return {
            "steps": np.concatenate([solved.steps for solved in blocks]),
            "finished": np.concatenate([solved.finished for solved in blocks]),
        }

    def features(self, accuracy: Accuracy, ran: Ran) -> Features:
        """Those that samples of the observation give."""
        count = round(self.lanes.observe / SAMPLING) + 1
        times = self.lanes.settle + np.arange(count) * SAMPLING
        solved = self._solve(self.workers[0], accuracy, float(times[-1]), times)
        with in_precision(self._precision):
            p, _ = self._inputs(self.lanes.count)
            features = features_of(self._sweep.system, p, SAMPLING, solved.states, accuracy.smoothing)
        finite = np.isfinite(solved.states).all(axis=(0, 2))
        finished = solved.finished & ran["finished"][: len(solved.finished)]
        return features | {"steps": solved.steps, "finite": finite | ~finished, "finished": finished}

    def _solve(
        self,
        worker: jax.Device,
        accuracy: Accuracy,
        end: float,
        times: Float[np.ndarray, " samples"] | None = None,
    ) -> _Solved:
        """The motion at `times` [s] or at the `end` [s]."""
        with in_precision(self._precision), jax.default_device(worker):
            p, state = self._inputs(self._sweep.lanes if times is None else self.lanes.count)
            settings = _Steps(
                jnp.asarray(accuracy.smoothing, self._precision),
                jnp.asarray(TOLERANCE_PER_WIDTH * accuracy.smoothing, self._precision) if self._adapts else None,
                jnp.asarray(accuracy.step, self._precision),
            )
            span = jnp.asarray(end, self._precision)
            samples = None if times is None else jnp.asarray(times, self._precision)
            solved = _solved(self._sweep.system, self._solver, p, state, span, settings, samples)
            states, steps, finished = jax.tree.map(np.asarray, solved)
            return _Solved(np.stack(states), steps, finished)

    def _inputs(self, count: int) -> tuple[Constants, tuple[Float[Array, " lanes"], ...]]:
        """Constants and states at t = 0 of the first `count` lanes."""
        values, start = self._sweep.lane_values(0, count)
        scene = self._sweep.system
        p = scene.constants({name: jnp.asarray(x, self._precision) for name, x in values.items()})
        each = [scene.start(p, name, (count,)) for name in self._sweep.start_names]
        return p, tuple(jnp.stack(column)[start, np.arange(count)] for column in zip(*each, strict=True))


class _Steps(NamedTuple):
    """Width of the friction switch [m/s], tolerance (relative, and absolute in SI), and length [s] of fixed steps."""

    width: Float[Array, ""]
    tolerance: Float[Array, ""] | None
    step: Float[Array, ""]


@partial(jax.jit, static_argnames=("scene", "solver"))
def _solved(
    scene: Scene,
    solver: str,
    p: Constants,
    state: tuple[Float[Array, " lanes"], ...],
    end: Float[Array, ""],
    steps: _Steps,
    times: Float[jax.Array, " samples"] | None,
) -> PyTree[Array]:
    """States, number of steps, and whether the end was reached."""
    saved = diffrax.SaveAt(t1=True) if times is None else diffrax.SaveAt(ts=times)

    def one(p: Constants, state: tuple[Array, ...]) -> PyTree[Array]:
        kind = solver_named(solver)
        solution = smoothed_solution(
            scene, p, state, end, steps.width, kind, steps.tolerance, steps.step, saved, MOST_STEPS_DIFFRAX
        )
        return solution.ys, solution.stats["num_steps"], solution.result == diffrax.RESULTS.successful

    return jax.vmap(one)(p, state)


class Programs:
    """The programs of one scene's lanes, each compiled once, and how long [s] that took."""

    def __init__(self, lanes: StudyLanes) -> None:
        self._lanes = lanes
        self._compiled: dict[tuple[str, str], tuple[Program, float]] = {}

    def of(self, method: str, precision: str, accuracy: Accuracy) -> tuple[Program, float]:
        """The program of a method in a precision, and its compile time; `accuracy` only fills in its numbers."""
        if (method, precision) not in self._compiled:
            program = (Diffrax if method in SOLVERS else Own)(self._lanes, method, precision)
            began = time.perf_counter()
            program.compile(accuracy)
            self._compiled[method, precision] = program, time.perf_counter() - began
        return self._compiled[method, precision]

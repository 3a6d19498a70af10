"""Compiled programs of the accuracy study: one per scene, method and precision, for all settings."""

from functools import partial

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, PyTree, Shaped

from vibrojax.compile.xla import precision as in_precision
from vibrojax.compile.xla import workers
from vibrojax.lanes.run import LaneRun
from vibrojax.lanes.threads import in_parallel
from vibrojax.maps.read import read_sweep
from vibrojax.physics.arrays import Array
from vibrojax.scenes import Scene
from vibrojax.stepping import Accuracy
from vibrojax.stepping.adaptive import smoothed_solution, solver_named
from vibrojax.studies.accuracy_cases import SOLVERS, TOLERANCE_PER_WIDTH, StudyLanes
from vibrojax.studies.accuracy_sampled import Constants, features_of

STUDY_MAX_STEPS = 1e5
"""Number of steps, beyond those at the longest allowed step size, after which a lane is abandoned. It is far smaller
than in a sweep, so that a setting that is too coarse for a scene does not delay the others."""

DIFFRAX_MAX_STEPS = 300_000
"""Number of steps after which diffrax abandons a lane."""

STUDY_LANES_PER_CORE = 64
"""Number of lanes per core: as many as are stepped together in a sweep."""

SAMPLING = 2e-4  # s

Features = dict[str, Shaped[np.ndarray, " lanes"]]
"""Features of lanes by name, among them `finite`, `finished` and `steps`."""

Outcome = dict[str, Shaped[np.ndarray, " copies"]]
"""Result of a run for all copies of the lanes, by name; at least `finished` and `steps`."""


class Program:
    """The located or the smoothed stepper, as in a sweep but without the check run.

    The lanes are copied until every core has a block of them.
    """

    def __init__(self, lanes: StudyLanes, method: str, precision: str) -> None:
        self.lanes = lanes
        self.copies = max(STUDY_LANES_PER_CORE // lanes.count, 1) * len(workers())
        self.prepare(method, precision)

    @property
    def lane_seconds(self) -> float:
        """Simulated time of all lanes together [s]."""
        return self.copies * self.lanes.count * (self.lanes.settle + self.lanes.observe)

    def prepare(self, method: str, precision: str) -> None:
        sweep = read_sweep(self.lanes.sweep(method, precision, self.copies))
        self._inputs = sweep.inputs()
        self._run = LaneRun(self._inputs, sweep.plan)
        self._run.engine.most_steps = STUDY_MAX_STEPS

    def compile(self, accuracy: Accuracy) -> None:
        self._run.compile(self._inputs)

    def run(self, accuracy: Accuracy) -> Outcome:
        """Run all copies of the lanes, which is the part that is timed; return at least `finished` and `steps`."""
        return self._run.at(self._inputs, accuracy)

    def features(self, accuracy: Accuracy, ran: Outcome) -> Features:
        """Return the features of each lane, of the first copy, from the result of `run`."""
        return {name: x[: self.lanes.count] for name, x in ran.items()}


class DiffraxProgram(Program):
    """A diffrax solver applied to the smoothed equations, vmapped over a block of lanes on each core.

    The timed run saves only the final states; features are computed from samples of a second run.
    """

    def prepare(self, method: str, precision: str) -> None:
        self._precision = precision
        self._solver, self._adapts = SOLVERS[method]
        self._sweep = read_sweep(self.lanes.sweep("smoothed", precision, self.copies // len(workers())))

    def compile(self, accuracy: Accuracy) -> None:
        """Compile by a run of zero duration."""
        self._solve(workers()[0], accuracy, end=0.0)

    def run(self, accuracy: Accuracy) -> Outcome:
        """Return `steps` and `finished` of all copies of the lanes."""
        end = self.lanes.settle + self.lanes.observe
        parallel = in_parallel(lambda worker, _: self._solve(worker, accuracy, end)[1:], workers(), workers())
        steps, finished = map(np.concatenate, zip(*(counts for _, counts in parallel), strict=True))
        return {"steps": steps, "finished": finished}

    def features(self, accuracy: Accuracy, ran: Outcome) -> Features:
        """Return the features from samples of the observation."""
        count = round(self.lanes.observe / SAMPLING) + 1
        times = self.lanes.settle + np.arange(count) * SAMPLING
        states, steps, finished = self._solve(workers()[0], accuracy, float(times[-1]), times)
        with in_precision(self._precision):
            p, _ = self._at_start(self.lanes.count)
            features = features_of(self._sweep.system, p, SAMPLING, states, accuracy.smoothing)
        finished = finished & ran["finished"][: len(finished)]
        return features | {
            "steps": steps,
            "finite": np.isfinite(states).all(axis=(0, 2)) | ~finished,
            "finished": finished,
        }

    def _solve(
        self, worker: jax.Device, accuracy: Accuracy, end: float, times: Float[np.ndarray, " samples"] | None = None
    ) -> tuple[Float[np.ndarray, "states lanes *samples"], Shaped[np.ndarray, " lanes"], Bool[np.ndarray, " lanes"]]:
        """Return states, numbers of steps, and whether the end was reached.

        The states are those at `times` [s], or only at `end` [s] if `times` is None.
        """
        with in_precision(self._precision), jax.default_device(worker):
            p, state = self._at_start(self._sweep.lanes if times is None else self.lanes.count)
            tolerance = TOLERANCE_PER_WIDTH * accuracy.smoothing if self._adapts else None
            numbers = end, accuracy.smoothing, tolerance, accuracy.step, times
            arrays = [None if x is None else jnp.asarray(x, self._precision) for x in numbers]
            states, steps, finished = _integrate(self._sweep.system, self._solver, p, state, *arrays)
            return np.stack([np.asarray(x) for x in states]), np.asarray(steps), np.asarray(finished)

    def _at_start(self, count: int) -> tuple[Constants, tuple[Float[Array, " lanes"], ...]]:
        """Return constants and states at t = 0 of the first `count` lanes."""
        values, start = self._sweep.lane_values(0, count)
        scene = self._sweep.system
        p = scene.constants({name: jnp.asarray(x, self._precision) for name, x in values.items()})
        each = [scene.start(p, name, (count,)) for name in self._sweep.start_names]
        return p, tuple(jnp.stack(column)[start, np.arange(count)] for column in zip(*each, strict=True))


@partial(jax.jit, static_argnames=("scene", "solver"))
def _integrate(
    scene: Scene,
    solver: str,
    p: Constants,
    state: tuple[Float[Array, " lanes"], ...],
    end: Float[Array, ""],
    width: Float[Array, ""],
    tolerance: Float[Array, ""] | None,
    step: Float[Array, ""],
    times: Float[jax.Array, " samples"] | None,
) -> PyTree[Array]:
    """Return states, number of steps, and whether the end was reached.

    **Arguments:** `width`: width [m/s] of the friction switch; `tolerance`: relative and absolute (SI) tolerance of
    adaptive steps; `step`: size [s] of fixed steps.
    """
    saved = diffrax.SaveAt(t1=True) if times is None else diffrax.SaveAt(ts=times)

    def solve_lane(p: Constants, state: tuple[Array, ...]) -> PyTree[Array]:
        solution = smoothed_solution(
            scene, p, state, end, width, solver_named(solver), tolerance, step, saved, DIFFRAX_MAX_STEPS
        )
        return solution.ys, solution.stats["num_steps"], solution.result == diffrax.RESULTS.successful

    return jax.vmap(solve_lane)(p, state)

"""Lanes and settings of the accuracy study (two CSV files), and the programs that step them.

The lanes are periodic and settle soon, so that errors are well defined. A scene lacks a setting that would take long
and add no information.
"""

from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Float, Shaped

from vibrojax.compile.xla import precision as in_precision
from vibrojax.compile.xla import workers
from vibrojax.lanes.run import LaneRun
from vibrojax.maps.read import read_sweep
from vibrojax.measures.impacts import Impacts
from vibrojax.measures.motion import Shares, Swings
from vibrojax.measures.recorder import Effort, Recorder, run_block
from vibrojax.physics.arrays import Array
from vibrojax.scenes import HasImpacts, Scene
from vibrojax.stepping import LOCATED_STRIDE, Accuracy, Goal, Lane, Smoothed, Step
from vibrojax.stepping.adaptive import smoothed_solution, solver_named
from vibrojax.threads import in_parallel

REFERENCE, SECOND_REFERENCE = Accuracy(1e-14, 0.5, np.inf), Accuracy(1e-13, 0.35, np.inf)
"""Accuracies of the reference, the located method with only rounding error left, and of another one. The difference
between both is the least error that can be measured."""

STEP_PER_WIDTH, WIDTH, STRIDE, LONGEST_STEP = 0.3, 1e-3, 0.3, 1e-2  # s per m/s, m/s, 1, s
TOLERANCE_PER_WIDTH = 1e-2
SETTINGS_TEXT = (
    f"located over tolerance has strides of at most {LOCATED_STRIDE:g} over the mode's rate, over stride no tolerance; "
    f"smoothed over width has steps of {STEP_PER_WIDTH:g} s per m/s of it, over step and stride a width of {WIDTH:g}, "
    f"with strides of at most {STRIDE:g} over the mode's rate where they are not varied; "
    f"diffrax has the smoothed equations, with relative and absolute tolerances (SI) of {TOLERANCE_PER_WIDTH:g} of the "
    f"width, or fixed steps of {STEP_PER_WIDTH:g} s per m/s of it"
)

STUDY_MAX_STEPS, DIFFRAX_MAX_STEPS = 1e5, 300_000
"""Numbers of steps after which a lane is abandoned, the first beyond those of the longest allowed size. They are small,
so that a setting that is too coarse for a scene does not delay the others."""

STUDY_LANES_PER_CORE = 64  # as many as are stepped together in a sweep
SAMPLING, STEPS_PER_SAMPLE = 2e-4, 10  # s; bound on the mean number of steps between samples: one, and one per event

_LANES, _SETTINGS = (pd.read_csv(Path(__file__).with_name(f"accuracy_{name}.csv")) for name in ("lanes", "settings"))
SCENES = tuple(_LANES["scene"].unique().tolist())

Features = dict[str, Shaped[np.ndarray, "..."]]


class Setting(NamedTuple):
    """A method ("located", "smoothed" or a diffrax solver), its precision, and the `value` of the `varied` quantity."""

    scene: str
    method: str
    precision: str
    varied: str
    value: float

    @property
    def accuracy(self) -> Accuracy:
        given = {self.varied: self.value}
        if self.method == "located":
            return Accuracy(given.get("tolerance", 1e30), given.get("stride", LOCATED_STRIDE), np.inf)
        step = {"width": STEP_PER_WIDTH * self.value, "step": self.value, "stride": LONGEST_STEP}[self.varied]
        return Accuracy(0.0, given.get("stride", STRIDE), step, given.get("width", WIDTH))


def settings_of(scene: str, quick: bool) -> list[Setting]:
    """Return all settings of a scene; those that share a program are adjacent."""
    return [
        Setting(scene, row.method, row.precision, row.varied, float(value))
        for row in _SETTINGS.itertuples()
        if row.run == ("quick" if quick else "full") and scene in row.scenes.split()
        for value in str(row.values).split()
    ]


class Program:
    """The located or the smoothed stepper on a scene's lanes, without the check run of a sweep.

    The lanes are copied until every core has a block of them. If `quick`, they are fewer, with shorter times.
    """

    def __init__(self, scene: str, method: str, precision: str, quick: bool) -> None:
        lanes = _LANES[_LANES["scene"] == scene].dropna(axis="columns").drop(columns="scene")
        lanes = lanes.iloc[:: len(lanes) // 4 if quick else 1]
        copies = max(STUDY_LANES_PER_CORE // len(lanes), 1) * len(workers())
        points = {name: column * copies for name, column in lanes.to_dict("list").items()}
        times = ((0.5, 0.5), (0.2, 0.4)) if scene == "penetration" else ((8.0, 4.0), (6.0, 2.0))
        self.count, (self.settle, self.observe) = len(lanes), times[quick]
        self.solver, self.precision = method.removeprefix("diffrax "), precision
        method = "smoothed" if method.startswith("diffrax") else method
        run: dict[str, object] = {"method": method, "precision": precision, "end_early": False}
        run |= {"settle": self.settle, "observe": self.observe, "chunk": len(lanes) * copies}
        self.sweep = read_sweep({"scene": scene, "points": points, "run": run})

    def compile(self, accuracy: Accuracy) -> None:
        self._lanes = self.sweep.inputs()
        self._run = LaneRun(self._lanes, self.sweep.plan)
        engine = self._run.engine
        engine.most_steps = STUDY_MAX_STEPS
        self._run.compile(self._lanes)
        # The observation is still being compiled in the background; a lane that ends at once waits for it.
        engine.observe([engine.start(self._lanes.of(np.arange(1)), accuracy).observed(0.0, np.zeros(1))])

    def run(self, accuracy: Accuracy) -> Features:
        """Run all copies of the lanes, which is the part that is timed; return at least `finished` and `steps`."""
        return self._run.at(self._lanes, accuracy)

    def features(self, accuracy: Accuracy, ran: Features) -> Features:
        """Return the features of the lanes, each counted once, from the result of `run`."""
        return {name: x[: self.count] for name, x in ran.items()}


class DiffraxProgram(Program):
    """A diffrax solver of the smoothed equations, vmapped over a block of lanes on each core.

    The timed run saves only final states; features are computed from samples of a second run.
    """

    def compile(self, accuracy: Accuracy) -> None:
        self._solve(workers()[0], accuracy, np.zeros(1))

    def run(self, accuracy: Accuracy) -> Features:
        end = np.array([self.settle + self.observe])
        blocks = list(in_parallel(lambda worker, _: self._solve(worker, accuracy, end), workers(), workers()))
        return {name: np.concatenate([block[name] for _, block in blocks]) for name in ("steps", "finished")}

    def features(self, accuracy: Accuracy, ran: Features) -> Features:
        times = self.settle + np.arange(round(self.observe / SAMPLING) + 1) * SAMPLING
        solved = self._solve(workers()[0], accuracy, times)
        states, finished = solved["states"], solved["finished"] & ran["finished"][: self.count]
        with in_precision(self.precision):
            numbers = (np.asarray(x, self.precision) for x in (SAMPLING, states, accuracy.smoothing))
            features = features_of(self.sweep.system, self._inputs(self.count)[0], *numbers)
        measured = {name: np.asarray(x) for name, x in features.items() if x.ndim == 1}
        return measured | {"finite": np.isfinite(states).all(axis=(0, 2)) | ~finished, "finished": finished}

    def _solve(self, worker: "jax.Device | None", accuracy: Accuracy, times: Float[np.ndarray, " times"]) -> Features:
        """Return states (states, lanes, times) [s], numbers of steps, and whether the end was reached.

        The lanes are those of a block for one time, else each lane once.
        """
        with in_precision(self.precision), jax.default_device(worker):
            p, state = self._inputs(self.sweep.lanes // len(workers()) if len(times) == 1 else self.count)
            solver, _, fixed = self.solver.partition(", fixed")
            tolerance = None if fixed else TOLERANCE_PER_WIDTH * accuracy.smoothing
            numbers = times, accuracy.smoothing, tolerance, accuracy.step
            arrays = jax.tree.map(lambda x: jnp.asarray(x, self.precision), numbers)
            return jax.tree.map(np.asarray, _integrate(self.sweep.system, solver, p, state, *arrays))

    def _inputs(self, count: int) -> tuple[Any, tuple[Float[Array, " lanes"], ...]]:
        """Return constants and states at t = 0 of the first `count` lanes."""
        values, start = self.sweep.lane_values(0, count)
        scene = self.sweep.system
        p = scene.constants({name: jnp.asarray(x, self.precision) for name, x in values.items()})
        each = [scene.start(p, name, (count,)) for name in self.sweep.start_names]
        return p, tuple(jnp.stack(column)[start, np.arange(count)] for column in zip(*each, strict=True))


@partial(jax.jit, static_argnames=("scene", "solver"))
def _integrate(
    scene: Scene[Any], solver: str, p: Any, state: Any, times: jax.Array, width: Any, tolerance: Any, step: Any
) -> dict[str, Array]:
    saved = diffrax.SaveAt(ts=times) if len(times) > 1 else diffrax.SaveAt(t1=True)

    def solve_lane(p: Any, state: Any) -> dict[str, Any]:
        rest = solver_named(solver), tolerance, step, saved, DIFFRAX_MAX_STEPS
        solution = smoothed_solution(scene, p, state, times[-1], width, *rest)
        finished = solution.result == diffrax.RESULTS.successful
        return {"states": solution.ys, "steps": solution.stats["num_steps"], "finished": finished}

    solved = jax.vmap(solve_lane)(p, state)
    return solved | {"states": jnp.stack(solved["states"])}


class _Replayed(Smoothed):
    """A stepper that continues from the next sample wherever it reaches its time.

    One step from the preceding sample locates events, so that their times have its order of accuracy. `Accuracy.step`
    holds the samples (samples, states, lanes), `Accuracy.stride` their interval [s].
    """

    def step(
        self, scene: Scene[Any], constants: Any, lane: Lane, accuracy: Accuracy, goal: Goal, marked: bool = True
    ) -> tuple[Lane, Step]:
        samples, interval = accuracy.step, accuracy.stride
        rounding = 1e-6  # fraction of the interval by which the clock may be off
        following = jnp.floor(lane.clock.high / interval + rounding) + 1
        to_sample = accuracy._replace(step=lane.clock.until(following * interval), stride=jnp.inf)
        lane, step = super().step(scene, constants, lane, to_sample, goal, marked)
        reached = lane.clock.until(following * interval) < rounding * interval
        reached &= ~jnp.stack(list(step.hits.values())).any(axis=0)
        index = jnp.minimum(following.astype(int), len(samples) - 1)
        sample = samples[index, :, jnp.arange(index.size)].T
        state = tuple(jnp.where(reached, new, old) for new, old in zip(sample, lane.state, strict=True))
        return lane._replace(state=state), step._replace(after=state)


@partial(jax.jit, static_argnames="scene")
def features_of(
    scene: Scene[Any], p: Any, sampling: Any, states: Float[Array, "states lanes samples"], width: Any
) -> dict[str, Shaped[Array, "..."]]:
    """Return the features of a smoothed motion by the package's gauges, from samples by another solver.

    `p`: the scene's constants (lanes,); `sampling`: sampling interval [s]; `width`: width [m/s] of the friction switch.
    """
    samples = jnp.moveaxis(states, 2, 0)
    gauges = (Swings(), Shares(), Impacts()) if isinstance(scene, HasImpacts) else (Swings(), Shares())
    effort = Effort(Accuracy(0.0, sampling, samples, width), STEPS_PER_SAMPLE * (len(samples) - 1))
    end = (len(samples) - 1) * sampling
    return run_block(scene, _Replayed(), Recorder(gauges), p, tuple(samples[0]), effort, 0.0, end)

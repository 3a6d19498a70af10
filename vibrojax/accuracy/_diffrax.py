"""Diffrax as a program of the study: a solver on the smoothed equations, vmapped over a block of lanes on each core."""

from functools import partial

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

from vibrojax.accuracy._lanes import Lanes
from vibrojax.accuracy._programs import Program
from vibrojax.accuracy._sampled import features_of
from vibrojax.accuracy._settings import SOLVERS, TOLERANCE_PER_WIDTH
from vibrojax.devices import precision
from vibrojax.stepping.adaptive import smoothed_solution, solver_named
from vibrojax.sweep import in_parallel, read_sweep

MOST_STEPS = 300_000
SAMPLING = 2e-4  # s


class Diffrax(Program):
    """A diffrax solver. What is timed saves nothing but the end; features are read off samples of a second run."""

    def __init__(self, lanes: Lanes, method: str, precision: str):
        super().__init__(lanes)
        self._precision = precision
        self._solver, self._adapts = SOLVERS[method]
        self._sweep = read_sweep(lanes.sweep("smoothed", precision, self.copies // len(self.workers)))

    def compile(self, accuracy):
        self._solve(self.workers[0], accuracy, end=0.0)

    def run(self, accuracy):
        end = self.lanes.settle + self.lanes.observe
        found = list(in_parallel(lambda worker, _: self._solve(worker, accuracy, end), self.workers, self.workers))
        return {
            "steps": np.concatenate([steps for _, (_, steps, _) in found]),
            "finished": np.concatenate([finished for _, (_, _, finished) in found]),
        }

    def features(self, accuracy, ran):
        count = round(self.lanes.observe / SAMPLING) + 1
        times = self.lanes.settle + np.arange(count) * SAMPLING
        states, steps, finished = self._solve(self.workers[0], accuracy, times[-1], times)
        with precision(self._precision):
            p, _ = self._inputs(self.lanes.count)
            found = features_of(self._sweep.machine, p, SAMPLING, states, accuracy.smoothing)
        finite = np.isfinite(states).all(axis=(0, 2))
        finished = finished & ran["finished"][: len(finished)]
        return found | {"steps": steps, "finite": finite | ~finished, "finished": finished}

    def _solve(self, worker, accuracy, end, times=None):
        """States (states, lanes, samples) at `times` [s] or at the `end` [s]; steps, and whether it was reached."""
        with precision(self._precision), jax.default_device(worker):
            p, state = self._inputs(self._sweep.lanes if times is None else self.lanes.count)
            real = [accuracy.smoothing, TOLERANCE_PER_WIDTH * accuracy.smoothing, accuracy.step]
            width, tolerance, step = (jnp.asarray(x, self._precision) for x in real)
            end = jnp.asarray(end, self._precision)
            times = None if times is None else jnp.asarray(times, self._precision)
            tolerance = tolerance if self._adapts else None
            found = _solved(self._sweep.machine, self._solver, p, state, end, width, tolerance, step, times)
            states, steps, finished = jax.tree.map(np.asarray, found)
            return np.stack(states), steps, finished

    def _inputs(self, count: int):
        """Constants and states at t = 0 of the first `count` lanes."""
        values, start = self._sweep.lane_values(0, count)
        machine = self._sweep.machine
        p = dict(machine.constants({name: jnp.asarray(x, self._precision) for name, x in values.items()}))
        each = [machine.start(p, name, (count,)) for name in self._sweep.starts]
        return p, tuple(jnp.stack(column)[start, np.arange(count)] for column in zip(*each, strict=True))


@partial(jax.jit, static_argnames=("scene", "solver"))
def _solved(scene, solver, p, state, end, width, tolerance, step, times):
    saved = diffrax.SaveAt(t1=True) if times is None else diffrax.SaveAt(ts=times)

    def one(p, state):
        kind = solver_named(solver)
        found = smoothed_solution(scene, p, state, end, width, kind, tolerance, step, saved, MOST_STEPS)
        return found.ys, found.stats["num_steps"], found.result == diffrax.RESULTS.successful

    return jax.vmap(one)(p, state)

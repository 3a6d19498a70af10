"""diffrax on the smoothed equations, vmapped, a block of lanes on each core: adaptive and fixed steps."""

import time
from dataclasses import dataclass
from functools import partial

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

from peers._machine import C0, C2, K0, K1, M1, MU, STICK_LIMIT, V_CR, striker
from peers._peer import CORES, Peer, Points, Ran
from vibrojax.compile.xla import precision
from vibrojax.maps.read import read_sweep
from vibrojax.studies.accuracy_programs import features_of
from vibrojax.threads import in_parallel

SAMPLING = 2e-4  # s: features are read off the samples of a second run, which is not timed
MOST_STEPS = 2_000_000


@dataclass(frozen=True)
class Width:
    """Solver, width of the friction switch [m/s], and tolerance (absolute in SI, and relative) or fixed step [s]."""

    solver: str
    width: float
    tolerance: float | None
    step: float | None = None

    def __str__(self):
        steps = f"steps {self.step:g} s" if self.step else f"tolerance {self.tolerance:g}"
        return f"{self.solver}, width {self.width:g} m/s, {steps}"


class _Smoothed(Peer):
    lanes = 128

    def __init__(self):
        self._compiled = set()

    def run(self, points, setting, settle, observe, judged):
        compiling = 0.0
        shape = setting.solver, setting.step is None, len(points)
        blocks = np.array_split(np.arange(len(points)), CORES)

        def solve(worker, block):
            return _solved(points[block], setting, settle + observe)

        if shape not in self._compiled:
            began = time.perf_counter()
            _solved(points[blocks[0]], setting, 1e-3)
            compiling = time.perf_counter() - began
            self._compiled.add(shape)
        began = time.perf_counter()
        list(in_parallel(solve, blocks, [None] * CORES))
        seconds = time.perf_counter() - began
        return Ran(*_measured(points[np.arange(judged)], setting, settle, observe), seconds, compiling)


class DiffraxAdaptive(_Smoothed):
    name = "diffrax, smoothed, adaptive"
    about = "vmapped, a block of 64 lanes on each core; the timed run measures nothing"

    def ladders(self, quick):
        if quick:
            return [[Width("Tsit5", 3e-3, 3e-5)]]
        # Dopri8 takes minutes for some lanes of the box (apparently at the kinks of friction), and is slower on the
        # others.
        return [[Width("Tsit5", width, 1e-2 * width) for width in (1e-3, 2e-4, 1e-4, 4e-5, 2e-5)]]


class DiffraxFixed(_Smoothed):
    name = "diffrax, smoothed, fixed steps"
    about = "the same with 16 lanes on each core; steps are as long as friction's width lets them be"
    lanes = 32

    def ladders(self, quick):
        rows = ((1e-3, 2e-4),) if quick else ((1e-3, 2e-4), (2.5e-4, 5e-5), (1e-4, 2e-5))
        return [[Width("Heun", width, None, step) for width, step in rows]]


def _solved(points: Points, setting: Width, end: float, times=None):
    """Return the states at the end, or at `times` [s], each (lanes,) or (lanes, times)."""
    with precision("float64"):
        rest = (setting.width, setting.tolerance or 0.0, setting.step or 0.0, float(end))
        columns = [jnp.asarray(column) for column in points.columns]
        found = _solve(setting.solver, setting.step is None, *columns, *map(jnp.asarray, rest), times)
        return tuple(np.asarray(column) for column in found)


@partial(jax.jit, static_argnums=(0, 1))
def _solve(solver, adapts, beta, gamma, v, delta, width, tolerance, step, end, times):
    saved = diffrax.SaveAt(t1=True) if times is None else diffrax.SaveAt(ts=times)
    controller = diffrax.PIDController(tolerance, tolerance) if adapts else diffrax.ConstantStepSize()

    def one(beta, gamma, v, delta):
        m2, k2 = striker(beta, gamma)

        def rates(t, y, args):
            x1, v1, x2, v2 = y
            u = v1 + v
            press = K0 * (x2 - delta) + C0 * v2
            press = jnp.where((x2 >= delta) & (press > 0), press, 0.0)
            r = jnp.abs(u) * (1 / V_CR)
            size = STICK_LIMIT * (1 - r + r * r * r * (1 / 3)) + MU * press
            friction = size * jnp.clip(u / width, -1.0, 1.0)
            pull = k2 * (x1 - x2)
            return v1, (-K1 * x1 - pull - friction) * (1 / M1), v2, (pull - C2 * v2 - press) / m2

        zero = jnp.zeros_like(v)
        found = diffrax.diffeqsolve(
            diffrax.ODETerm(rates),
            getattr(diffrax, solver)(),
            zero,
            end,
            None if adapts else step,
            (zero, -v, zero, zero),
            saveat=saved,
            stepsize_controller=controller,
            adjoint=diffrax.ForwardMode(),
            max_steps=MOST_STEPS,
            throw=False,
        )
        return found.ys

    return jax.vmap(one)(beta, gamma, v, delta)


def _measured(points: Points, setting: Width, settle: float, observe: float) -> tuple[np.ndarray, np.ndarray]:
    times = settle + np.arange(round(observe / SAMPLING) + 1) * SAMPLING
    states = np.stack(_solved(points, setting, times[-1], times))
    names = ("beta", "gamma", "v", "delta")
    lanes = {name: column.tolist() for name, column in zip(names, points.columns, strict=True)}
    sweep = read_sweep({"scene": "vibro-impact", "points": lanes | {"start": ["stuck"] * len(points)}})
    with precision("float64"):
        values, _ = sweep.lane_values(0, len(points))
        p = sweep.system.constants({name: jnp.asarray(x, "float64") for name, x in values.items()})
        found = features_of(sweep.system, p, SAMPLING, states, setting.width)
    return np.asarray(found["period"]), np.asarray(found["impact_velocity"])

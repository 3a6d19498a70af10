"""Measure the processor time per start of bSTAB's friction oscillator: `python tests/benchmarks/basin_shares.py`.

It computes the share of steady sliding for 5,000 starts in the box of Stender and Hoffmann (Nonlinear Dynamics 2021),
500 s each, at a belt speed of 1.5. vibrojax uses exact switches and steps for an error of 1e-4, and gives labels,
measures and error estimates of every lane.

With the argument `pybasin`, pybasin's solver computes the share. Its environment needs pybasin and jax, but not
vibrojax. The settings are those of pybasin's own case study, whose friction is smoothed by tanh(200 u), without its
features and its classifier. The time is the processor time of the process: user and system, all cores.
"""

import sys
import time
from functools import partial
from pathlib import Path

import numpy as np

STARTS, SETTLE, OBSERVE, SPEED = 5000, 400.0, 100.0, 1.5


def ours(end_early: bool = True) -> float:
    """Return the share of starts that end in steady sliding; settled lanes may end early."""
    sys.path[:0] = [str(Path(__file__).parents[1]), str(Path(__file__).parents[2])]
    from systems import BELT_OSCILLATOR

    import vibrojax as vj

    box = {"x": [-2.0, 2.0], "v": [0.0, 2.0]}
    starts = {"sample": "random", "count": STARTS, "seed": 1, "box": box}
    run = {"settle": SETTLE, "observe": OBSERVE, "end_early": end_early}
    tables = {"scene": BELT_OSCILLATOR, "starts": starts, "grid": {"belt": [SPEED]}, "run": run}
    lanes = vj.run_sweep(tables, progress=False)
    return float((lanes.x_amplitude < 0.2).mean())


def pybasin() -> float:
    """Return the same share by pybasin's solver: starts whose velocity is small at the end."""
    import jax.numpy as jnp
    import torch
    from pybasin.solvers import JaxSolver
    from pybasin.solvers.jax_ode_system import JaxODESystem

    class Belt(JaxODESystem):
        def ode(self, t, y, args=None):
            sliding = y[1] - SPEED
            friction = jnp.tanh(200.0 * sliding) * 0.5 * (1.0 + jnp.exp(-jnp.abs(sliding) / 0.5))
            return jnp.array([y[1], -y[0] - 0.1 * y[1] - friction])

    rng = np.random.default_rng(1)
    y0 = torch.tensor(rng.uniform([-2.0, 0.0], [2.0, 2.0], (STARTS, 2)), dtype=torch.float64)
    end = SETTLE + OBSERVE
    solver = JaxSolver(
        t_span=(0, end), t_steps=500, t_eval=(SETTLE, end), device="cpu", rtol=1e-8, atol=1e-6, cache_dir=None
    )
    _, y = solver.integrate(Belt({}), y0)
    return float((y[..., 1].abs().amax(0) < 0.5).double().mean())


def main() -> None:
    ways = {"here": ours, "here, to the end": partial(ours, False)}
    if "pybasin" in sys.argv[1:]:
        ways = {"pybasin": pybasin}
    for name, way in ways.items():
        for what in ("with compilation", "again"):
            began = time.process_time()
            share = way()
            taken = time.process_time() - began
            pace = f"{STARTS / taken:,.0f} starts per second of a core"
            print(f"{name}, {what}: share {share:.4f}, {taken:.1f} s, {pace}")


if __name__ == "__main__":
    main()

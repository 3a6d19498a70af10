"""Count the attractors over the default map, those that `drive` and `stuck` miss, and the natures of irregular lanes.

    python tests/benchmarks/coexistence.py FOLDER [EVERY]     # attractors from 64 starts at a point: 264,960 lanes
    python tests/benchmarks/coexistence.py FOLDER natures     # irregular lanes, also when run four times as long

EVERY takes every EVERY-th value of either axis, from the second on: 4 gives 16,896 lanes. A printout, not a test. Each
run takes about ten minutes of processor time, or one to two minutes with EVERY 4. The lanes stay in FOLDER, so that an
interrupted run resumes. The latest results are in tests/benchmarks/README.md.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

import vibrojax as vj
from vibrojax.io.variables import NATURES
from vibrojax.maps.run import run_to_file
from vibrojax.measures.labels import IRREGULAR
from vibrojax.periodic import natures

BOX = {"x1": [-0.02, 0.02], "v1": [-2.0, 1.0], "x2": [-0.05, 0.05], "v2": [-3.0, 3.0]}
STARTS = {"sample": "sobol", "count": 64, "seed": 0, "box": BOX}
BETA = {"start": 0.1, "stop": 1.2, "num": 45}
GAMMA = {"start": 0.3, "stop": 1.2, "num": 46}
GRID = {"beta": BETA, "gamma": GAMMA, "delta": [-0.005, 0.005]}
MAP = {"scene": "vibro-impact", "parameters": {"v": 1.5}, "grid": GRID}


def attractors(folder: Path, every: int = 1) -> None:
    """Print the attractors at points, and how often the named starts miss the one with the largest share."""
    axes = {"beta": BETA, "gamma": GAMMA}
    grid = {name: np.linspace(*axis.values())[every > 1 :: every].tolist() for name, axis in axes.items()}
    tables = MAP | {"grid": grid | {"delta": GRID["delta"]}, "starts": STARTS}
    sweep = vj.read_sweep(tables | {"run": {"settle": 300.0, "orbits": True}})
    lanes = run_to_file(replace(sweep, name="starts"), folder / "starts.nc").load()
    found = vj.attractors(lanes)
    vj.save_picture(found, folder / "share-map.png")
    share = found.share.transpose("attractor", ...).values
    there = (share > 0).sum(axis=0)
    for count in range(int(there.max()) + 1):
        print(f"{count} attractors at {(there == count).sum()} of {there.size} points")
    print(f"{int(found.unassigned.sum())} of {lanes.regime.size} lanes in none that could be told")
    irregular = ((found.regime == IRREGULAR) & (found.share > 0)).any(("beta", "gamma", "delta"))
    print(f"{found.sizes['attractor']} numbers, {int(irregular.sum())} of them of irregular motions")
    missed = []
    for name in found.named_start.values:
        led = found.named_attractor.sel(named_start=name).values
        missed.append((led >= 0) & (led != share.argmax(axis=0)))
        print(f"{name} leads to another than that of the greatest share at {missed[-1].mean():.1%} of the points")
    print(f"both do at {np.all(missed, axis=0).mean():.1%}")


def what_is_irregular() -> None:
    """Print the natures of the irregular lanes from `drive` and `stuck`, and the changes on every fourth point."""
    run = {"lyapunov": True}
    one = vj.run_sweep(MAP | {"run": run})
    irregular = one.regime.values == IRREGULAR
    counts = np.bincount(one.nature.values[irregular], minlength=len(NATURES))
    parts = ", ".join(f"{name} {count / counts.sum():.1%}" for name, count in zip(NATURES, counts, strict=True))
    print(f"of {counts.sum()} irregular lanes: {parts}")
    for name in ("RETURNS_BEFORE", "RETURNS_PER_CHECK", "EXPONENT_MIN_RETURNS", "EXPONENT_MAX_RETURNS"):
        setattr(natures, name, 4 * getattr(natures, name))
    every = {name: one[name].values[::2].tolist() for name in ("beta", "gamma")} | {"delta": GRID["delta"]}
    longer = vj.run_sweep(MAP | {"grid": every, "run": run})
    some = one.isel(beta=slice(None, None, 2), gamma=slice(None, None, 2))
    asked = some.regime.values == IRREGULAR
    changed = (some.nature.values != longer.nature.values) & asked
    print(f"of {asked.sum()} of them {changed.sum()} have another nature when they go on four times as long")


if __name__ == "__main__":
    if sys.argv[2:] == ["natures"]:
        what_is_irregular()
    else:
        attractors(Path(sys.argv[1]), *map(int, sys.argv[2:]))

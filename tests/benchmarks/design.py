"""Compare designs with maps ten times as fine per axis, and with CMA-ES and random search.

    python tests/benchmarks/design.py [maps] [draws] [search]

`maps`: for the three bundled designs, compare objective and number of lanes with the best cell of a finer map whose
corners are feasible as well. `draws`: count the random draws within the tolerances, of 200, that satisfy the
constraints. `search`: count the lanes of CMA-ES (package cma) and of random search until they reach 99.9 % of a design
of six parameters.
"""

import sys
import time
import warnings

import numpy as np

import vibrojax as vj
from vibrojax.studies.design_requirements import DesignSpec, read_design
from vibrojax.studies.design_search import Search

DESIGNS = ("energy", "rate-in-sandstone", "power-at-120-kn")
FINE, CELLS_AT_ONCE = 160, 4096
SIX = {
    "scene": "vibro-impact",
    "maximise": "impact_power",
    "vary": {"beta": [0.2, 0.7], "gamma": [0.5, 1.0], "v": [0.8, 2.0], "c2": [100.0, 400.0], "delta": [-0.006, 0.004],
             "m1": [150.0, 350.0]},
    "subject": {"regime": "single-impact", "peak_impact_force": {"most": 150e3}, "drive_power": {"most": 3e3}},
}  # fmt: skip
REACHED, SEEDS, MOST = 0.999, 10, 8000


def maps(name: str) -> None:
    spec = read_design(name)
    wall, cpu = time.perf_counter(), time.process_time()
    best = vj.design(name, progress=False)
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    value = float(best.objective[0])
    print(f"{name}: {value:.6g} with {best.attrs['lanes']} lanes, {best.attrs['orbit_solves']} orbits; "
          f"{wall:.1f} s by the clock, {cpu:.1f} s of processor time")  # fmt: skip
    own, began = Search(spec), time.process_time()
    axis = np.linspace(0, 1, FINE)
    unit = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    found = []
    for first in range(0, len(unit), CELLS_AT_ONCE):
        found += own.assess(unit[first : first + CELLS_AT_ONCE], own.centre)
    order = sorted((a for a in found if a.feasible), key=lambda a: a.rank)
    print(f"  map {FINE} x {FINE}: {own.counts['lanes']} lanes, {time.process_time() - began:.1f} s; "
          f"best cell {order[0].objective:.6g}")  # fmt: skip
    corners = np.concatenate([own.centre, own.corners])
    held = next(a for a in order if own.assess([a.unit], corners)[0].feasible)
    print(f"  best cell whose corners hold: {held.objective:.6g}")


def draws(name: str, count: int = 200) -> None:
    spec, best = read_design(name), vj.design(name, progress=False)
    rng = np.random.default_rng(7)
    own = Search(spec)
    for candidate in range(best.sizes["candidate"]):
        values = np.array([float(best[key][candidate]) for key in spec.varied])
        offsets = rng.uniform(-1, 1, (count, len(spec.tolerances)))
        [found] = own.assess([(values - spec.low) / (spec.high - spec.low)], offsets)
        print(f"{name}, candidate {candidate}: {found.good.all(axis=1).sum()} of {count} draws keep the constraints")


def search() -> None:
    spec = read_design(SIX)
    best = vj.design(SIX, progress=False)
    target = REACHED * float(best.objective[0])
    print(f"six parameters: {float(best.objective[0]):.6g} with {best.attrs['lanes']} lanes, "
          f"{best.attrs['orbit_solves']} orbits")  # fmt: skip
    for method in (by_cma, by_random):
        lanes = [method(spec, target, seed) for seed in range(SEEDS)]
        reached = sum(n < np.inf for n in lanes)
        print(f"{method.__name__}: reached by {reached} of {SEEDS}; median {np.median(lanes):g} lanes, "
              f"{np.median(lanes) / best.attrs['lanes']:.1f} times as many; {sorted(lanes)}")  # fmt: skip


def costs(own: Search, unit: np.ndarray) -> np.ndarray:
    """Return the quantity to minimise: minus the objective of feasible points, else a penalty."""
    return np.array([-a.objective if a.feasible else 1e3 * a.badness for a in own.assess(unit, own.centre)])


def by_cma(spec: DesignSpec, target: float, seed: int) -> float:
    import cma

    own = Search(spec)
    rng = np.random.default_rng(seed)
    while own.counts["lanes"] < MOST:  # restarts from random points
        options = {"bounds": [0, 1], "seed": int(rng.integers(1, 2**31)), "verbose": -9}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            run = cma.CMAEvolutionStrategy(rng.uniform(0, 1, len(spec.varied)), 0.3, options)
            while not run.stop() and own.counts["lanes"] < MOST:
                points = run.ask()
                values = costs(own, np.array(points))
                if values.min() <= -target:
                    return own.counts["lanes"]
                run.tell(points, values.tolist())
    return np.inf


def by_random(spec: DesignSpec, target: float, seed: int) -> float:
    own, rng = Search(spec), np.random.default_rng(seed)
    while own.counts["lanes"] < MOST:
        if costs(own, rng.uniform(0, 1, (200, len(spec.varied)))).min() <= -target:
            return own.counts["lanes"]
    return np.inf


if __name__ == "__main__":
    asked = sys.argv[1:] or ["maps", "draws", "search"]
    for design in DESIGNS:
        if "maps" in asked:
            maps(design)
        if "draws" in asked:
            draws(design)
    if "search" in asked:
        search()

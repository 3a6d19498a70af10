"""Measure the speed of continuation and of borders: `python tests/benchmarks/families.py`, a minute.

Branches of the default drill over gamma, 0.3 to 1.6, start from the strong single impact at 10, 100 and 400 mass ratios
at once. They run without doubled branches and with those of two returns, after compilation. Then come the borders of
the given default map.
"""

import time

import numpy as np

import vibrojax as vj
from vibrojax.periodic.families import FamilyContinuation
from vibrojax.periodic.problem import Problem
from vibrojax.studies.family import problem_of
from vibrojax.studies.family_spec import family_spec

SPAN = (0.3, 1.6)


def problem(count: int) -> tuple[Problem, np.ndarray, list[np.ndarray]]:
    """Return the equations of `count` branches, and their initial points."""
    betas = np.linspace(0.26, 0.6, count).tolist()
    asked = family_spec("vibro-impact", "gamma", 0.72, SPAN, "stuck", 40.0, 8.0, 8, {"beta": betas})
    return problem_of(asked, vj.run_sweep(asked.sweep, progress=False))


def main() -> None:
    print("families  returns  branches  segments  points  special  seconds  processor  branches/s  points/s")
    for count in (10, 100, 400):
        equations, families, begin = problem(count)
        FamilyContinuation(equations, cycles=2)(families[:2], begin[:2])
        for cycles in (1, 2):
            wall, cpu = time.perf_counter(), time.process_time()
            segments = FamilyContinuation(equations, cycles=cycles)(families, begin)
            wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
            branches = len({(segment.family, segment.branch) for segment in segments})
            points = sum(len(segment.points.u) for segment in segments if segment.points is not None)
            special = sum(len(segment.marks) for segment in segments)
            print(
                f"{len(families):8d} {cycles:8d} {branches:9d} {len(segments):9d} {points:7d} {special:8d} {wall:8.2f} "
                f"{cpu:10.2f} {branches / wall:11.1f} {points / wall:9.0f}"
            )
    sweep = vj.run_sweep(vj.read_sweep("regime-map", ["run.orbits=true"]), progress=False)
    for _ in range(2):
        wall, cpu = time.perf_counter(), time.process_time()
        found = vj.borders(sweep, progress=False)
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        print(f"borders of the default map: {wall:.1f} s ({cpu:.1f} of processor time), {found.sizes['curve']} curves")


if __name__ == "__main__":
    main()

"""Measure the speed of continuation and of borders: `python tests/benchmarks/families.py`, a minute.

Branches of the default drill over gamma, 0.3 to 1.6, start from the strong single impact at 10, 100 and 400 mass ratios
at once. They run without doubled branches and with those of two returns, after compilation; the measures of the points
count as well. Then come the borders of the given default map.
"""

import time

import numpy as np

import vibrojax as vj


def main() -> None:
    print("families  returns  points  special  seconds  processor  points/s")
    for count in (10, 100, 400):
        for cycles in (1, 2):
            point = {"at": 0.72, "span": (0.3, 1.6), "start": "stuck", "beta": np.linspace(0.26, 0.6, count)}
            for _ in range(2):  # the first run compiles
                wall, cpu = time.perf_counter(), time.process_time()
                found = vj.follow("vibro-impact", along="gamma", cycles=cycles, progress=False, **point)
                wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
            points, special = found.sizes["point"], found.sizes["special"]
            row = f"{count:8d} {cycles:8d} {points:7d} {special:8d} {wall:8.2f} {cpu:10.2f} {points / wall:9.0f}"
            print(row)
    sweep = vj.run_sweep(vj.read_sweep("regime-map", ["run.orbits=true"]), progress=False)
    for _ in range(2):
        wall, cpu = time.perf_counter(), time.process_time()
        found = vj.borders(sweep, progress=False)
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        print(f"borders of the default map: {wall:.1f} s ({cpu:.1f} of processor time), {found.sizes['curve']} curves")


if __name__ == "__main__":
    main()

"""Measure the processor time per start at a point with many starts, with and without shared orbits.

    python tests/benchmarks/starts.py [STARTS]

The start-up (import, trace and compile) is listed separately, as the time of a few starts. The latest results are in
tests/benchmarks/README.md.
"""

import sys
import time

import numpy as np

import vibrojax as vj
from vibrojax.periodic import lane_stages

BOX = {"x1": [-0.02, 0.02], "v1": [-2.0, 1.0], "x2": [-0.05, 0.05], "v2": [-3.0, 3.0]}
ONE = {"beta": [0.4], "gamma": [0.75]}
SEVERAL = {"beta": [0.4], "gamma": np.linspace(0.3, 0.85, 23).tolist()}


def asked(count: int, grid: dict[str, list[float]]) -> dict[str, object]:
    starts = {"sample": "sobol", "count": count, "seed": 1, "box": BOX}
    return {"scene": "vibro-impact", "parameters": {"delta": 0.005}, "starts": starts, "grid": grid}


def main(count: int = 10_000) -> None:
    vj.attractors(asked(32, ONE), progress=False)
    print(f"start-up: {time.process_time():.1f} s of processor time")
    shared = lane_stages.SHARING_MIN_STARTS
    for number, grid in ((count, ONE), (256, SEVERAL)):
        lanes = number * len(grid["gamma"])
        for least, how in ((shared, "shared"), (2**40, "each lane by itself")):
            lane_stages.SHARING_MIN_STARTS = least
            began = time.process_time()
            found = vj.attractors(asked(number, grid), progress=False)
            taken = time.process_time() - began
            told = f"{found.sizes['attractor']} attractors, {int(found.unassigned.sum())} unassigned"
            print(f"{lanes} starts, {how}: {taken:.2f} s, {lanes / taken:,.0f} starts a second; {told}")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))

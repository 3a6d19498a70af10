"""Compare lanes of periodic motion after 10^5 cycles with the same lanes after a thousand cycles.

python tests/benchmarks/long.py        about 2 minutes
"""

import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2]))
from vibrojax.lanes.run import LaneRun
from vibrojax.maps.read import read_sweep

POINTS = {"beta": np.linspace(0.25, 0.6, 32).tolist(), "gamma": [0.75] * 32, "delta": [-0.005, 0.005] * 16}
ERROR = 1e-5
SETTLE = {"short": 400.0, "twice": 800.0, "long": 4e4}  # s


def main():
    results = {}
    for name, settle in SETTLE.items():
        began = time.perf_counter()
        run = {"settle": settle, "end_early": False, "error": ERROR}
        sweep = read_sweep({"scene": "vibro-impact", "points": POINTS, "run": run})
        inputs = sweep.inputs()
        lanes = LaneRun(inputs, sweep.plan)
        results[name] = lanes.at(inputs, lanes.accuracy)
        print(f"{name:8}{settle:8g} s settled in {time.perf_counter() - began:.0f} s", flush=True)
    short, long = results["short"], results["long"]
    periodic = short["cycles"] > 0
    same = (long["cycles"] == short["cycles"])[periodic]
    fewest = (SETTLE["long"] / long["period"])[periodic].min()
    steps = long["steps"][periodic].max()
    print(f"{periodic.sum()} of {periodic.size} lanes repeat; {same.sum()} of them after {fewest:.0f} cycles and more")
    print(f"{steps:.3g} steps at most; all came to their end: {bool(long['finished'].all())}")
    for name in ("period", "impact_velocity"):
        for other in ("twice", "long"):
            deviation = np.abs(results[other][name] / short[name] - 1)[periodic]
            print(f"{name:16}short to {other:6}{deviation.max():.1e}")


if __name__ == "__main__":
    main()

"""Count the labels that change between 40 and 300 s of settling, and those that nearby orbits predict.

    python tests/benchmarks/long_transients.py

A printout, not a test; about 20 s. The latest results are in tests/hard/README.md.
"""

import numpy as np

import vibrojax as vj

LANES, SOON, LATE = 4096, 40.0, 300.0


def main() -> None:
    rng = np.random.default_rng(14)
    points = {
        "beta": rng.uniform(0.1, 1.2, LANES).tolist(),
        "gamma": rng.uniform(0.3, 1.2, LANES).tolist(),
        "v": rng.uniform(0.5, 2.0, LANES).tolist(),
        "delta": [(-0.005, 0.005)[lane % 2] for lane in range(LANES)],
        "start": [("stuck", "drive")[lane // 2 % 2] for lane in range(LANES)],
    }
    soon, late = (
        vj.run_sweep({"scene": "vibro-impact", "points": points, "run": {"settle": settle, "orbits": True}})
        for settle in (SOON, LATE)
    )
    before, changed = soon.regime.values, soon.regime.values != late.regime.values
    unsettled = np.isin(before, (0, 6))
    near = (soon.nearby_cycles > 0).values & unsettled
    there = near & (late.orbit_cycles == soon.nearby_cycles).values
    print(f"{changed.sum()} of {LANES} labels are others after {LATE:g} s than after {SOON:g} s")
    print(f"of {(~unsettled).sum()} neither irregular nor undecided {(changed & ~unsettled).sum()} are")
    print(f"of {unsettled.sum()} irregular or undecided {near.sum()} have a stable orbit nearby", end=", ")
    print(f"on which {there.sum()} are after {LATE:g} s; {(changed & near).sum()} of their labels change")


if __name__ == "__main__":
    main()

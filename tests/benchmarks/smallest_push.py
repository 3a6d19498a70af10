"""Compare the smallest pushes out of the working cycle with a scan four times as fine, at random points.

    python tests/benchmarks/smallest_push.py [POINTS]

For 100 points, the benchmark counts the directions that leave the basin within the bound, and those in which both scans
agree. It also counts the holes in the basin that only the fine scan finds, and gives both times.
"""

import sys
import time

import numpy as np

import vibrojax as vj

BOX = {"beta": (0.1, 1.2), "gamma": (0.3, 1.2), "delta": (-0.005, 0.005), "v": (0.5, 2.5)}
STATES = ("x1", "v1", "x2", "v2")
FINER, AT_ONCE = 4, 25


def main(wanted: int = 100) -> None:
    rng = np.random.default_rng(16)
    points = {name: rng.uniform(*ends, 3 * wanted).tolist() for name, ends in BOX.items()}
    orbits = vj.run_sweep(
        {"scene": "vibro-impact", "points": points, "starts": ["stuck"], "run": {"orbits": True}}, progress=False
    )
    some = np.flatnonzero(orbits.stable.values.ravel() == 1)[:wanted]
    scan = vj.smallest_push.__kwdefaults__["scan"]
    found, taken = [], np.zeros(2)
    for first in range(0, len(some), AT_ONCE):
        here = {name: np.array(x)[some[first : first + AT_ONCE]].tolist() for name, x in points.items()}
        for k, fine in enumerate((1, FINER)):
            began = time.process_time()
            one = vj.smallest_push("vibro-impact", start="stuck", scan=fine * scan, progress=False, **here)
            taken[k] += time.process_time() - began
            found.append([np.stack([one[f"{name}_{state}"] for state in STATES]) for name in ("push", "bracket")])
        told(found, first + AT_ONCE, taken)


def told(found: list[list[np.ndarray]], points: int, taken: np.ndarray) -> None:
    (push, width), (true, fine) = (
        [np.concatenate([one[k] for one in found[which::2]], axis=1) for k in (0, 1)] for which in (0, 1)
    )
    either = np.isfinite(push) | np.isfinite(true)
    same = np.abs(push - true) <= np.fmax(width, fine)
    smaller, greater = (true < push) & ~same, (true > push) & ~same
    alone = (np.isnan(push) & either).sum(), (np.isnan(true) & either).sum()
    print(f"{points} points, {taken[0]:.0f} s of processor time and {taken[1]:.0f} s")
    print(f"of {either.size} directions {either.sum()} leave; both find the same push in {same.sum()}")
    print(f"the fine scan a smaller one in {smaller.sum()}: {np.round(np.sort((true / push)[smaller]), 2)} of it")
    print(
        f"the fine scan a greater one in {greater.sum()}; found by it alone {alone[0]}, by the other alone {alone[1]}"
    )


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))

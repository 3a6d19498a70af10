"""Smallest pushes out of the working cycle against a scan four times as fine, at random points.

    python tests/benchmarks/smallest_push.py [POINTS]

Of 100 points: how many directions leave within the bound, in how many of them both find the same push, where the fine
scan finds a smaller one, through a hole in the basin that the other missed, and what both take.
"""

import sys
import time

import numpy as np

import vibrojax as vj

BOX = {"beta": (0.1, 1.2), "gamma": (0.3, 1.2), "delta": (-0.005, 0.005), "v": (0.5, 2.5)}
FINE = 1024
STATES = ("x1", "v1", "x2", "v2")


def main(wanted: int = 100) -> None:
    rng = np.random.default_rng(16)
    points = {name: rng.uniform(*ends, 3 * wanted).tolist() for name, ends in BOX.items()}
    orbits = vj.run_sweep(
        {"scene": "vibro-impact", "points": points, "starts": ["stuck"], "run": {"orbits": True}}, progress=False
    )
    some = np.flatnonzero(orbits.stable.values.ravel() == 1)[:wanted]
    points = {name: np.array(x)[some].tolist() for name, x in points.items()}
    print(f"{len(some)} points with a stable cycle")
    runs = []
    for scan in (vj.smallest_push.__kwdefaults__["scan"], FINE):
        began = time.process_time()
        runs.append(vj.smallest_push("vibro-impact", start="stuck", scan=scan, progress=False, **points))
        print(f"scan of {scan}: {time.process_time() - began:.1f} s of processor time")
    usual, fine = (
        [np.concatenate([one[f"{name}_{state}"].values for state in STATES], axis=1) for name in ("push", "bracket")]
        for one in runs
    )
    push, true, within = usual[0], fine[0], np.fmax(usual[1], fine[1])
    either, none = np.isfinite(push) | np.isfinite(true), np.isnan(push)
    same = np.abs(push - true) <= within
    print(f"of {either.size} directions {either.sum()} leave; the same push in {same.sum()}")
    smaller, greater = (true < push) & ~same, (true > push) & ~same
    ratio = np.round(np.sort((true / push)[smaller]), 2)
    print(f"fine: smaller in {smaller.sum()} (by {ratio}), greater in {greater.sum()}")
    print(
        f"found by the fine one alone {(none & either).sum()}, by the usual one alone {(np.isnan(true) & either).sum()}"
    )


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))

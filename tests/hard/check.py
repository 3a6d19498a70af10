"""Compare every hard case, in every precision and scene, with the exact reference; print a table and the counts.

python tests/hard/check.py                        about 5 minutes
python tests/hard/check.py --error 1e-6           with the steps of another accepted error (default 1e-4)
python tests/hard/check.py vibro-impact           one of the sets below
"""

import sys
import time
from argparse import ArgumentParser
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))
sys.path.insert(0, str(Path(__file__).parents[2]))
from cases import DRILL, ROCK, USUAL, bound_of, columns, lanes, reference, verdict

import vibrojax as vj

DRILLING = {"beta": 0.4, "gamma": 0.6, "start": "stuck"}
SETS = {  # scene, cases, usual point, precision, seconds, bound on the relative deviation
    "vibro-impact": ("vibro-impact", DRILL, USUAL, "float64", 1.2, 1e-5),
    "vibro-impact, float32": ("vibro-impact", DRILL, USUAL, "float32", 1.2, 3e-3),
    "drilling": ("drilling", ROCK, DRILLING | {"zeta": 1.5, "threshold": 61.9e3, "k3": 100.68e6}, "float64", 1.0, 1e-5),
    "coupled-drilling": (
        "coupled-drilling",
        ROCK,
        DRILLING | {"zeta": 1.5, "threshold": 61.9e3, "k3": 100.68e6},
        "float64",
        1.0,
        1e-5,
    ),
    "penetration": ("penetration", ROCK, {"zeta": 1.1, "threshold": 150e3, "k3": 300e6}, "float64", 0.5, 1e-5),
}
ERROR = 1e-4
"""Default accepted error of the runs. The bounds above are tighter than what it promises; its steps keep them."""

SETTLE = {"penetration": 0.1}  # s: the package does not count the pulse at t = 0, so whole pulses would differ by one


def main(names, error):
    for name in names:
        scene, cases, usual, precision, observe, bound = SETS[name]
        began = time.perf_counter()
        run = {"settle": SETTLE.get(scene, 0.0), "observe": observe, "precision": precision, "error": error}
        dataset = vj.run_sweep({"scene": scene, "points": columns(cases, usual), "run": run}, progress=False)
        counts = Counter()
        for index, (case, changes) in enumerate(lanes(cases)):
            measured = reference(scene, usual | changes, observe, SETTLE.get(scene, 0.0))
            kind, remark = verdict(dataset.isel(point=index), measured, bound_of(case, changes, bound, precision))
            counts[kind] += 1
            print(f"{name:24}{case:22}{kind:10}{remark:34}{changes}", flush=True)
        print(f"{name}: {dict(counts)}, {time.perf_counter() - began:.0f} s\n", flush=True)


if __name__ == "__main__":
    parser = ArgumentParser()
    parser.add_argument("names", nargs="*", metavar="SET")
    parser.add_argument("--error", type=float, default=ERROR)
    arguments = parser.parse_args()
    main(arguments.names or SETS, arguments.error)

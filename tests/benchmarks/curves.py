"""Compare crossings of curves with the special points that `follow` locates, and measure the time of a hundred curves.

    python tests/benchmarks/curves.py

`follow` continues branches along one parameter on several lines of the other one. The special points of each branch are
continued across all lines. A crossing counts if a branch on that line has a special point of its kind nearby.
"""

import time
from collections import defaultdict

import numpy as np
import xarray as xr

import vibrojax as vj
from vibrojax.periodic.curve_following import crossings, follow_curves
from vibrojax.pictures.branches import kind_names
from vibrojax.studies.curves import problem_of, read_curves

NEARBY = 1e-5
"""Distance, relative to the range of the parameter, within which special points of one kind are compared."""

STRONG, FREE = {"delta": 0.005}, {"delta": -0.005}
CASES = [
    ("gamma", 0.75, (0.3, 1.6), "beta", (0.1, 1.2), np.linspace(0.2, 0.7, 11), "stuck", STRONG),
    ("gamma", 0.75, (0.3, 1.6), "beta", (0.1, 1.2), np.linspace(0.2, 0.7, 11), "drive", FREE),
    ("gamma", 0.75, (0.3, 1.6), "v", (0.3, 3.0), np.linspace(0.8, 2.0, 7), "stuck", STRONG | {"beta": 0.4}),
    ("beta", 0.4, (0.1, 1.2), "delta", (-0.01, 0.01), np.linspace(-0.006, 0.006, 7), "stuck", {"gamma": 0.75}),
]
"""Parameter of the branches, its first value and bounds; second parameter, its bounds and lines; start; parameters."""


def compare(case: tuple) -> tuple[dict[str, list[float]], int, float]:
    """Return the differences by kind, the number of curves, and their computing time [s]."""
    along, at, span, by, bounds, lines, start, fixed = case
    common = {"along": along, "at": at, "span": span, "start": start, "cycles": 2, "progress": False}
    family = vj.follow("vibro-impact", **common, **fixed, **{by: lines.tolist()})
    known = points_by_line(family)
    spec = read_curves(family, by, bounds, None, None)
    begun = time.perf_counter()
    problem, unknowns = problem_of(spec)
    found = follow_curves(problem, unknowns, lambda ends: None)
    seconds = time.perf_counter() - begun
    differences = defaultdict(list)
    for curve in found:
        kind = str(problem.kinds[curve.number])
        for line, value in enumerate(lines):
            if value == spec.parameters[by][curve.number]:
                continue  # the curve began on this line
            for part in curve.parts:
                for point in crossings(problem, part, 1, float(value)):
                    place = problem.values(point.family, point.u)[0, 0]
                    others = np.array(known[line, kind, point.times.shape[1]])
                    off = np.abs(others - place)
                    if len(off) and off.min() < NEARBY * (span[1] - span[0]):
                        differences[kind].append(off.min() / abs(place))
    return differences, len(found), seconds


def points_by_line(family: xr.Dataset) -> dict[tuple[int, str, int], list[float]]:
    """Return the values of special points by line, kind and number of section crossings."""
    known = defaultdict(list)
    for k, kind in enumerate(kind_names(family)):
        for cycles in (1, 2):
            known[int(family.special_family[k]), kind, cycles].append(float(family.special_value[k]))
    return known


def main() -> None:
    every = defaultdict(list)
    number, seconds = 0, 0.0
    for case in CASES:
        differences, curves, taken = compare(case)
        number, seconds = number + curves, seconds + taken
        for kind, values in differences.items():
            every[kind] += values
        print(f"{case[0]} and {case[3]}: {curves} curves in {taken:.1f} s")
    for kind, values in every.items():
        print(f"{kind}: {len(values)} crossings, median {np.median(values):.1e}, largest {max(values):.1e}")
    total = sum(map(len, every.values()))
    within = sum(sum(x < 1e-8 for x in values) for values in every.values())
    print(f"{within} of {total} crossings agree to 1e-8; {number} curves took {seconds:.0f} s")


if __name__ == "__main__":
    main()

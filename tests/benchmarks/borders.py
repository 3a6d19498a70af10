"""Compare the borders that begin from a grid of 10 x 10 points with those from 90 x 46 points over the same plane.

    python tests/benchmarks/borders.py

Each continued border is compared where it crosses lines of constant mass ratio. The difference is relative.
"""

import time

import numpy as np

import vibrojax as vj
from vibrojax.io.kinds import BORDER_KINDS
from vibrojax.maps.rerun import sweep_with_orbits
from vibrojax.studies.borders import Regions

LINES = np.linspace(0.125, 1.005, 23)
"""Mass ratios of the lines; no grid has a point there."""

SAME = 1e-4
"""Largest difference in the frequency ratio of crossings that are compared."""


def crossings(regions: Regions, beta: float) -> list[tuple[str, float]]:
    """Return kind and frequency ratio of the crossings of the borders of all stable single impacts with one line."""
    ds = regions.borders(("beta", beta), progress=False)
    numbers = ds.crossing_curve.values
    return [
        (BORDER_KINDS[ds.kind.values[number]], float(gamma))
        for number, gamma in zip(numbers, ds.crossing_gamma.values, strict=True)
        if ds.start.values[number] == "any"
    ]


def main() -> None:
    of_grid = []
    for gammas, betas in ((10, 10), (90, 46)):
        grid = {"gamma": {"start": 0.3, "stop": 1.6, "num": gammas}, "beta": {"start": 0.1, "stop": 1.2, "num": betas}}
        fixed = {"scene": "vibro-impact", "parameters": {"delta": 0.005}, "starts": ["stuck"]}
        lanes = vj.run_sweep(fixed | {"grid": grid, "run": {"orbits": True}}, progress=False)
        begun = time.process_time()
        regions = Regions(sweep_with_orbits(lanes), lanes, ("gamma", "beta"))
        located = time.process_time()
        ds = regions.borders(progress=False)
        seconds = located - begun, time.process_time() - located
        print(f"{ds.attrs['begun_from']}")
        print(f"processor time: {seconds[0]:.1f} s to locate the points, {seconds[1]:.1f} s to continue the curves")
        of_grid.append(regions)
    differences, missing = [], []
    for beta in LINES.tolist():
        coarse, fine = (crossings(regions, beta) for regions in of_grid)
        for kind, gamma in fine:
            off = [abs(other - gamma) for name, other in coarse if name == kind]
            if off and min(off) < SAME:
                differences.append(min(off) / gamma)
            else:
                missing.append(f"{kind} at gamma = {gamma:.6g}, beta = {beta:.6g}")
    print(f"{len(differences)} crossings, largest difference {max(differences):.1e}")
    print(f"missing from the coarse grid: {'; '.join(missing) or 'none'}")


if __name__ == "__main__":
    main()

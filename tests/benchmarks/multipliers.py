"""Compare the multipliers of random orbits with the exact reference (tests/exact), one line per friction law.

python tests/benchmarks/multipliers.py [ORBITS]
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
from random_orbits import LAWS, drawn, off_by_differences, off_by_volumes

SEED = 15
POINTS_PER_ORBIT = 8


def main(wanted: int = 64) -> None:
    each = wanted // len(LAWS)
    for law in LAWS:
        orbits = drawn(law, POINTS_PER_ORBIT * each, SEED)[:each]
        off = [off_by_differences(orbit) for orbit in orbits]
        sliding = [orbit for orbit in orbits if orbit.stick == 0]
        volumes = [off_by_volumes(orbit) for orbit in sliding]
        cycles = sorted({orbit.cycles for orbit in orbits})
        print(
            f"{law}: {len(orbits)} orbits of {cycles} returns, {sum(o.stick > 0 for o in orbits)} stick,"
            f" {sum(o.reverse > 0 for o in orbits)} slip backwards; by central differences {np.max(off):.1e} off"
            f" (median {np.median(off):.1e})",
            flush=True,
        )
        if volumes:
            worst, jumps = max(one for one, _ in volumes), [jump for _, jump in volumes if abs(jump - 1) > 1e-9]
            print(f"    {len(volumes)} without stick: products {worst:.1e} off; saltations in {len(jumps)}", flush=True)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))

"""Exports of rigs with planted laws: `write` writes a file, and returns its path and what is planted.

    path, planted = exports.write(tmp_path, "pason", [(15 / 3600, 40e3)], founder=160e3)

The rate of each formation is C ln(W/D), below the founder point; above it, it falls.
"""

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2] / "notebooks"))
import rig_logs


def write(folder, dialect, formations, founder=None, count=600, noise=0.03, seed=5):
    """Write an export with traps and six outliers; `formations` holds C [m/s] and D [N] of each."""
    rng = np.random.default_rng(seed)
    rows = rig_logs.drilling(count, seed=seed)
    formation = np.sort(np.arange(count) % len(formations))
    rows["formation"] = np.array(["chalk", "shale"])[formation]
    rows["weight"] = weight = rig_logs.weights((count,), rng, 75e3, 210e3)
    C, D = np.array(formations)[formation].T
    end = founder or np.inf
    rate = C * np.log(np.minimum(weight, end) / D) * (1 - np.maximum(weight / end - 1, 0))
    rate *= 1 + noise * rig_logs.correlated((count,), 0.7, rng)
    rate[rng.choice(count, 6, replace=False)] *= 1.9
    rows, dropped = rig_logs.with_traps(rows | {"rate": rate})
    path = rig_logs.write(folder / f"log.{'las' if dialect == 'las' else 'csv'}", dialect, rows)
    return path, {"formations": formations, "founder": founder, "dropped": dropped, "rows": count}

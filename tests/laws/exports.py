"""Exports of rigs with a planted law: each function writes a file, and returns its path and what is planted.

    path, planted = exports.with_founder(tmp_path)
    fit = vj.fit_rop(path, **planted["reading"])

`planted` has `C` [m/s] (a list by formation, where there are several), `onset` [N], `founder` [N] (NaN without one),
`form`, `rows` (those that are drilling), and `reading`, the arguments of `fit_rop` and `read_log`.
"""

import numpy as np

FOOT, POUND_FORCE, TONNE_FORCE = 0.3048, 4.4482216152605, 9806.65


def _weights(count, rng, low, high):
    """Return weights on bit [N] that a driller changes every dozen rows."""
    steps = rng.uniform(low, high, count // 12 + 1)
    return np.repeat(steps, 12)[:count] + 500.0 * rng.standard_normal(count)


def with_founder(folder, count=600, noise=0.03, seed=5):
    """Write a Pason-like CSV in field units, with a founder point at 160 kN, sliding, connections and outliers."""
    rng, C, D, founder = np.random.default_rng(seed), 8 / 3600, 40e3, 160e3
    weight = _weights(count, rng, 60e3, 210e3)
    rate = C * np.log(np.minimum(weight, founder) / D) * (1 - 0.3 * np.maximum(weight / founder - 1, 0))
    rate *= 1 + noise * rng.standard_normal(count)
    wrong = rng.choice(count, 6, replace=False)
    rate[wrong] *= rng.uniform(1.5, 2.0, 6)
    speed = np.where(np.arange(count) % 100 < 5, 0.0, 120.0)  # sliding
    feed = np.where(np.arange(count) % 97 == 50, 2978.0, rate * 3600 / FOOT)  # connections
    lines = ["Pason export,,,,,,", "YYYY/MM/DD,HH:MM:SS,Hole Depth (feet),Rate Of Penetration (ft_per_hr),"]
    lines[1] += "Weight on Bit (klbs),Rotary RPM (RPM),Surface Torque (ft-lbf)"
    for k in range(count):
        seconds = 85_000 + 10 * k
        clock = (
            f"2024/03/{4 + seconds // 86_400:02},{seconds // 3600 % 24:02}:{seconds // 60 % 60:02}:{seconds % 60:02}"
        )
        cells = (5000 + k, feed[k], weight[k] / POUND_FORCE / 1e3, speed[k], 6000 + 20 * (k % 7))
        lines.append(",".join([clock, *(f"{cell:.6g}" for cell in cells)]))
    path = folder / "founder.csv"
    path.write_text("\n".join(lines) + "\n")
    rows = int(((speed > 0) & (feed < 500)).sum())
    return path, {"C": C, "onset": D, "founder": founder, "form": "onset", "rows": rows, "reading": {}}

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


def two_formations(folder, count=400, noise=0.03, seed=6):
    """Write a CSV with semicolons, decimal commas and a row of units, in two formations with laws of their own."""
    rng, C, onset = np.random.default_rng(seed), np.array([15 / 3600, 8 / 3600]), np.array([40e3, 60e3])
    upper = np.arange(count) < count // 2
    weight = _weights(count, rng, 80e3, 180e3)
    rate = np.where(upper, C[0], C[1]) * np.log(weight / np.where(upper, *onset))
    rate *= 1 + noise * rng.standard_normal(count)
    lines = ["Tiefe;ROP;WOB;RPM;Durchfluss;Formation", "m;m/h;t;rpm;L/min;-"]
    for k in range(count):
        cells = (1500 + 0.25 * k, 3600 * rate[k], weight[k] / TONNE_FORCE, 100 + k % 5)
        texts = [
            *(f"{cell:.6g}".replace(".", ",") for cell in cells),
            "2.400",
            ("Keuper", "Buntsandstein")[k // (count // 2)],
        ]
        lines.append(";".join(texts))
    path = folder / "formations.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    planted = {"C": C, "onset": onset, "founder": np.nan, "form": "onset", "rows": count}
    return path, planted | {"reading": {"columns": {"depth": "Tiefe (m)"}, "by": "Formation"}}


def las_without_threshold(folder, count=300, noise=0.03, seed=7):
    """Write a wrapped LAS 2.0 file in small letters, with nulls, whose threshold nobody knows."""
    rng, C, onset = np.random.default_rng(seed), 12 / 3600, 35e3
    weight = _weights(count, rng, 60e3, 160e3)
    rate = C * np.log(weight / onset) * (1 + noise * rng.standard_normal(count))
    head = "~version\n vers. 2.0 : CWLS\n wrap. YES : several lines per step\n~well\n null. -999.25 : null\n~curve\n"
    head += (
        " DEPT.F : depth\n ROP .M/HR : rate\n WOB .1000 lbf : weight\n RPM .c/min : rotation\n TRQ .kgf.m : torque\n"
    )
    lines = [f"{head}~ascii"]
    for k in range(count):
        feed = -999.25 if k % 60 == 30 else 3600 * rate[k]
        cells = f" {feed:.6g} {weight[k] / POUND_FORCE / 1e3:.6g}\n 110 800"
        lines += [f"{(2000 + 0.3 * k) / FOOT:.4f}", cells]
    path = folder / "unknown.las"
    path.write_text("\n".join(lines) + "\n")
    rows = count - len(range(30, count, 60))
    return path, {"C": C, "onset": onset, "founder": np.nan, "form": "onset", "rows": rows, "reading": {}}


ALL = (with_founder, two_formations, las_without_threshold)


if __name__ == "__main__":
    from pathlib import Path

    for write in ALL:
        print(*write(Path()))

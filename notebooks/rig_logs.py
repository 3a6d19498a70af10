"""Synthetic rig logs with a planted law, in every dialect that `vibrojax fit` reads, with the traps of real exports.

    python rig_logs.py FOLDER

The rows are invented, and so are their traps: nulls, missing weight, no rotation, rates beyond reason, a depth that
falls. All files hold the same drilling rows, so that they give the same fit.
"""

import sys
from pathlib import Path

import numpy as np

FOOT, POUND_FORCE, GALLON, PSI, KGF = 0.3048, 4.4482216152605, 3.785411784e-3, 6894.757293168362, 9.80665
TURN = 2 * np.pi
PLANTED = {"law": "onset", "C": 6e-3, "eta0": 0.15, "exponent": 1.3, "threshold": 204.5e3}
"""The law behind the files: C [m/s], and the threshold of granite [N]."""

LAWS = {
    "literal": lambda eta, C, eta0, exponent: C * np.log(eta),
    "percent": lambda eta, C, eta0, exponent: C * np.log(100 * eta),
    "onset": lambda eta, C, eta0, exponent: C * np.log(eta / eta0),
    "line": lambda eta, C, eta0, exponent: C * (eta - eta0),
    "power": lambda eta, C, eta0, exponent: C * eta**exponent,
    "constant": lambda eta, C, eta0, exponent: C * np.ones_like(eta),
}


def correlated(shape, correlation, rng):
    """Return noise of unit variance along the last axis with the `correlation` of neighbours."""
    steps = rng.standard_normal(shape)
    noise = np.empty(shape)
    noise[..., 0] = steps[..., 0]
    for k in range(1, shape[-1]):
        noise[..., k] = correlation * noise[..., k - 1] + np.sqrt(1 - correlation**2) * steps[..., k]
    return noise


def weights(shape, rng, low=60e3, high=180e3):
    """Return weights on bit [N]: a driller changes them in steps of 5 to 40 rows."""
    values = np.empty(shape)
    for row in values.reshape(-1, shape[-1]):
        start = 0
        while start < len(row):
            stop = start + int(rng.integers(5, 40))
            row[start:stop] = rng.uniform(low, high)
            start = stop
    return values + 1e3 * rng.standard_normal(shape)


def drilling(count=400, noise=0.05, correlation=0.7, seed=12, **planted):
    """Return the columns of a log in SI units; `noise` is a fraction of the mean rate."""
    rng = np.random.default_rng(seed)
    planted = PLANTED | planted
    weight = weights((count,), rng)
    rate = LAWS[planted["law"]](weight / planted["threshold"], *(planted[name] for name in ("C", "eta0", "exponent")))
    rate = np.maximum(rate + noise * rate.mean() * correlated((count,), correlation, rng), 0.0)
    return {
        "depth": 1500.0 + 0.3 * np.arange(count),
        "rate": rate,
        "weight": weight,
        "rpm": 120.0 + 5.0 * rng.standard_normal(count),
        "torque": 8e3 + 500.0 * rng.standard_normal(count),
        "pressure": np.full(count, 15e6),
        "flow": np.full(count, 0.04),
        "formation": np.where(np.arange(count) < count // 2, "upper", "lower"),
    }


def with_traps(rows):
    """Return the rows with rows between them that are no drilling, and the number of those by reason."""
    traps = [
        ("missing weight", {"weight": np.nan}),
        ("missing weight", {"weight": 0.0}),
        ("no rotation", {"rpm": 0.0}),
        ("rate beyond reason", {"rate": 2978 * FOOT / 3600}),
        ("missing rate", {"rate": np.nan}),
        ("depth not monotonic", {"depth": 1490.0}),
    ]
    count = len(rows["depth"])
    places = np.linspace(5, count - 5, len(traps)).astype(int)
    columns = {name: list(values) for name, values in rows.items()}
    for place, (_, changes) in reversed(list(zip(places.tolist(), traps, strict=True))):
        for name, values in columns.items():
            values.insert(place, changes.get(name, values[place]))
    reasons = [reason for reason, _ in traps]
    return {name: np.array(values) for name, values in columns.items()}, {r: reasons.count(r) for r in reasons}


def _pason(r):
    seconds = 10 * np.arange(len(r["depth"]))
    return {
        "YYYY/MM/DD": np.full(len(seconds), "2020/11/04"),
        "HH:MM:SS": [f"{s // 3600:02}:{s // 60 % 60:02}:{s % 60:02}" for s in seconds.tolist()],
        "Hole Depth (feet)": r["depth"] / FOOT,
        "Bit Depth (feet)": r["depth"] / FOOT,
        "Rate Of Penetration (ft_per_hr)": r["rate"] * 3600 / FOOT,
        "Weight on Bit (klbs)": r["weight"] / POUND_FORCE / 1e3,
        "Rotary RPM (RPM)": r["rpm"],
        "Top Drive Torque (kft_lb)": r["torque"] / FOOT / POUND_FORCE / 1e3,
        "Standpipe Pressure (psi)": r["pressure"] / PSI,
        "Total Pump Output (gal_per_min)": r["flow"] * 60 / GALLON,
        "Surface Stick Slip Index (percent)": np.full(len(seconds), -999.25),
        "Formation": r["formation"],
    }


def _pason_processed(r):
    return {
        "Depth(ft)": r["depth"] / FOOT,
        "Depth(m)": r["depth"],
        "ROP(1 ft)": r["rate"] * 3600 / FOOT,
        "ROP(1 m)": r["rate"] * 3600,
        "weight on bit (k-lbs)": r["weight"] / POUND_FORCE / 1e3,
        "weight on bit (kg)": r["weight"] / KGF,
        "Temp Out( degF)": np.full(len(r["depth"]), 120.0),
        "Surface Torque (psi)": np.full(len(r["depth"]), 900.0),  # a torque in the pressure of a hydraulic motor
        "Rotary Speed (rpm)": r["rpm"],
        "Flow In (gal/min)": r["flow"] * 60 / GALLON,
        "Pump Press (psi)": r["pressure"] / PSI,
        "Formation": r["formation"],
    }


def _rigcloud(r):
    seconds = 10 * np.arange(len(r["depth"]))
    return {
        "Time": [f"2020-11-04T{s // 3600:02}:{s // 60 % 60:02}:{s % 60:02}" for s in seconds.tolist()],
        "Total Depth": r["depth"] / FOOT,
        "Weight on Bit": r["weight"] / POUND_FORCE / 1e3,
        "ROP Depth/Hour": r["rate"] * 3600 / FOOT,
        "Top Drive RPM": r["rpm"],
        "Top Drive Torque (ft-lbs)": r["torque"] / FOOT / POUND_FORCE,
        "Pump Pressure": r["pressure"] / PSI,
        "Flow In": r["flow"] * 60 / GALLON,
        "Formation": r["formation"],
    }


def _usrop(r):
    return {
        "Measured Depth m": r["depth"],
        "Weight on Bit kkgf": r["weight"] / KGF / 1e3,
        "Average Standpipe Pressure kPa": r["pressure"] / 1e3,
        "Average Surface Torque kN.m": r["torque"] / 1e3,
        "Rate of Penetration m/h": r["rate"] * 3600,
        "Average Rotary Speed rpm": r["rpm"],
        "Mud Flow In L/min": r["flow"] * 6e4,
        "Mud Density In g/cm3": np.full(len(r["depth"]), 1.2),
        "Diameter mm": np.full(len(r["depth"]), 215.9),
        "Average Hookload kkgf": np.full(len(r["depth"]), 110.0),
        "Formation": r["formation"],
    }


def _witsml(r):
    return {
        "DMEA": r["depth"],
        "WOB": r["weight"],
        "SURF_RPM": r["rpm"] / 60,  # revolutions per second
        "ROP_AVG": r["rate"],
        "TRQ": r["torque"],
        "SPPA": r["pressure"],
        "MFIA": r["flow"],
        "Formation": r["formation"],
    }


def _semicolon(r):
    return {
        "Depth (m)": r["depth"],
        "WOB (kN)": r["weight"] / 1e3,
        "ROP (m/h)": r["rate"] * 3600,
        "RPM (rpm)": r["rpm"],
        "Torque (kN.m)": r["torque"] / 1e3,
        "Formation": r["formation"],
    }


def _las(r):
    return {
        "DEPT.M": r["depth"],
        "ROP.M/HR": r["rate"] * 3600,
        "WOB.KLBF": r["weight"] / POUND_FORCE / 1e3,
        "RPM.RPM": r["rpm"],
        "TRQ.KN.M": r["torque"] / 1e3,
    }


DIALECTS = {
    "pason": _pason,
    "pason-processed": _pason_processed,
    "rigcloud": _rigcloud,
    "usrop": _usrop,
    "witsml": _witsml,
    "semicolon": _semicolon,
    "las": _las,
}
_LAS_HEAD = "~Version\nVERS. 2.0 : CWLS\nWRAP. NO : one line per row\n~Well\nNULL. -999.25 : null\n~Curve\n"


def write(path, dialect, rows):
    """Write the rows as a file of a dialect. A missing number is -999.25, or an empty cell after semicolons."""
    null = "" if dialect == "semicolon" else "-999.25"
    columns = DIALECTS[dialect](rows)
    cells = [
        [cell if isinstance(cell, str) else null if np.isnan(cell) else repr(float(cell)) for cell in column]
        for column in columns.values()
    ]
    lines = zip(*cells, strict=True)
    if dialect == "las":
        curves = [f"{name.replace('.', ' .', 1)} : " for name in columns]
        text = _LAS_HEAD + "\n".join([*curves, "~ASCII", *(" ".join(line) for line in lines)])
    elif dialect == "semicolon":
        text = "\n".join([";".join(columns), *(";".join(line).replace(".", ",") for line in lines)])
    else:
        text = "\n".join([",".join(columns), *(",".join(line) for line in lines)])
    Path(path).write_text(text + "\n", encoding="utf-8")
    return Path(path)


def write_all(folder, **options):
    """Write one file of each dialect into a folder; return the paths by dialect."""
    rows, _ = with_traps(drilling(**options))
    Path(folder).mkdir(parents=True, exist_ok=True)
    return {name: write(Path(folder) / f"{name}.{'las' if name == 'las' else 'csv'}", name, rows) for name in DIALECTS}


if __name__ == "__main__":
    for file in write_all(sys.argv[1] if len(sys.argv) > 1 else "rig-logs").values():
        print(file)

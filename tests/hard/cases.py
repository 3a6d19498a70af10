"""Hard cases: lanes by name, and their comparison with the exact reference (tests/exact)."""

import csv
import math
from pathlib import Path

import exact

USUAL = {"beta": 0.4, "gamma": 0.75, "v": 1.5, "delta": 0.005, "k0": 50e6, "c0": 0.1, "c2": 250.0, "mu": 0.4}
USUAL |= {"start": "stuck"}
GRAZED = 0.06496005202147603
"""The largest displacement of the usual striker in the first 1.2 s with nothing in its way [m]."""

ROCK = {
    "rock stiffness": [{"k3": k3} for k3 in (1e4, 1e6, 1e10, 1e12)],
    "threshold": [{"threshold": threshold} for threshold in (1e-300, 1.0, 1e300)],
    "damping of the rock": [{"zeta": zeta} for zeta in (0.01, 10.0)],
}


def hard_drills() -> dict[str, list[dict]]:
    """Return the lanes of the bundled sweep as changes of the usual point, by the names of what they change."""
    cases: dict[str, list[dict]] = {}
    with (Path(__file__).parents[2] / "sweeps" / "hard_cases.csv").open() as file:
        for row in csv.DictReader(file):
            point = {name: x if name == "start" else float(x) for name, x in row.items()}
            changes = {name: x for name, x in point.items() if x != USUAL[name]}
            cases.setdefault(" ".join(changes), []).append(changes)
    return cases


DRILL = hard_drills()

MEASURES = dict.fromkeys(("bit_amplitude", "striker_amplitude", "deepest_gap", "rate_of_penetration"), 1e-6)
MEASURES |= dict.fromkeys(("peak_impact_force", "mean_impact_force", "mean_force", "drive_power"), 1.0)
MEASURES |= {"period": 1e-3, "impact_velocity": 1e-4, "stick_fraction": 1e-2, "reverse_fraction": 1e-2}
"""Scale [SI] of each measure, which is added to the value: a deviation that is small against it does not count."""


SAME_PLACE = {"float64": 3e-10, "float32": 1e-7}
"""Tolerance of a position [m], at a swing of 0.06 m. An impact of depth d is known to a relative error of half of it
over d. A shallower impact may be missed."""


def bound_of(changes: dict, bound: float, precision: str = "float64") -> float:
    """Return the relative deviation up to which a lane counts as exact, also one that grazes."""
    depth = abs(changes.get("delta", 1.0) - GRAZED)
    if depth > 1e-5:
        return bound
    share = SAME_PLACE[precision] / 2 / max(depth, 1e-300)
    return max(bound, share) if share < 1 else math.inf


def lanes(cases: dict) -> list[tuple[str, dict]]:
    """Return the name of the case and the point of each lane."""
    return [(name, changes) for name, points in cases.items() for changes in points]


def columns(cases: dict, usual: dict) -> dict[str, list]:
    """Return the lanes as the points of a sweep."""
    points = [usual | changes for _, changes in lanes(cases)]
    names = dict.fromkeys(name for point in points for name in point)
    return {name: [point[name] for point in points] for name in names}


def reference(scene: str, point: dict, observe: float, settle: float = 0.0) -> dict | None:
    """Return the measures of the exact reference from `settle` on, or None if it cannot complete the run."""
    try:
        return exact.measure(exact.run(scene, **point, settle=settle, observe=observe))
    except (ArithmeticError, ValueError, OverflowError):
        return None


def deviation(lane, measured: dict) -> tuple[float, str]:
    """Return the greatest relative deviation of a sweep's lane from the reference, and its measure."""
    worst = (0.0, "")
    for name, scale in MEASURES.items():
        if name not in lane:
            continue
        # Means are over whole repeats. If the two do not agree on the repeat, the means cover different spans of time.
        if name not in ("bit_amplitude", "striker_amplitude", "peak_impact_force", "deepest_gap") and (
            "cycles" in lane and int(lane["cycles"]) != measured["cycles"]
        ):
            continue
        value, expected = float(lane[name]), measured.get(name, math.nan)
        if name == "deepest_gap":  # for a bit that never leaves the rock the reference has the least compression
            expected = min(expected, 0.0)
        if math.isnan(value) != math.isnan(expected):
            return math.inf, name
        if not math.isnan(value):
            worst = max(worst, (abs(value - expected) / (abs(expected) + scale), name))
    return worst


def verdict(lane, measured: dict | None, bound: float) -> tuple[str, str]:
    """Return exact, refused, flagged, WRONG or unchecked (the reference finds no end), and a remark."""
    status = lane["status"].attrs["flag_meanings"].split()[int(lane["status"])]
    if status != "done":
        reason = lane["reason"].attrs["flag_meanings"].split()[int(lane["reason"])]
        return {"refused": "refused", "failed": "flagged"}[status], reason
    if measured is None:
        return "unchecked", "the exact reference finds no end"
    worst, name = deviation(lane, measured)
    return ("exact" if worst <= bound else "WRONG"), f"{worst:.1e} {name}".strip()

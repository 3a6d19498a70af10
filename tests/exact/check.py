"""Runs every reference case (tests/data) by the exact reference and prints the worst deviation of each quantity.

python tests/exact/check.py [vibro_impact_cases hard_cases penetration_cases]
"""

import json
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))
import exact

DATA = Path(__file__).parents[1] / "data"
NAMES = {
    "A": "force",
    "f": "frequency",
    "w": "pulse_width",
    "D": "threshold",
    "k3": "k3",
    "zeta": "zeta",
    "shape": "pulse_shape",
}
SETTLE = {"vibro_impact_cases": 40.0, "hard_cases": 160.0}  # s
ABSOLUTE = ("stick_fraction", "reverse_fraction", "slip_per_pulse", "cycles", "impacts")


def drilled(point: dict, settle: float) -> dict:
    """Measures and regime of a case of the vibro-impact scene."""
    motion = exact.run("vibro-impact", **point, settle=settle, observe=8.0)
    found = exact.measure(motion)
    return found | {"regime": exact.label(motion, found)}


def driven(point: dict) -> dict:
    """Measures of a case of the penetration scene: the last of 60 pulses."""
    point = {NAMES[name]: value for name, value in point.items()}
    period = 1 / point["frequency"]
    found = exact.measure(exact.run("penetration", **point, settle=59 * period, observe=period))
    return found | {"slip_per_pulse": found["slip_per_impact"]}


def found_for(name: str, case: dict) -> dict:
    return driven(case["point"]) if name == "penetration_cases" else drilled(case["point"], SETTLE[name])


def deviations(expected: dict, found: dict) -> dict[str, float]:
    """By quantity: relative, absolute for shares and counts; irregular and at rest, only the regime counts."""
    result = {"regime": float(expected.get("regime") != found.get("regime"))}
    if expected.get("regime") in ("irregular", "equilibrium"):
        return result
    for name, value in expected.items():
        if name != "regime":
            scale = 1.0 if name in ABSOLUTE or value == 0 else abs(value)
            result[name] = abs(found[name] - value) / scale
    return result


def main(names):
    for name in names:
        begun, worst = time.perf_counter(), {}
        for index, case in enumerate(json.loads((DATA / f"{name}.json").read_text())):
            since = time.perf_counter()
            try:
                deviating = deviations(case["expected"], found_for(name, case))
            except ArithmeticError as error:
                print(f"  case {index} failed: {error}")
                continue
            print(f"  case {index}: {max(deviating.values()):.2g}, {time.perf_counter() - since:.1f} s", flush=True)
            for quantity, deviation in deviating.items():
                worst[quantity] = max(worst.get(quantity, (0.0, index)), (deviation, index))
        print(f"{name}: {time.perf_counter() - begun:.0f} s")
        for quantity, (deviation, index) in worst.items():
            print(f"  {quantity:24} {deviation:.2g} (case {index})")


if __name__ == "__main__":
    main(sys.argv[1:] or [*SETTLE, "penetration_cases"])

"""Run all reference cases (tests/data) with the exact reference, and print the largest deviation of each quantity.

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


def drill_measures(point: dict, settle: float) -> dict:
    """Return the measures and the regime of a case of the vibro-impact scene."""
    motion = exact.run("vibro-impact", **point, settle=settle, observe=8.0)
    measures = exact.measure(motion)
    return measures | {"regime": exact.label(motion, measures)}


def penetration_measures(point: dict) -> dict:
    """Return the measures of a case of the penetration scene, taken from the last of 60 pulses."""
    point = {NAMES[name]: value for name, value in point.items()}
    period = 1 / point["frequency"]
    measures = exact.measure(exact.run("penetration", **point, settle=59 * period, observe=period))
    return measures | {"slip_per_pulse": measures["slip_per_impact"]}


def found_for(name: str, case: dict) -> dict:
    return (
        penetration_measures(case["point"])
        if name == "penetration_cases"
        else drill_measures(case["point"], SETTLE[name])
    )


def deviations(expected: dict, measures: dict) -> dict[str, float]:
    """Return the deviation of each quantity: absolute for shares and counts, otherwise relative.

    For irregular motions and equilibria, only the regime counts.
    """
    result = {"regime": float(expected.get("regime") != measures.get("regime"))}
    if expected.get("regime") in ("irregular", "equilibrium"):
        return result
    for name, value in expected.items():
        if name != "regime":
            scale = 1.0 if name in ABSOLUTE or value == 0 else abs(value)
            result[name] = abs(measures[name] - value) / scale
    return result


def main(names):
    for name in names:
        begin, worst = time.perf_counter(), {}
        for index, case in enumerate(json.loads((DATA / f"{name}.json").read_text())):
            case_begin = time.perf_counter()
            try:
                case_deviations = deviations(case["expected"], found_for(name, case))
            except ArithmeticError as error:
                print(f"  case {index} failed: {error}")
                continue
            print(
                f"  case {index}: {max(case_deviations.values()):.2g}, {time.perf_counter() - case_begin:.1f} s",
                flush=True,
            )
            for quantity, deviation in case_deviations.items():
                worst[quantity] = max(worst.get(quantity, (0.0, index)), (deviation, index))
        print(f"{name}: {time.perf_counter() - begin:.0f} s")
        for quantity, (deviation, index) in worst.items():
            print(f"  {quantity:24} {deviation:.2g} (case {index})")


if __name__ == "__main__":
    main(sys.argv[1:] or [*SETTLE, "penetration_cases"])

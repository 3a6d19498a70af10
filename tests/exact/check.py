"""Deviations of the exact reference from the reference cases (tests/data)."""

import exact

NAMES = {
    "A": "force",
    "f": "frequency",
    "w": "pulse_width",
    "D": "threshold",
    "k3": "k3",
    "zeta": "zeta",
    "shape": "pulse_shape",
}
ABSOLUTE = ("stick_fraction", "reverse_fraction", "slip_per_pulse", "cycles", "impacts")


def drill_measures(point: dict) -> dict:
    """Return the measures and the regime of a case of the vibro-impact scene."""
    motion = exact.run("vibro-impact", **point, settle=40.0, observe=8.0)
    measures = exact.measure(motion)
    return measures | {"regime": exact.label(motion, measures)}


def penetration_measures(point: dict) -> dict:
    """Return the measures of a case of the penetration scene, taken from the last of 60 pulses."""
    point = {NAMES[name]: value for name, value in point.items()}
    period = 1 / point["frequency"]
    measures = exact.measure(exact.run("penetration", **point, settle=59 * period, observe=period))
    return measures | {"slip_per_pulse": measures["slip_per_impact"]}


def found_for(name: str, case: dict) -> dict:
    return penetration_measures(case["point"]) if name == "penetration_cases" else drill_measures(case["point"])


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

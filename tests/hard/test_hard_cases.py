"""Tests of hard cases: each lane is exact, or refused or flagged with a reason; none is silently wrong.

The README beside this file has the table of the cases that are marked `long`."""

import numpy as np
import pytest
from cases import DRILL, GRAZED, ROCK, USUAL, bound_of, columns, lanes, reference, verdict

import vibrojax as vj

SHORT = {
    "gap and preload": [{"delta": -0.02}],
    "grazing": [{"delta": GRAZED + by} for by in (-1e-9, -1e-12, 0.0, 1e-12, 1e-9)],
    "coinciding switches": [{"delta": 0.0, "v": 2.0, "c0": 1e4}],
    "start on a surface": [{"delta": 0.0, "start": "drive", "c0": 0.0}],
    "subnormal numbers": [{"v": 5e-324}, {"delta": 5e-324}],
    "contact stiffness": [{"k0": 1e10}],
    "contact damping": [{"c0": 0.0}, {"c0": 1e5}],
    "drive speed": [{"v": 0.0}, {"v": 30.0}],
    "friction": [{"mu": 0.0}, {"mu": 10.0}],
    "frequency ratio": [{"gamma": 0.01}, {"gamma": 1e155}],
    "mass ratio": [{"beta": 10.0}],
}
ON_ROCK = {"beta": 0.4, "gamma": 0.6, "start": "stuck", "zeta": 1.5, "threshold": 61.9e3, "k3": 100.68e6}
PULSES = {"zeta": 1.1, "threshold": 150e3, "k3": 300e6}
# Scene, cases, usual point, precision, observed time [s], bound of the relative deviation, lanes by verdict (README).
# With pulses, lanes settle for 0.1 s: the package does not count the pulse at t = 0.
SETS = [
    ("vibro-impact", SHORT, USUAL, "float64", 0.5, 1e-5, {"exact": 18, "refused": 1, "flagged": 1}),
    ("vibro-impact", DRILL, USUAL, "float64", 1.2, 1e-5, {"exact": 48, "refused": 4, "flagged": 1}),
    ("vibro-impact", DRILL, USUAL, "float32", 1.2, 3e-3, {"exact": 46, "refused": 6, "flagged": 1}),
    ("drilling", ROCK, ON_ROCK, "float64", 1.0, 1e-5, {"exact": 9}),
    ("coupled-drilling", ROCK, ON_ROCK, "float64", 1.0, 1e-5, {"exact": 9}),
    ("penetration", ROCK, PULSES, "float64", 0.5, 1e-5, {"exact": 9}),
]


def run_cases(scene, cases, usual, **run):
    return vj.run_sweep({"scene": scene, "points": columns(cases, usual), "run": run}, progress=False)


@pytest.fixture(scope="module")
def short():
    return run_cases("vibro-impact", SHORT, USUAL, settle=0.0, observe=0.5)


@pytest.mark.parametrize("number", [0, *(pytest.param(k, marks=pytest.mark.long) for k in range(1, len(SETS)))])
def test_exact_or_reported(number):
    scene, cases, usual, precision, observe, bound, expected = SETS[number]
    settle = 0.1 if scene == "penetration" else 0.0
    dataset = run_cases(scene, cases, usual, settle=settle, observe=observe, precision=precision)
    found = {}
    for index, (case, changes) in enumerate(lanes(cases)):
        measured = reference(scene, usual | changes, observe, settle)
        kind, remark = verdict(dataset.isel(point=index), measured, bound_of(changes, bound, precision))
        found.setdefault(kind, []).append((case, changes, remark))
    assert {kind: len(of_kind) for kind, of_kind in found.items()} == expected, found
    if number == 0:
        assert [found[kind][0][1] for kind in ("flagged", "refused")] == [{"gamma": 1e155}, {"v": 5e-324}]


def test_failed_lane_does_not_affect_neighbours(short):
    """Neighbours are equal bit for bit, at any position in the block."""
    without = {name: [point for point in points if point != {"gamma": 1e155}] for name, points in SHORT.items()}
    undisturbed = run_cases("vibro-impact", without, USUAL, settle=0.0, observe=0.5)
    kept = [index for index, (_, changes) in enumerate(lanes(SHORT)) if changes != {"gamma": 1e155}]
    for name in undisturbed.data_vars:
        np.testing.assert_array_equal(undisturbed[name].values, short[name].values[kept], err_msg=name)
    failed = short.isel(point=[index for index in range(short.sizes["point"]) if index not in kept])
    flags = short.regime.attrs["flag_meanings"].split()
    assert [flags[flag] for flag in failed.regime.values] == ["failed"]
    assert np.isnan(failed.period.values).all() and failed.cycles.values.tolist() == [0]

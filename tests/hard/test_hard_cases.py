"""Tests of hard cases: each lane is exact, or refused or flagged with a reason; none is silently wrong.

`python tests/hard/check.py` runs the slow ones; its table is in the README beside it.
"""

import numpy as np
import pytest
from cases import DRILL, USUAL, bound_of, columns, lanes, reference, verdict

import vibrojax as vj
from vibrojax.lanes.labels import too_stiff_or_slow

OBSERVE = 0.5
SHORT = {
    "gap and preload": [{"delta": -0.02}],
    "grazing": DRILL["grazing"][1:],
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


def run_cases(cases, **run):
    run = {"settle": 0.0, "observe": OBSERVE} | run
    return vj.run_sweep({"scene": "vibro-impact", "points": columns(cases, USUAL), "run": run}, progress=False)


@pytest.fixture(scope="module")
def short():
    return run_cases(SHORT)


def test_exact_or_reported(short):
    seen = set()
    for index, (case, changes) in enumerate(lanes(SHORT)):
        bound = bound_of(case, changes, 1e-5)
        kind, remark = verdict(short.isel(point=index), reference("vibro-impact", USUAL | changes, OBSERVE), bound)
        assert kind in ("exact", "refused", "flagged"), (case, changes, remark)
        expected = {"flagged": {"gamma": 1e155}, "refused": {"v": 5e-324}}.get(kind)
        assert expected in (None, changes), (case, changes, kind, remark)
        seen.add(kind)
    assert seen == {"exact", "flagged", "refused"}


def test_failed_lane_does_not_affect_neighbours(short):
    """Neighbours are equal bit for bit, at any position in the block."""
    without = {name: [point for point in points if point != {"gamma": 1e155}] for name, points in SHORT.items()}
    undisturbed = run_cases(without)
    kept = [index for index, (_, changes) in enumerate(lanes(SHORT)) if changes != {"gamma": 1e155}]
    for name in undisturbed.data_vars:
        np.testing.assert_array_equal(undisturbed[name].values, short[name].values[kept], err_msg=name)
    failed = short.isel(point=[index for index in range(short.sizes["point"]) if index not in kept])
    flags = short.regime.attrs["flag_meanings"].split()
    assert [flags[flag] for flag in failed.regime.values] == ["failed"]
    assert np.isnan(failed.period.values).all() and failed.cycles.values.tolist() == [0]


@pytest.mark.parametrize("changes", [{"c2": 1e10}, {"beta": 1e-12}, {"k1": 1e30}, {"c0": 1e300}])
def test_too_stiff_lane_is_refused(changes):
    """Nothing moves in a step of 1e-12 s, but the lane must not be labelled an equilibrium."""
    sweep = vj.read_sweep(
        {"scene": "vibro-impact", "starts": ["stuck"], "points": {n: [x] for n, x in changes.items()}}
    )
    assert too_stiff_or_slow(sweep.system, sweep.run, sweep.inputs().parameters)[0].tolist() == [True]
    usual = vj.read_sweep({"scene": "vibro-impact", "starts": ["stuck"], "grid": {"k0": [1e6, 50e6, 1e12]}})
    assert not too_stiff_or_slow(usual.system, usual.run, usual.inputs().parameters)[0].any()


def test_motion_below_rounding_is_refused():
    """In float32 a drive of 1e-6 m/s looks like one at rest. A drive at rest is accepted, as is one in float64."""
    grid = {"scene": "vibro-impact", "starts": ["stuck"], "grid": {"v": [0.0, 1e-6, 1.5]}}
    for precision, expected in (("float32", [False, True, False]), ("float64", [False] * 3)):
        sweep = vj.read_sweep(grid | {"run": {"precision": precision}})
        assert too_stiff_or_slow(sweep.system, sweep.run, sweep.inputs().parameters)[1].tolist() == expected

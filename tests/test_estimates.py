"""Tests of the cost that `--dry-run` prints and that limits a sweep before it runs."""

import pytest

from vibrojax.lanes.run import LaneRun
from vibrojax.maps.cost import estimated_steps, tried
from vibrojax.maps.read import read_sweep
from vibrojax.maps.run import run_to_file

MAP = {"scene": "vibro-impact", "grid": {"beta": {"start": 0.2, "stop": 0.6, "num": 512}}, "starts": ["stuck"]}


def test_estimated_steps_match_computed_steps():
    """All lanes are stepped to their end."""
    sweep = read_sweep(MAP, ["run.end_early=false"])
    inputs = sweep.inputs()
    taken = LaneRun(inputs, sweep.plan).chunk(inputs).features["steps"].sum()
    assert 2 / 3 < estimated_steps(sweep).sum() / taken < 3 / 2


def test_stiff_lanes_take_more_steps():
    """A stiff damper needs c2/m2 steps per second, divided by the stride 2; 1e6 and 1000 per second are the limit."""
    usual, stiff, stiffest = (
        estimated_steps(read_sweep(MAP | {"grid": {"c2": [c2]}})).sum() for c2 in (200, 1e6, 1e13)
    )
    assert stiff / usual == pytest.approx((1e4 / 2 + 45.0) / (45.0 + 18.0), rel=0.1)
    assert stiffest == pytest.approx(1e6 + 48 * 1000, rel=0.1)


def test_cost_is_extrapolated_from_few_lanes(tmp_path):
    grid = {"beta": {"start": 0.2, "stop": 0.6, "num": 10}, "gamma": {"start": 0.6, "stop": 0.9, "num": 60}}
    sweep = read_sweep(MAP | {"grid": grid, "run": {"settle": 2.0, "observe": 1.0, "carry": "beta"}})
    cost = tried(sweep)
    run_to_file(sweep, tmp_path / "out.nc", progress=False)
    assert 0.3 < (tmp_path / "out.nc").stat().st_size / cost.file < 1.5

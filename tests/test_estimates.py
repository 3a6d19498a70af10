"""Tests of the times that `--dry-run` estimates; `tests/benchmarks/estimates.py` compares them with measured times."""

import numpy as np
import pytest

from vibrojax.lanes.chunks import Chunks
from vibrojax.maps import costs
from vibrojax.maps.costs import lane_steps, processor_time
from vibrojax.maps.read import read_sweep
from vibrojax.maps.run import estimate
from vibrojax.maps.work import Work
from vibrojax.settings.toml import bundled_names

MAP = {"scene": "vibro-impact", "grid": {"beta": {"start": 0.2, "stop": 0.6, "num": 512}}, "starts": ["stuck"]}

MACHINE_FACTOR = costs.machine_factor


@pytest.fixture(autouse=True)
def reference_machine(monkeypatch):
    monkeypatch.setattr(costs, "machine_factor", lambda: 1.0)
    monkeypatch.setattr(costs, "LANE", 0.0)


def time_of(changes=(), **tables):
    return processor_time(Chunks(read_sweep(MAP | tables, changes)))


def test_steps_are_proportional_to_lanes_and_time():
    usual = time_of()
    more = time_of(starts=["stuck", "drive", "touching"])
    assert more.step == pytest.approx(3 * usual.step, rel=0.02)
    longer = time_of(run={"settle": 80.0, "observe": 16.0})
    assert longer.step == pytest.approx(2 * usual.step, rel=1e-6)
    assert usual[:2] == more[:2] == longer[:2]  # the compiled program is the same


def test_block_takes_as_long_as_its_slowest_lane():
    """A stiff damper needs c2/m2 steps per second, divided by the stride, and its whole block waits for it.

    A lane is abandoned beyond 1e6 steps and 1000 steps per second.
    """
    block = Chunks(read_sweep(MAP)).engine.programs.block
    single = time_of(grid={"beta": [0.4]})
    assert time_of(grid={"beta": np.linspace(0.3, 0.5, block).tolist()}).step == pytest.approx(single.step, rel=0.2)
    stiff = time_of(grid={"c2": [*range(201, 200 + block), 1e6]})
    flight = 1e6 / 100.0 / 2.0  # m2 = 100 kg, stride 2
    assert stiff.step / single.step == pytest.approx((flight + 45.0) / (45.0 + 18.0), rel=0.1)
    stiffer, stiffest = (time_of(grid={"c2": [c2]}).step for c2 in (1e10, 1e13))
    assert stiffer == stiffest == pytest.approx(stiff.step * (1e6 / 48 + 1000) / (flight + 45.0), rel=0.1)


def test_smoothed_step_count_follows_step_size():
    coarse, fine = (time_of(run={"method": "smoothed", "step": step}) for step in (1e-3, 1e-4))
    assert fine.step == pytest.approx(10 * coarse.step, rel=1e-6)


def test_slower_machine_takes_longer(monkeypatch):
    usual = time_of()
    monkeypatch.setattr(costs, "machine_factor", lambda: 3.0)
    assert time_of() == pytest.approx([3 * part for part in usual])


def test_lanes_with_few_steps_still_take_time(monkeypatch):
    short = {"run": {"settle": 1e-3, "observe": 1e-3}}
    steps = time_of(**short).step
    monkeypatch.setattr(costs, "LANE", 1.0)
    assert time_of(**short).step == pytest.approx(512 + steps)


def test_ending_on_orbits_saves_steps_and_adds_compilation():
    many = {"grid": {"beta": {"start": 0.2, "stop": 0.6, "num": 110_000}}}
    for changes, ends in (([], True), (["run.end_early=false"], False)):
        sweep = read_sweep(MAP | many, changes)
        with_ends, without_ends = processor_time(Work(sweep).chunks), processor_time(Chunks(sweep))
        assert (with_ends.step < without_ends.step) == (with_ends.compile > without_ends.compile) == ends


def test_yardstick_uses_its_shortest_run(monkeypatch):
    """Other load on the machine can only lengthen a run."""
    took = (5.0, 3.2, 4.0, 3.0, 9.0, 3.1)
    readings = iter(np.cumsum([x for seconds in took for x in (0.1, seconds * costs.YARDSTICK)]))
    monkeypatch.setattr(costs.time, "thread_time", lambda: next(readings))
    assert MACHINE_FACTOR.__wrapped__() == pytest.approx(3.0)


def test_parts_add_up():
    sweep = read_sweep(MAP)
    cost, processor = estimate(sweep), time_of()
    assert cost["time_s"] == pytest.approx(cost["compile_s"] + cost["step_s"])
    assert cost["processor_s"] == pytest.approx(sum(processor)) and cost["time_s"] <= cost["processor_s"]


@pytest.mark.parametrize("name", bundled_names())
def test_every_bundled_sweep_has_an_estimate(name):
    estimates = processor_time(Chunks(read_sweep(name)))
    assert all(0 < part < 300 for part in estimates)


def test_estimated_steps_match_computed_steps():
    """All lanes are stepped to their end. `tests/benchmarks/estimates.py` measures the time per step."""
    chunks = Chunks(read_sweep(MAP, ["run.end_early=false"]))
    taken = chunks.compute(0)["steps"].sum()
    assert 2 / 3 < lane_steps(chunks, np.arange(chunks.sweep.lanes)).sum() / taken < 3 / 2

"""Tests of live motions: answers agree with `simulate`, wrong requests are refused, and new values compile nothing."""

import json
import time

import numpy as np
import pytest
from cell_blocks import decode

import vibrojax as vj
from vibrojax.compile.native import kernels
from vibrojax.errors import InputError
from vibrojax.explorer import encoding
from vibrojax.explorer.motions import LiveMotions, motions_of

SWEEP = {
    "scene": "vibro-impact",
    "starts": ["drive", [0.0, 0.0, 0.01, 0.0]],
    "parameters": {"v": 1.2},
    "grid": {"beta": [0.3, 0.4], "gamma": [0.65, 0.75, 0.8]},
    "run": {"settle": 8.0, "observe": 6.0},
}


@pytest.fixture(scope="module")
def dataset():
    return vj.run_sweep(SWEEP, progress=False)


@pytest.fixture(scope="module")
def motions():
    return motions_of(vj.read_sweep(SWEEP))


def no_newer_request(*_):
    """Stand for a client that sends no newer request."""


def decode_single(block):
    [cell] = decode(block)
    return cell


@pytest.mark.parametrize("start", [None, "stuck", [0.0, 0.5, 0.01, -1.0]])
def test_motion_has_numbers_of_simulate(motions, start):
    changed = {"beta": 0.37, "delta": 0.002}
    cell = decode_single(motions.answer({"parameters": changed, "start": start}, no_newer_request))
    values = {"v": 1.2, "gamma": 0.65} | changed
    motion = vj.simulate("vibro-impact", **values, start=start or "drive", duration=14.0, progress=False)
    assert {"regime", "period", "impact_velocity", "stick_fraction"} <= set(cell.numbers)
    for name, value in cell.numbers.items():
        np.testing.assert_equal(np.nan if value is None else value, motion[name].item(), err_msg=name)
    assert set(cell.numbers) == {name for name, data in motion.data_vars.items() if data.ndim == 0}


def test_lanes_match_sweep(dataset, motions):
    """A lane number selects the parameters and the start of that lane, be it named or a vector."""
    for number in range(12):
        cell = decode_single(motions.answer({"lane": number}, no_newer_request))
        lane = dataset.stack(lane=("beta", "gamma", "start")).isel(lane=number)
        assert cell.lane == number and cell.numbers is None
        if int(lane["cycles"]) > 0:
            repeat = int(lane["cycles"]) * float(lane["period"])
            assert cell.kind == "orbit" and cell.duration == pytest.approx(repeat, rel=5e-3)


@pytest.mark.parametrize("scene", ["rotary", "penetration", "drilling", "coupled-drilling"])
def test_every_scene_answers(scene):
    motions = LiveMotions(scene, {}, None, 2.0 if scene == "penetration" else 12.0)
    cell = decode_single(motions.answer({"parameters": {}}, no_newer_request))
    assert cell.kind != "none" and len(cell.time) > 50 and cell.numbers
    offered = motions.offered()
    assert {entry["name"] for entry in offered["parameters"]} == set(motions.point.parameters) == set(offered["values"])
    for slider in offered["parameters"]:
        assert slider["low"] <= offered["values"][slider["name"]] <= slider["high"]
        assert motions.names.parameters[slider["name"]].problem(slider["low"]) is None
    assert json.loads(json.dumps(offered, allow_nan=False)) == offered


def test_superseded_motion_is_interrupted(motions):
    calls = []

    def check(*_):
        calls.append(1)
        if len(calls) == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        motions.answer({"parameters": {"k0": 300e6}}, check)
    assert len(calls) == 2


def test_values_compile_nothing():
    """Only the first motion compiles. An answer takes under 0.3 s of one core, fast enough for a slider."""
    motions = LiveMotions("vibro-impact", {})
    assert motions.duration == 48.0
    motions.warm()
    before, random = len(kernels), np.random.default_rng(0)
    taken = []
    for start in ("drive", "stuck", [0.0, 0.1, 0.02, 0.0]):
        for _ in range(3):
            beta, delta, k0 = random.uniform(0.3, 0.5), random.uniform(-0.01, 0.01), random.uniform(10e6, 100e6)
            began = time.thread_time()
            motions.answer({"parameters": {"beta": beta, "delta": delta, "k0": k0}, "start": start}, no_newer_request)
            taken.append(time.thread_time() - began)
    assert len(kernels) == before
    assert np.median(taken) < 0.3


def test_box_is_the_sweep_of_its_cells(motions):
    """The part that a user zooms into has the labels and numbers of a sweep over the same values."""
    box = {"beta": [0.31, 0.39], "gamma": [0.66, 0.78]}
    answer = json.loads(motions.answer({"box": box, "lane": 1}, no_newer_request))
    grid = {"beta": [0.31, 0.39], "gamma": np.linspace(0.66, 0.78, 3).tolist()}
    expected = vj.run_sweep({**SWEEP, "grid": grid, "starts": [[0.0, 0.0, 0.01, 0.0]]}, progress=False)
    assert answer["axes"] == grid
    for name in ("regime", "period", "impact_velocity"):
        assert answer["variables"][name] == encoding.pack(expected[name].isel(start=0).values), name
    for wrong in ([1], {"beta": [0.3, 0.4]}, {**box, "gamma": [0.78, 0.66]}, {**box, "beta": ["a", 1]}):
        with pytest.raises(InputError, match="explore: box"):
            motions.answer({"box": wrong, "lane": 1}, no_newer_request)

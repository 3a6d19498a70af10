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
from vibrojax.explorer import motions as live_motions
from vibrojax.explorer.motions import LiveMotions, motions_for, motions_of

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


def test_cell_lies_on_trajectory(motions):
    """At the cell's times, the trajectory of `simulate` agrees to a level of the cell's columns."""
    cell = decode_single(motions.answer({"parameters": {"beta": 0.4, "gamma": 0.75, "v": 1.5}}, no_newer_request))
    motion = vj.simulate("vibro-impact", duration=14.0, sampling=1e-4, progress=False)
    sections = motion["event_time"].values[motion["event_kind"].values == 5]
    assert cell.kind == "orbit" and cell.duration == pytest.approx(sections[-1] - sections[-1 - cell.returns], rel=1e-6)
    for name in ("x1", "v1", "x2", "v2"):
        times = sections[-1 - cell.returns] + cell.time
        expected = np.interp(times, motion["time"], motion[name])
        rate = np.abs(np.gradient(motion[name], motion["time"])).max()
        # States and times are both rounded to their levels.
        tolerance = 0.6 * np.ptp(expected) / encoding.STATE_LEVELS + 0.6 * rate * cell.duration / encoding.TIME_LEVELS
        np.testing.assert_allclose(cell.states[name], expected, atol=tolerance)


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


@pytest.mark.parametrize(
    ("question", "line"),
    [
        ({"parameters": None}, "explore: parameters: "),
        ({"parameters": [1]}, "explore: parameters: "),
        ({"parameters": {"beta": -1}}, "explore: beta: is -1; it must be above 0"),
        ({"parameters": {"beta": "x"}}, "explore: beta: "),
        ({"parameters": {"beta": float("nan")}}, "explore: beta: "),
        ({"parameters": {"beta": float("inf")}}, "explore: beta: "),
        ({"parameters": {"beta": True}}, "explore: beta: "),
        ({"parameters": {"bta": 0.4}}, 'did you mean "beta"?'),
        ({"parameters": {"friction": "coulomb"}}, "explore: "),
        ({"parameters": {}, "start": "nowhere"}, "explore: start: "),
        ({"parameters": {}, "start": [1, 2]}, "explore: start: "),
        ({"parameters": {}, "start": {"x": 1}}, "explore: start: "),
        ({"parameters": {}, "duration": 1e9}, "explore: duration: there is no such thing to ask for"),
        ({"lane": 12}, "explore: lane: 12 is not a lane; there are 12, from 0"),
        ({"lane": -1}, "explore: lane: "),
        ({"lane": True}, "explore: lane: "),
        ({"lane": None}, "explore: lane: "),
    ],
)
def test_wrong_requests_are_refused_in_one_line(motions, question, line):
    with pytest.raises(InputError) as error:
        motions.answer(question, no_newer_request)
    assert line in str(error.value) and "\n" not in str(error.value)


def test_motion_with_too_many_steps_is_abandoned(motions, monkeypatch):
    monkeypatch.setattr(live_motions, "MOTION_MAX_STEPS", 512)
    with pytest.raises(InputError, match=r"explore: over 512 steps led to .* s of 14 s; give a softer contact"):
        motions.answer({"parameters": {"k0": 300e6}}, no_newer_request)


def test_pulses_repeat():
    """Under equal pulses, each pulse leaves the bit in the same state as the one before, only deeper."""
    cell = decode_single(LiveMotions("penetration", {"frequency": 25.0}, None, 2.0).answer({}, no_newer_request))
    assert (cell.kind, cell.returns, cell.duration) == ("orbit", 1, pytest.approx(0.04, rel=1e-6))
    swept = LiveMotions("penetration", {"pulse_shape": "sweep", "bias": 60e3}, None, 2.0)
    assert decode_single(swept.answer({}, no_newer_request)).kind == "motion"


def test_unusual_values_are_noted(motions):
    cell = decode_single(motions.answer({"parameters": {"delta": 1.0}}, no_newer_request))
    assert "far outside what the source and rigs have" in cell.note


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


def test_motions_for_other_datasets():
    """The sliders of a trajectory's page start at the trajectory's own point."""
    motion = vj.simulate("rotary", v=0.7, friction="coulomb", mu=0.3, duration=1.0, start="stuck", progress=False)
    motions = motions_for(motion)
    assert motions.point.parameters["v"] == 0.7 and motions.point.parameters["mu"] == 0.3
    assert motions.point.options["friction"] == "coulomb" and motions.point.start == "stuck"
    with pytest.raises(InputError, match="explore: "):
        motions_for(motion.assign_attrs(scene="nothing"))
    with pytest.raises(InputError, match="attribute run"):
        motions_for(motion.assign_attrs(run="{"))


def test_sliders_reach_all_values_of_the_sweep():
    axes = {"delta": {"start": -0.2, "stop": 0.1, "num": 3}, "gamma": [0.01, 0.7]}
    motions = motions_of(vj.read_sweep({"scene": "vibro-impact", "grid": axes}))
    sliders = {entry["name"]: entry for entry in motions.offered()["parameters"]}
    assert motions.offered()["state_labels"][:2] == ["x1 at the start [m]", "v1 at the start [m/s]"]
    assert sliders["delta"]["low"] == -0.2 and sliders["delta"]["high"] == 0.1 and not sliders["delta"]["log"]
    assert sliders["gamma"]["low"] == 0.01 and sliders["gamma"]["log"]
    assert sliders["delta"]["units"] == "mm" and sliders["delta"]["factor"] == 1e3


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

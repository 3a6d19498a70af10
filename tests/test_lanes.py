"""Tests that a lane's result does not depend on its chunk, position, region, neighbours or cores, and is that of a
trajectory; carried lanes."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from refusals import refusal
from systems import events_of, mass, names_of

import vibrojax as vj
from vibrojax.compile import xla
from vibrojax.compile.native import kernels
from vibrojax.maps import dataset as joining
from vibrojax.maps.run import run_sweep, run_to_file
from vibrojax.measures.labels import FAILED, IRREGULAR, SINGLE_IMPACT
from vibrojax.studies.sweep import frequency_part
from vibrojax.studies.trajectory import feature_lines

CASES = json.loads((Path(__file__).parent / "data" / "vibro_impact_cases.json").read_text())
PERIODIC = [case for case in CASES if case["expected"].get("cycles", 0) > 0]
COPIES = 5
SHORT = {"settle": 12.0, "observe": 6.0}

# Every sweep begins with a stuck lane: the program depends on the order in which starts first occur.
TILED = [PERIODIC[index % len(PERIODIC)] for index in range(COPIES * len(PERIODIC))]


def sweep(cases, **run):
    points = {key: [case["point"][key] for case in cases] for key in CASES[0]["point"]}
    return {"scene": "vibro-impact", "points": points, "run": run}


def features(dataset):
    """Return the values of all variables, by name."""
    return {name: variable.values for name, variable in dataset.data_vars.items()}


def assert_identical(actual, expected):
    """Check that all values are equal bit for bit, NaN included."""
    assert actual.keys() == expected.keys()
    for name in actual:
        np.testing.assert_array_equal(actual[name], expected[name], err_msg=name)


@pytest.fixture(scope="module")
def tiled():
    """Return lanes that each occur five times, at different positions, in two chunks of whole and short blocks."""
    return features(vj.run_sweep(sweep(TILED, chunk=100, **SHORT), progress=False))


@pytest.fixture(scope="module")
def usual_width():
    return run_rotary()


def run_rotary():
    grid = {"beta": [0.3, 0.4, 0.5], "gamma": [0.6, 0.7, 0.8]}
    return features(vj.run_sweep({"scene": "rotary", "grid": grid, "run": SHORT}, progress=False))


def test_vector_width(usual_width, width):
    """Groups of 2, 4 or 8 lanes, and twice as many while lanes settle, give the same bits."""
    assert_identical(run_rotary(), usual_width)


def test_order_of_lanes_chunk_size_and_number_of_cores(tiled, monkeypatch):
    """All lanes but the first are in reverse order, so that each block has other neighbours."""
    assert np.mean(tiled["cycles"] > 0) > 0.8  # the others have not settled within 12 s
    monkeypatch.setenv("VIBROJAX_THREADS", "3")
    assert len(xla.workers()) == 3
    order = [0, *range(len(TILED) - 1, 0, -1)]
    backwards = vj.run_sweep(sweep([TILED[index] for index in order], chunk=50, **SHORT), progress=False)
    assert_identical(features(backwards), {name: values[order] for name, values in tiled.items()})


def test_accelerators_are_not_overlooked(monkeypatch, tmp_path):
    """Without jax, workers are those of the CPU only if jax could find no other devices."""
    may_have = xla._may_have_accelerator.__wrapped__
    for name in xla.DEVICE_VARIABLES:
        monkeypatch.delenv(name, raising=False)
    if may_have():
        pytest.skip("a plugin is installed")
    monkeypatch.setenv("JAX_PLATFORMS", "cuda,cpu")
    assert may_have()
    monkeypatch.delenv("JAX_PLATFORMS")
    (tmp_path / "jax_plugins" / "xla_cuda13").mkdir(parents=True)
    monkeypatch.syspath_prepend(tmp_path)
    assert may_have()
    monkeypatch.setenv("JAX_PLATFORMS", "cpu")
    assert not may_have()


def test_second_sweep_compiles_nothing(tiled):
    """Parameters, times and accuracy are values, so another sweep of the scene runs in the same program."""
    compiled = list(kernels)
    other = [{"point": case["point"] | {"beta": 0.33, "v": 1.1}} for case in PERIODIC]
    for run in ({"error": 1e-3}, {"settle": 3.0, "observe": 2.0}, {"step": 2e-3}):
        vj.run_sweep(sweep(other, **(SHORT | run)), progress=False)
    fixed = sweep(other, **SHORT) | {"parameters": {"m1": 200.0, "k0": 4e7, "c0": 10.0, "mu": 0.3}}
    vj.run_sweep(fixed, progress=False)
    assert list(kernels) == compiled


def test_keep_returns():
    """The newest return is last. Each has the time of a section crossing of `simulate`; missing ones are NaN."""
    keep, cases = 5, [*PERIODIC[:2], *[case for case in CASES if case["expected"]["regime"] == "equilibrium"]]
    dataset = vj.run_sweep(sweep(cases, settle=2.0, observe=3.0, keep_returns=keep), progress=False)
    assert dataset.sizes["return_index"] == keep
    for index, case in enumerate(cases):
        motion = vj.simulate("vibro-impact", **case["point"], duration=5.0, sampling=0.1, progress=False)
        times = events_of(motion, "section")
        times = times[times > 2.0]
        kept = dataset.return_time[index].values
        expected = np.concatenate([np.full(max(keep - len(times), 0), np.nan), times[-keep:]])
        np.testing.assert_allclose(kept, expected, rtol=1e-9)
        assert dataset.returns[index] == len(times)
    known = dataset.isel(point=0)
    assert np.all(known.return_impacts == 1)
    np.testing.assert_allclose(known.return_impact_velocity.mean(), known.impact_velocity, rtol=1e-2)


def test_float32():
    """In single precision and at the full 48 s, periodic cases have the right regime. Their period and impact velocity
    are right to 3e-6. No lane is abandoned, the irregular ones included."""
    single = vj.run_sweep(sweep(CASES, precision="float32"), progress=False)
    assert np.all(single.status == 0)
    for index, (case, regime) in enumerate(zip(CASES, names_of(single), strict=True)):
        expected = case["expected"]
        if expected.get("cycles", 0) == 0:
            continue
        assert (regime, single.cycles[index]) == (expected["regime"], expected["cycles"]), (index, case["point"])
        for name in ("period", "impact_velocity"):
            if expected.get(name):
                np.testing.assert_allclose(single[name][index], expected[name], rtol=3e-6, err_msg=f"{name} {index}")


JOINED = {
    "scene": "vibro-impact",
    "parameters": {"delta": 0.0},
    "grid": {"beta": [0.4, 0.5], "gamma": [0.6, 0.7, 0.9]},
    "starts": ["drive", "stuck", "touching"],
    "run": {"settle": 40.0, "observe": 8.0, "chunk": 4},
}


JOIN_SCRIPT = """
import resource, sys, time
from pathlib import Path
import numpy as np
import vibrojax as vj
from vibrojax.maps.dataset import join
from vibrojax.maps.executor import compute
from vibrojax.io.writers import file_target
from vibrojax.periodic.lane_stages import lane_run
grid = {"v": np.linspace(0.5, 2.0, int(sys.argv[2])), "k1": np.linspace(1e5, 2e5, 1000)}
sweep = vj.read_sweep({"scene": "rotary", "starts": ["stuck"], "run": {"settle": 0.1, "observe": 0.1}, "grid": grid})
run = lane_run(sweep.inputs(0, 1), sweep.plan)
_, one = next(compute(sweep, run, [0]))
for name in ("bit_amplitude", "drive_power"):
    one[name] = one[name] + np.random.default_rng(0).random(len(one[name]))
def read(index):
    first, end = sweep.chunk(index)
    return {name: x[:end - first] if x.ndim else x for name, x in one.items()}
with file_target(Path(sys.argv[1])) as target:
    join(sweep, run, read, target, time.monotonic())
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""


@pytest.mark.parametrize(
    "starts, changes", [(JOINED["starts"], ["run.keep_returns=3"]), (["stuck"], ["run.carry=beta", "run.settle=2.0"])]
)
def test_regions_do_not_change_result(starts, changes, tmp_path, monkeypatch):
    """Chunks and regions split points and paths of carried lanes. Real regions hold a million lanes."""
    sweep = vj.read_sweep(JOINED | {"starts": starts}, changes)
    expected = run_sweep(sweep, progress=False)
    monkeypatch.setattr(joining, "REGION", 2)
    for joined in (run_sweep(sweep, progress=False), run_to_file(sweep, tmp_path / "out.nc", progress=False)):
        xr.testing.assert_identical(joined.drop_attrs(), expected.drop_attrs())
        assert joined.attrs["certified"] == expected.attrs["certified"]


@pytest.mark.long
def test_memory_is_bounded_by_region(tmp_path):
    """Three times as many lanes take no more memory; 75 MB of additional values would show."""
    environment, peaks = os.environ | {"PYTHONPATH": str(Path(__file__).parents[1])}, []
    for rows in ("250", "750"):
        command = [sys.executable, "-c", JOIN_SCRIPT, str(tmp_path / "out.nc"), rows]
        process = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
        peaks.append(int(process.stdout) / 1e3)
    assert peaks[1] - peaks[0] < 40.0, peaks


# Lanes that are carried along an axis: each starts from the final state of the previous one
BETAS, GAMMAS = [0.3, 0.4], [0.59, 0.61, 0.63, 0.7, 0.75]
MAP = {
    "scene": "vibro-impact",
    "starts": ["stuck"],
    "parameters": {"delta": 0.005},
    "grid": {"beta": BETAS, "gamma": GAMMAS, "v": [1.5, 2.0]},
}
STATES = ("x1", "v1", "x2", "v2")


def carried_sweep(**run):
    return MAP | {"run": {"settle": 10.0, "observe": 4.0, "carry": "gamma"} | run}


@pytest.fixture(scope="module")
def carried():
    return vj.run_sweep(carried_sweep(), progress=False)


def test_lane_starts_from_final_state_of_previous_lane():
    """Compare with trajectories, each of which starts from the end of the previous one."""
    run = {"settle": 0.7, "observe": 0.5, "end_early": False}
    lanes = vj.run_sweep(carried_sweep(**run), progress=False)
    for direction, gammas in (("up", GAMMAS), ("down", GAMMAS[::-1])):
        start: object = "stuck"
        for gamma in gammas:
            lane, point = lanes.sel(beta=0.4, gamma=gamma, v=1.5, direction=direction), {"beta": 0.4, "delta": 0.005}
            motion = vj.simulate("vibro-impact", gamma=gamma, start=start, duration=1.2, progress=False, **point)
            late = motion.sel(time=slice(0.7, None))
            for name, state in (("bit_amplitude", "x1"), ("striker_amplitude", "x2")):
                swing = float(late[state].max() - late[state].min()) / 2  # of samples, not of turning points
                assert abs(float(lane[name]) - swing) < 2e-3 * swing, (direction, gamma, name)
            start = [float(motion[name][-1]) for name in STATES]


def test_chunks_hold_whole_paths(tmp_path, carried):
    run_to_file(vj.read_sweep(carried_sweep(chunk=13)), tmp_path / "out.nc", progress=False)  # two paths of five lanes
    xr.testing.assert_equal(vj.open_dataset(tmp_path / "out.nc"), carried)


def test_carrying_continues_after_a_failed_lane():
    """After a failed lane there is no final state, so the next lane begins at the start."""
    stiff = {"scene": "vibro-impact", "starts": ["stuck"], "grid": {"k0": [5e7, 1e300]}, "run": carried_sweep()["run"]}
    carried_lanes = vj.run_sweep(stiff | {"run": stiff["run"] | {"carry": "k0"}, "unusual": True}, progress=False)
    alone = vj.run_sweep(stiff | {"grid": {"k0": [5e7]}, "run": {"settle": 10.0, "observe": 4.0}}, progress=False)
    assert (carried_lanes.regime.sel(k0=1e300) == FAILED).all()
    np.testing.assert_array_equal(carried_lanes.period.sel(k0=5e7), [alone.period.item()] * 2)


def test_unsuitable_axis_is_refused_in_one_line():
    for run, tables, line in (
        ({"carry": "gama"}, {}, 'run.carry: "gama" is not an axis of [grid]; did you mean "gamma"?'),
        ({"carry": "gamma"}, {"starts": ["drive", "stuck"]}, "run.carry: 2 starts; the first lane in each direction"),
        ({"carry": "gamma"}, {"grid": {"gamma": [0.7, 0.6]}}, "run.carry: the values of gamma do not rise"),
    ):
        assert line in refusal(vj.read_sweep, MAP | tables | {"run": run})


def test_hysteresis_between_directions(carried):
    """At beta 0.4 and a gap of 5 mm, a single impact (carried down) coexists with an irregular motion (carried up)."""
    assert carried.regime.dims == ("beta", "gamma", "v", "direction")
    assert "gamma" in carried.direction.attrs["long_name"]
    at_gap = carried.sel(beta=0.4, gamma=[0.7, 0.75], v=1.5)
    assert (at_gap.regime.sel(direction="up") == IRREGULAR).all()
    assert (at_gap.regime.sel(direction="down") == SINGLE_IMPACT).all()


# The features that `simulate` reports, and their text
STRONG = {"threshold": 30e3, "delta": 0.002}
POINTS = {
    "vibro-impact": ({"delta": 0.002, "gamma": 0.5, "beta": 0.9}, 12.0),
    "coupled-drilling": (STRONG, 5.0),
    "penetration": ({"force": 300e3}, 1.0),
}
ROUNDING = {"drift_estimate", "deepest_gap", "stick_fraction"}
"""Features that are zero here up to rounding, or that measure rounding."""


def swept_lane(scene, parameters, run, **more):
    """Return the only lane of a sweep that settles and is observed as `run` says."""
    starts = {} if scene == "penetration" else {"starts": ["stuck"]}
    sweep = {"scene": scene, "parameters": parameters, "grid": {"m1": [250.0]}, "run": run | more} | starts
    return vj.run_sweep(sweep, progress=False).squeeze()


@pytest.mark.parametrize("scene", POINTS)
def test_motion_is_measured_and_labelled_like_lane_of_sweep(scene):
    parameters, duration = POINTS[scene]
    start = {} if scene == "penetration" else {"start": "stuck"}
    motion = vj.simulate(scene, duration=duration, progress=False, **parameters, **start)
    lane = swept_lane(scene, parameters, json.loads(motion.attrs["run"]), end_early=False)
    sweep_only = {"check_regime", "error_estimate", "sensitive", "status", "reason"}
    assert set(lane.data_vars) - sweep_only == {name for name in motion.data_vars if motion[name].ndim == 0}
    for name in set(lane.data_vars) - sweep_only:
        assert motion[name].attrs["units"] == lane[name].attrs["units"]
        assert motion[name].dtype == lane[name].dtype
        atol = 1e-7 if name in ROUNDING else 0.0
        np.testing.assert_allclose(motion[name], lane[name], rtol=1e-7, atol=atol, err_msg=name)


def test_undecided_motion_names_a_sufficient_duration():
    motion = vj.simulate("vibro-impact", duration=1.0, progress=False)
    line = feature_lines(motion)[0]
    assert line.startswith("undecided: 2 returns to the section are too few to judge by, 9 are needed; give duration=")
    enough = float(line.rpartition("=")[2])
    longer = vj.simulate("vibro-impact", duration=enough, progress=False)
    assert longer["returns"] >= 9
    still = vj.simulate("vibro-impact", v=0.0, duration=1.0, progress=False)
    assert "the drive is at rest: give v above 0" in feature_lines(still)[0]


def test_short_motion_that_repeats_has_its_period():
    """12 cycles of a damped, driven oscillator: too few returns for a regime, enough for the period."""
    rate = lambda t, y, p: vj.elementary.cos(2 * t) - 2 * p["zeta"] * y["v"] - y["x"]
    oscillator = mass(rate, parameters={"zeta": 0.5}, period=lambda p: np.pi)
    motion = vj.simulate(oscillator, duration=12 * np.pi, progress=False)
    assert int(motion.cycles) == 1 and float(motion.period) == pytest.approx(np.pi, rel=1e-12)
    assert "so far it repeats in each period of 3.1416 s; give duration=" in feature_lines(motion)[0]


def test_frequencies_are_outputs():
    """Compare with w1/2pi, w2/2pi, the roots of the frequency equation (sum and product), and impacts per minute."""
    motion = vj.simulate("vibro-impact", delta=0.005, start="stuck", striker_frequency=3.0, progress=False)
    outputs = vj.frequencies(motion)
    assert float(outputs["bit_frequency"]) == pytest.approx(25 / (2 * np.pi))
    assert float(outputs["striker_frequency"]) == pytest.approx(3.0) and outputs["striker_frequency"].units == "Hz"
    squares = [(2 * np.pi * float(outputs[name])) ** 2 for name in ("lower_frequency", "upper_frequency")]
    gamma = 6 * np.pi / 25
    assert sum(squares) == pytest.approx(625 * (1 + gamma**2 * 1.4))
    assert np.prod(squares) == pytest.approx(625**2 * gamma**2)
    single = float(motion.impacts) == float(motion.cycles) == 1
    assert single and float(outputs["blow_frequency"]) == pytest.approx(60 / float(motion.period))
    lanes = {"impacts": ("rpm", [3.0, 0.5, 0.0]), "cycles": ("rpm", [2, 0, 1]), "period": ("rpm", [0.2, 0.25, 0.2])}
    text = 'scene = "vibro-impact"\n[parameters]\nbit_radius = 0.1\n'
    ds = xr.Dataset(lanes, {"rpm": [100.0, 110.0, 120.0]}, {"sweep": text})
    np.testing.assert_allclose(vj.frequencies(ds)["blow_frequency"], [450.0, 120.0, 0.0])
    part = frequency_part(ds)
    assert part.lines == ["blows 0 to 450 1/min, rotation 100 to 120 1/min"]
    assert part.facts["frequencies"]["rpm"] == {"least": 100.0, "greatest": 120.0, "units": "min-1"}

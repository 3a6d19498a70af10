"""Test lanes carried along an axis, up and down: each starts from the final state of the previous lane."""

import numpy as np
import pytest
import xarray as xr

import vibrojax as vj
from vibrojax.errors import InputError
from vibrojax.io.dataset import open_dataset
from vibrojax.maps.read import read_sweep
from vibrojax.maps.run import run_to_file
from vibrojax.measures.labels import FAILED, IRREGULAR, SINGLE_IMPACT

BETAS, GAMMAS = [0.3, 0.4], [0.59, 0.61, 0.63, 0.7, 0.75]
MAP = {
    "scene": "vibro-impact",
    "starts": ["stuck"],
    "parameters": {"delta": 0.005},
    "grid": {"beta": BETAS, "gamma": GAMMAS, "v": [1.5, 2.0]},
}
STATES = ("x1", "v1", "x2", "v2")


def sweep(**run):
    return MAP | {"run": {"settle": 10.0, "observe": 4.0, "carry": "gamma"} | run}


@pytest.fixture(scope="module")
def carried():
    return vj.run_sweep(sweep(), progress=False)


def test_lane_starts_from_final_state_of_previous_lane():
    """Compare with trajectories, each of which starts from the end of the previous one."""
    run = {"settle": 0.7, "observe": 0.5, "end_early": False}
    lanes = vj.run_sweep(sweep(**run), progress=False)
    for direction, gammas in (("up", GAMMAS), ("down", GAMMAS[::-1])):
        start: object = "stuck"
        for gamma in gammas:
            lane = lanes.sel(beta=0.4, gamma=gamma, v=1.5, direction=direction)
            motion = vj.simulate(
                "vibro-impact", beta=0.4, gamma=gamma, delta=0.005, start=start, duration=1.2, progress=False
            )
            late = motion.sel(time=slice(0.7, None))
            for name, state in (("bit_amplitude", "x1"), ("striker_amplitude", "x2")):
                swing = float(late[state].max() - late[state].min()) / 2  # of samples, not of turning points
                assert abs(float(lane[name]) - swing) < 2e-3 * swing, (direction, gamma, name)
            start = [float(motion[name][-1]) for name in STATES]


def test_hysteresis_between_directions(carried):
    """At beta 0.4 and a gap of 5 mm, a single impact (carried down) coexists with an irregular motion (carried up)."""
    assert (
        carried.regime.dims == ("beta", "gamma", "v", "direction") and "gamma" in carried.direction.attrs["long_name"]
    )
    at_gap = carried.sel(beta=0.4, gamma=[0.7, 0.75], v=1.5)
    assert (at_gap.regime.sel(direction="up") == IRREGULAR).all()
    assert (at_gap.regime.sel(direction="down") == SINGLE_IMPACT).all()


def test_chunks_hold_whole_paths(tmp_path, carried):
    run_to_file(read_sweep(sweep(chunk=13)), tmp_path / "out.nc", progress=False)  # two paths of five lanes
    xr.testing.assert_equal(open_dataset(tmp_path / "out.nc"), carried)


def test_carrying_continues_after_a_failed_lane():
    """After a failed lane there is no final state, so the next lane begins at the start."""
    stiff = {"scene": "vibro-impact", "starts": ["stuck"], "grid": {"k0": [5e7, 1e300]}, "run": sweep()["run"]}
    carried_lanes = vj.run_sweep(stiff | {"run": stiff["run"] | {"carry": "k0"}, "unusual": True}, progress=False)
    alone = vj.run_sweep(stiff | {"grid": {"k0": [5e7]}, "run": {"settle": 10.0, "observe": 4.0}}, progress=False)
    assert (carried_lanes.regime.sel(k0=1e300) == FAILED).all()
    np.testing.assert_array_equal(carried_lanes.period.sel(k0=5e7), [alone.period.item()] * 2)


@pytest.mark.parametrize(
    ("run", "tables", "line"),
    [
        ({"carry": "gama"}, {}, 'run.carry: "gama" is not an axis of [grid]; did you mean "gamma"?'),
        ({"carry": "gamma"}, {"starts": ["drive", "stuck"]}, "run.carry: 2 starts; the first lane in each direction"),
        ({"carry": "gamma"}, {"grid": {"gamma": [0.7, 0.6]}}, "run.carry: the values of gamma do not rise"),
    ],
)
def test_unsuitable_axis_is_refused_in_one_line(run, tables, line):
    with pytest.raises(InputError) as caught:
        read_sweep(MAP | tables | {"run": run})
    assert line in str(caught.value) and "\n" not in str(caught.value)

"""Tests of lanes that end early, settled or on orbits, alone or shared by starts, against lanes stepped to the end."""

import json
from functools import cache

import numpy as np
import pytest

import vibrojax as vj
from vibrojax.lanes.settled import settled
from vibrojax.maps.dataset import SECONDS
from vibrojax.maps.executor import compute
from vibrojax.measures.repeats import Seen
from vibrojax.measures.section import Passed, Settling
from vibrojax.periodic import lane_stages
from vibrojax.periodic.lane_stages import lane_run

LANES, ERROR = 128, 1e-4
VARIABLES = ("period", "bit_amplitude", "striker_amplitude", "drive_power", "stick_fraction", "settling_time")
VARIABLES += ("impact_velocity", "impact_velocity_min", "bit_velocity_at_impact", "impact_energy", "mean_impact_force")


def steps_taken(dataset) -> int:
    return json.loads(dataset.attrs["solver"])["steps"]


@cache
def early_and_full(*run) -> tuple:
    """Return the dataset of random lanes with `end_early` and without; `run` holds pairs of a setting and its value."""
    rng = np.random.default_rng(11)
    box = {"beta": (0.2, 0.8), "gamma": (0.5, 0.9), "v": (np.log(0.5), np.log(2.0)), "delta": (-0.005, 0.01)}
    points = {name: rng.uniform(*bounds, LANES) for name, bounds in box.items()}
    points |= {"v": np.exp(points["v"]), "start": ["stuck", "drive"] * (LANES // 2)}
    run = {"settle": 24.0, "observe": 8.0, "error": ERROR} | dict(run)
    return early_then_full({"scene": "vibro-impact", "points": points, "run": run})


def early_then_full(sweep) -> tuple:
    runs = (sweep["run"] | {"end_early": early} for early in (True, False))
    return tuple(vj.run_sweep(sweep | {"run": run}, progress=False) for run in runs)


def test_early_end_matches_full_run():
    """All labels agree, values of periodic lanes agree within the accepted error, and fewer steps are taken."""
    early, full = early_and_full()
    np.testing.assert_array_equal(early["regime"], full["regime"])
    repeats, irregular = (full["cycles"] > 0).values, (full["cycles"] == 0).values
    assert repeats.sum() > LANES / 4 and irregular.sum() > 5
    for name in ("cycles", "impacts", "check_regime"):
        np.testing.assert_array_equal(early[name][repeats], full[name][repeats], err_msg=name)
    for name in VARIABLES:
        np.testing.assert_allclose(early[name][repeats], full[name][repeats], rtol=ERROR, atol=1e-12, err_msg=name)
    assert steps_taken(early) < 0.9 * steps_taken(full)
    # Lanes that end early do not change the other lanes, to the last bit.
    for name in full.data_vars:
        np.testing.assert_array_equal(early[name][irregular], full[name][irregular], err_msg=name)
    early, full = early_and_full(("keep_returns", 4))
    assert steps_taken(early) == steps_taken(full)
    assert early.drop_attrs().equals(full.drop_attrs())


RETURNS_BACK = np.arange(8.0)


def settling_record(distances, period=0.5, last=9.9):
    """Return the record of a lane whose last returns, newest first, lie at these relative distances from its limit."""
    states = np.zeros((8, 3, 1))
    states[:, 1, 0] = 0.01 * np.asarray(distances)
    scales = tuple(np.array([x]) for x in (0.02, 0.01, 0.01 * 2 * np.pi / period))
    times = np.where(np.isnan(states[:, 1]), np.nan, last - period * RETURNS_BACK[:, None])
    seen = Seen(armed=None, since=None, ranges=(), states=states, times=times, settled=None, frequency=None)
    return Settling(seen, Passed(waiting=None, state=None, time=None, scales=scales))


@pytest.mark.parametrize(
    "distances, close, ends",
    [
        (1e-8 * 2.0**RETURNS_BACK, 5e-8, True),  # the differences of returns put it 1e-8 away, or up to five times that
        (1e-8 * 2.0**RETURNS_BACK, 0.9e-8, False),
        (1e-6 * 2.0**RETURNS_BACK, 1e-7, False),  # converges, but is not there yet
        (1e-10 * np.cos(2.0 * RETURNS_BACK) * 1.6**RETURNS_BACK, 1e-7, True),  # spirals in
        (1e-9 * RETURNS_BACK, 59e-9, False),  # drifts by 1e-9 with each of the sixty remaining returns
        (1e-8 * 0.5**RETURNS_BACK, 1e-7, False),  # diverges
        (1e-3 * (-1.0) ** RETURNS_BACK, 1e-7, True),  # repeats after two returns
        (np.where(RETURNS_BACK < 6, 1e-9, np.nan) * RETURNS_BACK, 1e-7, False),  # has too few returns
    ],
)
def test_settled(distances, close, ends):
    """Differences of returns decide. A geometric approach is as far away as the sum of its series, or slightly more."""
    is_settled, duration = settled(settling_record(distances), 10.0, 40.0, 8.0, close)
    assert is_settled.tolist() == [ends]
    if ends:
        assert 9 * 0.5 <= duration[0] <= 8.0


# Ends on stable orbits: labels are those of the full run, values those of the orbit
MOST_LANES = 384
WIDE = {"beta": (0.1, 1.2), "gamma": (0.3, 1.2), "v": (0.3, 3.0), "delta": (-0.006, 0.012)}
"""Wide box of the vibro-impact scene. In 4,096 lanes each of this box and of two boxes within, all 6,749 periodic lanes
have the label of the full run; 5,829 of them end on orbits. In float32 all 6,758 do; 5,789 of them end on orbits."""


@pytest.fixture
def allow_any_cost(monkeypatch):
    """End lanes on orbits even where compiling the return map takes longer than it saves, as in sweeps of minutes."""
    monkeypatch.setattr(lane_stages, "EARLY_END_MIN_SECONDS", 0.0)


def sweep(lanes=MOST_LANES, **run):
    rng = np.random.default_rng(7)
    points = {name: rng.uniform(*bounds, lanes).tolist() for name, bounds in WIDE.items()}
    points["start"] = [("stuck", "drive")[lane % 2] for lane in range(lanes)]
    return {"scene": "vibro-impact", "points": points, "run": {"settle": 32.0} | run}


@pytest.mark.usefixtures("allow_any_cost")
def test_labels_and_values_match_full_run():
    """Labels, counts and settling times agree, values within the accepted error. Lanes that end early save steps."""
    early, full = early_then_full(sweep())
    repeats = (full.cycles > 0).values
    assert steps_taken(early) < 0.7 * steps_taken(full) and early.dtypes == full.dtypes
    np.testing.assert_array_equal(early.regime, full.regime)
    for name in ("cycles", "impacts", "check_regime"):
        np.testing.assert_array_equal(early[name].values[repeats], full[name].values[repeats], err_msg=name)
    for name in ("period", "impact_velocity", "bit_amplitude", "settling_time"):
        np.testing.assert_allclose(early[name].values[repeats], full[name].values[repeats], rtol=1e-4, err_msg=name)


@pytest.mark.usefixtures("allow_any_cost")
def test_result_does_not_depend_on_chunk_size():
    """The orbit of a lane does not depend on its neighbours."""
    whole, parts = (vj.run_sweep(sweep(lanes=96, chunk=chunk), progress=False) for chunk in (96, 40))
    for name in whole.data_vars:
        np.testing.assert_array_equal(whole[name], parts[name], err_msg=name)


@pytest.mark.usefixtures("allow_any_cost")
def test_nearby_orbit_predicts_end_of_long_transient():
    """Most lanes that are not periodic after 40 s but have a stable orbit nearby are on it after 300 s."""
    rng = np.random.default_rng(14)
    box = {"beta": rng.uniform(0.1, 1.2, 256).tolist(), "gamma": rng.uniform(0.3, 1.2, 256).tolist()}
    soon, late = (
        vj.run_sweep({"scene": "vibro-impact", "points": box | {"start": ["stuck"] * 256}, "run": run}, progress=False)
        for run in ({"orbits": True}, {"settle": 300.0})
    )
    near = (soon.nearby_cycles > 0).values
    assert near.sum() >= 5
    assert not near[(soon.regime.isin([2, 3, 4, 5])).values].any()
    reached = (soon.nearby_cycles == late.cycles).values & (soon.nearby_impacts == late.impacts).values
    assert reached[near].mean() >= 0.9
    assert (soon.nearby_distance.values[near] < 0.5).all()
    assert np.isnan(soon.nearby_distance.values[~near]).all()


# Orbits shared by the starts of a point
BOX = {"x1": [-0.05, 0.05], "v1": [-2.0, 2.0], "x2": [-0.05, 0.05], "v2": [-3.0, 3.0]}
GRID = {"beta": [0.3, 0.4], "gamma": [0.35, 0.75]}
"""Single impacts, orbits of two returns, rattling and irregular motion. Over 35 points of beta 0.2 to 0.9 and gamma
0.35 to 1.0 with 128 starts each, all 3,495 periodic lanes have the label of the full run, and its values to 5e-12."""


def sweep_of_starts(starts=96, **run):
    drawn = {"sample": "sobol", "count": starts, "seed": 5, "box": BOX}
    return {"scene": "vibro-impact", "parameters": {"delta": 0.005}, "starts": drawn, "grid": GRID, "run": run}


def test_labels_and_values_with_shared_orbits_match_full_run():
    """Nearly every label agrees (here all do). Values agree within the accepted error, which the estimate bounds."""
    early, full = early_then_full(sweep_of_starts(orbits=True))
    repeats = (full.cycles > 0).values
    assert steps_taken(early) < 0.5 * steps_taken(full)
    same = (early.regime == full.regime).values & (early.cycles == full.cycles).values
    assert same[repeats].mean() >= 0.999
    np.testing.assert_array_equal(early.impacts.values[repeats & same], full.impacts.values[repeats & same])
    for name in ("period", "impact_velocity"):
        excess = np.abs(early[name] / full[name] - 1) - early.error_estimate - full.error_estimate
        assert (excess.values[repeats & same] <= 0).all()
    np.testing.assert_allclose(early.settling_time, full.settling_time, rtol=1e-6)
    assert early.error_estimate.values[repeats].max() < 1e-2
    assert (early.stable.values == full.stable.values)[repeats].all()


def test_result_does_not_depend_on_order_of_chunks():
    """A chunk shares orbits only within itself, so earlier chunks do not affect it."""
    spec = vj.read_sweep(sweep_of_starts(64, orbits=True, chunk=96))
    assert spec.chunks == 3
    first, again = (lane_run(spec.inputs(0, 1), spec.plan) for _ in range(2))
    forward = {index: dict(compute(spec, first, [index]))[index] for index in range(3)}
    backward = {index: dict(compute(spec, again, [index]))[index] for index in (2, 0, 1)}
    for index, chunk in forward.items():
        for name in chunk.keys() - {SECONDS}:
            np.testing.assert_array_equal(chunk[name], backward[index][name], err_msg=name)

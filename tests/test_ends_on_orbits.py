"""Tests of ending lanes on stable orbits: labels are those of the full run, values those of the orbit."""

import numpy as np
import pytest
from test_end_early import steps_taken

import vibrojax as vj
from vibrojax.maps.read import read_sweep
from vibrojax.periodic import lane_stages
from vibrojax.periodic.orbits import Orbits
from vibrojax.periodic.settled_on_orbit import Approach, will_reach
from vibrojax.scenes import SCENES

LANES = 384
WIDE = {"beta": (0.1, 1.2), "gamma": (0.3, 1.2), "v": (0.3, 3.0), "delta": (-0.006, 0.012)}
"""Wide box of the vibro-impact scene. In 4,096 lanes each of this box and of two boxes within, all 6,749 periodic lanes
have the label of the full run; 5,829 of them end on orbits. In float32 all 6,758 do; 5,789 of them end on orbits."""


@pytest.fixture(autouse=True)
def allow_any_cost(monkeypatch):
    """End lanes on orbits even where compiling the return map takes longer than it saves, as in sweeps of minutes."""
    monkeypatch.setattr(lane_stages, "EARLY_END_MIN_SECONDS", 0.0)


def sweep(lanes=LANES, **run):
    rng = np.random.default_rng(7)
    points = {name: rng.uniform(*bounds, lanes).tolist() for name, bounds in WIDE.items()}
    points["start"] = [("stuck", "drive")[lane % 2] for lane in range(lanes)]
    return {"scene": "vibro-impact", "points": points, "run": {"settle": 32.0} | run}


@pytest.mark.parametrize("precision", ["float64", pytest.param("float32", marks=pytest.mark.long)])
def test_labels_and_values_match_full_run(precision):
    """Labels, counts and settling times agree, values within the accepted error. Lanes that end early save steps."""
    spec = sweep(precision=precision)
    early_, full = (
        vj.run_sweep(spec | {"run": spec["run"] | {"end_early": early}}, progress=False) for early in (True, False)
    )
    repeats = (full.cycles > 0).values
    assert steps_taken(early_) < 0.7 * steps_taken(full) and early_.dtypes == full.dtypes
    np.testing.assert_array_equal(early_.regime, full.regime)
    for name in ("cycles", "impacts", "check_regime"):
        np.testing.assert_array_equal(early_[name].values[repeats], full[name].values[repeats], err_msg=name)
    for name in ("period", "impact_velocity", "bit_amplitude", "settling_time"):
        np.testing.assert_allclose(early_[name].values[repeats], full[name].values[repeats], rtol=1e-4, err_msg=name)


def test_result_does_not_depend_on_chunk_size():
    """The orbit of a lane does not depend on its neighbours."""
    whole, parts = (vj.run_sweep(sweep(lanes=96, chunk=chunk), progress=False) for chunk in (96, 40))
    for name in whole.data_vars:
        np.testing.assert_array_equal(whole[name], parts[name], err_msg=name)


def test_no_search_where_it_costs_more_than_it_saves(monkeypatch):
    monkeypatch.undo()
    assert lane_stages.EARLY_END_MIN_SECONDS == 5e6

    def rule_of(source):
        return lane_stages.stop_rule(read_sweep(source).inputs(), read_sweep(source).plan)

    assert rule_of(sweep(lanes=8)) is None and rule_of(sweep(lanes=8, settle=1e6)) is not None
    pulses = {"scene": "penetration", "grid": {"frequency": [40.0, 50.0]}, "run": {"settle": 1e7}}
    assert rule_of(pulses) is None


BASIS = np.array([[1.0, 0.2, -0.4], [0.3, 1.0, 0.5], [-0.2, 0.1, 1.0]])


def reaches_orbit(multipliers, away, repeats=100, bend=0.0, error=1e-4):
    """Return whether a lane is predicted to reach the orbit at zero.

    Its last returns follow a map with these `multipliers` and a quadratic term of size `bend`.
    """
    derivative = BASIS @ np.diag(multipliers) @ np.linalg.inv(BASIS)
    returns = [away * np.array([0.4, -1.0, 0.7])]
    for _ in range(7):
        returns.append(derivative @ returns[-1] + bend * returns[-1] ** 2)
    ones = np.ones(1)
    approach = Approach(
        np.arange(1), np.ones((1, 3)), np.stack(returns[::-1])[..., None], np.zeros((1, 1, 3)), ones * repeats
    )
    none, single = np.zeros((1, 1, 3)), np.ones((1, 1))
    orbit = Orbits(
        SCENES["vibro-impact"](), {}, none, np.ones((1, 3)), single, 0 * ones, derivative[None], none,
        0 * ones, ones, ones, ones, single, np.arange(1),
    )  # fmt: skip
    return will_reach(approach, orbit, 1e-7, error)[0]


@pytest.mark.parametrize(
    "multipliers, away, more, ends",
    [
        ((0.8, 0.3, 0.05), 1e-2, {}, True),
        ((-0.8, 0.3, 0.05), 2.2e-2, {}, False),
        ((0.8, 0.3, 0.05), 1e-1, {}, False),
        ((1.0, 0.3, 0.05), 1e-6, {}, False),
        ((1.01, 0.3, 0.05), 1e-9, {}, False),
        ((0.8, 0.3, 0.05), 5e-3, {"bend": 200.0}, False),
    ],
)
def test_predicted_end_on_orbit(multipliers, away, more, ends):
    assert reaches_orbit(multipliers, away, **more) == ends


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

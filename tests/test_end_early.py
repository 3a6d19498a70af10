"""Tests of early stopping: settled lanes end early with the labels and values of lanes stepped to the end."""

import json
from functools import cache

import numpy as np
import pytest

import vibrojax as vj

LANES, ERROR = 128, 1e-4
IMPACT_VARIABLES = (
    "impact_velocity",
    "impact_velocity_min",
    "bit_velocity_at_impact",
    "impact_energy",
    "mean_impact_force",
)
DRILL_VARIABLES = ("period", "bit_amplitude", "striker_amplitude", "drive_power", "stick_fraction", "settling_time")


def steps_taken(dataset) -> int:
    return json.loads(dataset.attrs["solver"])["steps"]


@cache
def early_and_full(scene: str, *run, **parameters) -> tuple:
    """Return the dataset of random lanes with `end_early` and without; `run` holds pairs of a setting and its value."""
    rng = np.random.default_rng(11)
    columns = {
        "beta": rng.uniform(0.2, 0.8, LANES),
        "gamma": rng.uniform(0.5, 0.9, LANES),
        "v": np.exp(rng.uniform(np.log(0.5), np.log(2.0), LANES)),
    }
    if scene != "rotary":
        columns["delta"] = rng.uniform(-0.005, 0.01, LANES)
    points = {name: column.tolist() for name, column in columns.items()} | {"start": ["stuck", "drive"] * (LANES // 2)}
    run = {"settle": 24.0, "observe": 8.0, "error": ERROR} | dict(run)
    sweep = {"scene": scene, "points": points, "parameters": parameters}
    return tuple(vj.run_sweep(sweep | {"run": run | {"end_early": early}}, progress=False) for early in (True, False))


@pytest.mark.parametrize(
    "scene, parameters, values",
    [
        ("vibro-impact", {}, IMPACT_VARIABLES),
        ("drilling", {"rock": "sandstone"}, (*IMPACT_VARIABLES, "rate_of_penetration", "relief", "slip_per_impact")),
    ],
)
def test_early_end_matches_full_run(scene, parameters, values):
    """All labels agree, values of periodic lanes agree within the accepted error, and fewer steps are taken."""
    early, full = early_and_full(scene, **parameters)
    for name in {"regime", "cycles", "impacts", "check_regime"} & set(full):
        repeats = np.ones(LANES, bool) if name == "regime" else (full["cycles"] > 0).values
        np.testing.assert_array_equal(early[name][repeats], full[name][repeats], err_msg=name)
    repeats = (full["cycles"] > 0).values
    assert repeats.sum() > LANES / 4
    for name in (*DRILL_VARIABLES, *values):
        np.testing.assert_allclose(early[name][repeats], full[name][repeats], rtol=ERROR, atol=1e-12, err_msg=name)
    assert steps_taken(early) < 0.9 * steps_taken(full)


def test_unsettled_lanes_are_unchanged():
    """Lanes that end early do not change the other lanes, to the last bit."""
    early, full = early_and_full("vibro-impact")
    irregular = (full["cycles"] == 0).values
    assert irregular.sum() > 5
    for name in full.data_vars:
        np.testing.assert_array_equal(early[name][irregular], full[name][irregular], err_msg=name)


@pytest.mark.parametrize("run", [[("keep_returns", 4)], [("settle", 0.0), ("observe", 12.0)]])
def test_no_lane_ends_early(run):
    """No lane ends early if single returns are kept or if there is no settling time."""
    early, full = early_and_full("vibro-impact", *run)
    assert steps_taken(early) == steps_taken(full)
    assert early.drop_attrs().equals(full.drop_attrs())

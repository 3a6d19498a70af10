"""Tests of early stopping: settled lanes end early with the labels and values of lanes stepped to the end."""

import json
from functools import cache

import numpy as np
import pytest

import vibrojax as vj
from vibrojax.lanes.settled import settled
from vibrojax.measures.repeats import Seen
from vibrojax.measures.section import Passed, Settling

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
        "delta": rng.uniform(-0.005, 0.01, LANES),
    }
    points = {name: column.tolist() for name, column in columns.items()} | {"start": ["stuck", "drive"] * (LANES // 2)}
    run = {"settle": 24.0, "observe": 8.0, "error": ERROR} | dict(run)
    sweep = {"scene": scene, "points": points, "parameters": parameters}
    return tuple(vj.run_sweep(sweep | {"run": run | {"end_early": early}}, progress=False) for early in (True, False))


@pytest.mark.parametrize(
    "scene, parameters, values",
    [
        ("vibro-impact", {}, IMPACT_VARIABLES),
        pytest.param(
            "drilling",
            {"rock": "sandstone"},
            (*IMPACT_VARIABLES, "rate_of_penetration", "relief", "slip_per_impact"),
            marks=pytest.mark.long,
        ),
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


def test_no_lane_ends_early_if_single_returns_are_kept():
    early, full = early_and_full("vibro-impact", ("keep_returns", 4))
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

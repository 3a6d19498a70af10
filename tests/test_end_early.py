"""Lanes that have settled end before their time, with the labels and values of lanes stepped to their end."""

import json
from functools import cache

import numpy as np
import pytest

import vibrojax as vj
from vibrojax.measures.repeats import Seen
from vibrojax.measures.section import Passed, Settling
from vibrojax.sweep.engine.underway import settled

LANES, ERROR = 128, 1e-4
OF_BLOWS = ("impact_velocity", "impact_velocity_min", "bit_velocity_at_impact", "impact_energy", "mean_impact_force")
OF_THE_DRILL = ("period", "bit_amplitude", "striker_amplitude", "drive_power", "stick_fraction", "settling_time")


def steps_taken(dataset) -> int:
    return json.loads(dataset.attrs["solver"])["steps"]


@cache
def both(scene: str, *run, **parameters) -> tuple:
    """The dataset of some random lanes with `end_early`, and without; `run`: pairs of a setting and its value."""
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
        ("vibro-impact", {}, OF_BLOWS),
        ("rotary", {}, ()),
        ("drilling", {"rock": "sandstone"}, (*OF_BLOWS, "rate_of_penetration", "relief", "slip_per_impact")),
        ("coupled-drilling", {"rock": "sandstone"}, (*OF_BLOWS, "rate_of_penetration", "relief", "slip_per_impact")),
    ],
)
def test_as_if_run_in_full(scene, parameters, values):
    """Labels are the same on every lane, values within the accepted error where it repeats, and steps are spared."""
    early, full = both(scene, **parameters)
    for name in {"regime", "cycles", "impacts", "check_regime"} & set(full):
        repeats = np.ones(LANES, bool) if name == "regime" else (full["cycles"] > 0).values
        np.testing.assert_array_equal(early[name][repeats], full[name][repeats], err_msg=name)
    repeats = (full["cycles"] > 0).values
    assert repeats.sum() > LANES / 4
    for name in (*OF_THE_DRILL, *values):
        np.testing.assert_allclose(early[name][repeats], full[name][repeats], rtol=ERROR, atol=1e-12, err_msg=name)
    assert steps_taken(early) < 0.9 * steps_taken(full)


def test_a_lane_that_has_not_settled_is_what_it_is_without():
    """Lanes that end early leave the others alone, to the last bit."""
    early, full = both("vibro-impact")
    irregular = (full["cycles"] == 0).values
    assert irregular.sum() > 5
    for name in full.data_vars:
        np.testing.assert_array_equal(early[name][irregular], full[name][irregular], err_msg=name)


@pytest.mark.parametrize("run", [[("keep_returns", 4)], [("settle", 0.0), ("observe", 12.0)]])
def test_all_stepped_to_the_end(run):
    """Returns one by one are those of the end; and without time to settle there is none to spare."""
    early, full = both("vibro-impact", *run)
    assert steps_taken(early) == steps_taken(full)
    assert early.drop_attrs().equals(full.drop_attrs())


BACK = np.arange(8.0)


def returns(distances, period=0.5, last=9.9):
    """What would be seen of returns, newest first, of a lane at such relative `distances` from where it settles."""
    states = np.zeros((8, 3, 1))
    states[:, 1, 0] = 0.01 * np.asarray(distances)
    scales = tuple(np.array([x]) for x in (0.02, 0.01, 0.01 * 2 * np.pi / period))
    times = np.where(np.isnan(states[:, 1]), np.nan, last - period * BACK[:, None])
    seen = Seen(armed=None, since=None, ranges=(), states=states, times=times, settled=None, frequency=None)
    return Settling(seen, Passed(waiting=None, state=None, time=None, scales=scales))


@pytest.mark.parametrize(
    "distances, close, ends",
    [
        (1e-8 * 2.0**BACK, 1e-7, True),  # halves its distance with every return
        (1e-8 * 2.0**BACK, 5e-8, True),  # by how its repeats differ it is 1e-8 away, or up to five times that
        (1e-8 * 2.0**BACK, 0.9e-8, False),
        (1e-6 * 2.0**BACK, 1e-7, False),  # will be there, but is not yet
        (1e-10 * np.cos(2.0 * BACK) * 1.6**BACK, 1e-7, True),  # spirals in
        (1e-9 * BACK, 1e-7, True),
        (1e-9 * BACK, 59e-9, False),  # creeps: 1e-9 with each of the sixty returns that are left
        (1e-7 * BACK, 1e-7, False),  # creeps too far
        (1e-8 * 0.5**BACK, 1e-7, False),  # leaves
        (1e-3 * (-1.0) ** BACK, 1e-7, True),  # repeats after two returns
        (np.where(BACK < 6, 1e-9, np.nan) * BACK, 1e-7, False),  # has not returned often enough
        (0.01 * np.array([1, 5, 2, 8, 1, 7, 3, 3]), 1e-7, False),
    ],
)
def test_settled(distances, close, ends):
    """Told by how repeats differ; the distance of a geometric approach is that of its series, or a little more."""
    found, duration = settled(returns(distances), 10.0, 40.0, 8.0, close)
    assert found.tolist() == [ends]
    if ends:
        assert 9 * 0.5 <= duration[0] <= 8.0


def test_settled_needs_time():
    """A lane whose last return is long past is no longer what its returns say; one too slow for labels is left."""
    still = 1e-12 * BACK
    assert settled(returns(still), 10.0, 40.0, 8.0, 1e-7)[0].all()
    assert not settled(returns(still, last=8.0), 10.0, 40.0, 8.0, 1e-7)[0].any()
    assert not settled(returns(still), 10.0, 40.0, 4.0, 1e-7)[0].any()

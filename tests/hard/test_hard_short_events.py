"""Tests of events that begin and end within one long step, against the exact reference; each was missed once."""

import exact
import numpy as np
import pytest
from exact.measures import sections

import vibrojax as vj

STRUCK_AS_IT_STICKS = {"beta": 0.25, "gamma": 0.6, "v": 0.5, "delta": 0.005}
"""From `stuck` the bit sticks from 2.3811 to 2.3881 s, when an impact moves it; the slip before is one long step."""

AT_THE_GAP = {"delta": 0.0}
"""From `drive` x1' falls below -0.05 v and returns to zero within one step, at 0.5365 s."""


def swept_lane(point, start, **run):
    """Return a lane of a sweep over both starts, so that all tests share one program."""
    sweep = {"scene": "vibro-impact", "points": {name: [value] for name, value in point.items()}, "run": run}
    return vj.run_sweep(sweep, progress=False).sel(start=start).isel(point=0)


@pytest.mark.parametrize("settle", [2.37, 2.375, 2.3775])
def test_short_stick_before_impact(settle):
    """While lanes settle, steps end only on switches: the stick lies within a step that ends on the contact."""
    run = {"settle": settle, "observe": 3.0 - settle}
    lane = swept_lane(STRUCK_AS_IT_STICKS, "stuck", **run, error=1e-3)  # the longest possible steps
    motion = exact.run("vibro-impact", **STRUCK_AS_IT_STICKS, start="stuck", **run)
    short = [event for event in motion.events if 2.38 < event.time < 2.39 and event.before.bit != event.after.bit]
    assert [event.after.bit for event in short] == [0, 1]
    expected = exact.measure(motion)
    for name in ("stick_fraction", "period", "bit_amplitude", "drive_power"):
        assert float(lane[name]) == pytest.approx(expected[name], rel=1e-5), name


def test_returns_armed_within_one_step():
    """A return counts if x1' was below -0.05 v since the last one, in the sweep and among a trajectory's events."""
    expected = sections(exact.run("vibro-impact", **AT_THE_GAP, start="drive", settle=0.0, observe=1.2))
    assert len(expected) == 4
    lane = swept_lane(AT_THE_GAP, "drive", settle=0.0, observe=1.2)
    assert float(lane.period) == pytest.approx((expected[-1] - expected[0]) / 3, rel=1e-5)
    motion = vj.simulate("vibro-impact", **AT_THE_GAP, start="drive", duration=1.2, sampling=1e-2, progress=False)
    section = motion.event_kind.flag_meanings.split().index("section")
    times = motion.event_time.values[motion.event_kind.values == section]
    np.testing.assert_allclose(times, expected, rtol=0, atol=1e-5)

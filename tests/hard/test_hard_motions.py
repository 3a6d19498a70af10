"""Tests of hard motions: invariants, events within one step (each was missed once), and requests of too much."""

import re

import exact
import numpy as np
import pytest
from cases import ROCK, USUAL, lanes
from exact.measures import sections
from refusals import refusal
from systems import events_of

import vibrojax as vj


@pytest.mark.parametrize(
    "changes", [{}, {"k0": 1e9, "c0": 1e3}, {"delta": -0.02, "start": "drive"}, {"mu": 10.0}, {"c0": 1e5}]
)
def test_invariants_at_every_instant(changes):
    """Friction brakes. In contact J is no less than k0 (x2 - delta) + c0 x2', and it never pulls. The ledger of energy
    holds: F v = F u + c2 x2'^2 + J x2' + change of energy."""
    point = USUAL | changes
    motion = vj.simulate("vibro-impact", **point, duration=0.5, sampling=5e-6, progress=False)
    m1, k1 = 250.0, 156250.0
    m2, k2 = point["beta"] * m1, point["beta"] * k1 * point["gamma"] ** 2
    x1, v1, x2, v2, F, J = (motion[n].values for n in ("x1", "v1", "x2", "v2", "friction_force", "impact_force"))
    u = v1 + point["v"]
    assert np.all(F * u >= -1e-9 * np.abs(F).max() * point["v"])
    inside = x2 >= point["delta"]
    raw = point["k0"] * (x2 - point["delta"]) + point["c0"] * v2
    assert inside.any() and np.all(J >= 0) and np.all(raw[inside] <= J[inside] + 1e-6 * J.max())
    energy = (m1 * v1**2 + m2 * v2**2 + k1 * x1**2 + k2 * (x1 - x2) ** 2) / 2
    power = F * point["v"] - F * u - point["c2"] * v2**2 - J * v2
    work = np.concatenate([[0.0], np.cumsum((power[1:] + power[:-1]) / 2 * np.diff(motion.time.values))])
    np.testing.assert_allclose(work, energy - energy[0], atol=1e-3 * np.abs(energy).max())


@pytest.mark.parametrize("scene", ["penetration", "coupled-drilling"])
def test_hole_never_fills(scene):
    """x4 is the running maximum of x3 - D/k3 and of 0 (6.3): it never falls and never lags."""
    usual, deepened = {"duration": 0.25, "sampling": 2.5e-4}, 0
    usual |= {} if scene == "penetration" else {"gamma": 0.6, "start": "stuck"}
    for name, changes in lanes(ROCK):
        point = {"zeta": 1.1, "threshold": 61.9e3, "k3": 100.68e6} | changes
        motion = vj.simulate(scene, **usual, **point, progress=False)
        x3, x4 = motion.x3.values, motion.x4.values
        grows = np.diff(x4, prepend=0.0)
        noise = 1e-12 * (np.abs(x3).max() + x4[-1])
        assert np.all(grows >= -noise), (name, changes, grows.min())
        assert np.all(x4 - (x3 - point["threshold"] / point["k3"]) >= -noise), (name, changes)
        deepened += x4[-1] > 0
    assert deepened >= 4


# Events that begin and end within one long step
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
    np.testing.assert_allclose(events_of(motion, "section"), expected, rtol=0, atol=1e-5)


# Trajectories that need too much, with the amount and a remedy
TOO_LONG = r"simulate: duration: \S+ s need about \S+ steps.*; there is room for \S+ steps.*: give a shorter duration"


def test_refused_before_any_work():
    for scene, settings, message in (
        ("vibro-impact", {"duration": 1e12}, TOO_LONG),
        ("rotary", {"duration": 20.0, "step": 1e-12}, TOO_LONG + ", a longer step or a greater error"),
        ("rotary", {"duration": 20.0, "sampling": 1e-12}, r"simulate: sampling: 1e-12 s gives 2e\+13 samples in 20 s"),
        ("rotary", {"duration": 1.0, "sampling": 3.0}, ".* between 1 and 2000000 are needed, so 5e-07 to 1 s"),
        ("vibro-impact", {"k0": 1e300}, "simulate: the point cannot be run: too stiff, .*; give a smaller k0, c0, "),
    ):
        line = refusal(vj.simulate, scene, **settings, progress=False)
        assert re.match(message, line), line

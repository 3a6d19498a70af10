"""Orbits of own systems and their multipliers, against closed forms: impacts, sliding, and a discontinuous field."""

import numpy as np
import pytest
from scipy.optimize import brentq
from systems import BALL, IMPACT_OSCILLATOR, oscillator_grazes, oscillator_orbits

import vibrojax as vj

OSCILLATOR = {"w": 0.9, "stiffness": 1.0, "damping": 0.1, "stop": 1.0}
R = 0.7
GRAZE = oscillator_grazes(**OSCILLATOR)
cos = vj.elementary.cos


def test_orbits_and_multipliers_of_impact_oscillator():
    amplitudes = np.array([1.5, 2.0, 2.5, 2.9]) * GRAZE
    orbits = [oscillator_orbits(a, R, **OSCILLATOR)[-1] for a in amplitudes]
    stable = [abs(orbit.multipliers[0]) < 1 for orbit in orbits]
    points = {"a": amplitudes.tolist(), "x": [], "v": []}
    ds = vj.run_sweep(
        {
            "scene": IMPACT_OSCILLATOR,
            "grid": {"a": points["a"]},
            "starts": [orbits[-1].section.tolist()],
            "run": {"orbits": True},
        },
        progress=False,
    )
    assert any(stable) and ds.regime.attrs["flag_meanings"].split()[2] == "impact-free"
    for k in np.flatnonzero(stable):
        lane = ds.isel(a=int(k), start=0)
        assert lane.impacts == 1 and int(lane.regime) == 3
        assert float(lane.impact_velocity) == pytest.approx(orbits[k].speed, rel=1e-6)
        assert [float(lane.orbit_x), float(lane.orbit_v)] == pytest.approx(orbits[k].section.tolist(), abs=1e-8)
        known = np.sort(np.abs(orbits[k].multipliers))
        assert np.sort(lane.multiplier_abs.values) == pytest.approx(known, rel=1e-6)


def test_orbit_with_rest_in_each_period_has_zero_multipliers():
    """The table throws the ball where a w² cos(w t) = -g. After the first impact, bounces end at rest."""
    w, g, drives = 2 * np.pi, 9.81, np.array([1.1, 1.5, 1.9])
    ds = vj.run_sweep(
        {
            "scene": BALL,
            "grid": {"a": (drives * g / w**2).tolist(), "r": [0.2, 0.4]},
            "starts": [[0.0, 0.0], [1.0, 0.0]],
            "run": {"orbits": True},
        },
        progress=False,
    )
    found_flag = ds.orbit_reason.attrs["flag_meanings"].split().index("found")
    assert np.all(ds.orbit_reason == found_flag)
    lanes = ds.where(ds.impacts > 4)  # with r = 0.4, some drives throw the ball so that it never rests
    assert float(np.isfinite(lanes.impacts).mean()) > 0.7
    assert float(lanes.multiplier_abs.max()) < 1e-9 and np.nanmin(lanes.grazing_margin) > 1e-4
    assert np.ptp(ds.impacts.sel(r=0.2).values, axis=-1).max() == 0  # the same from both starts
    for drive in drives:
        a, leaves = drive * g / w**2, np.arccos(-1 / drive) / w
        height, speed = -a * np.cos(w * leaves), a * w * np.sin(w * leaves)
        above = lambda t: height + speed * t - g * t**2 / 2 + a * np.cos(w * (leaves + t))  # noqa: B023, E731
        flight = brentq(above, 0.02, 1.0, xtol=1e-15)
        meets = a * w * np.sin(w * (leaves + flight)) - (speed - g * flight)
        lane = ds.sel(a=a, r=0.2).impact_velocity_max.values
        assert lane == pytest.approx([meets] * 2, rel=1e-7)


@pytest.mark.long
def test_section_during_sliding_has_multipliers_of_sliding_motion():
    """On the surface v + 1.5 x = 0, x' = -1.5 x + b cos w t, so the multipliers are exp(-1.5 T) and 0."""
    relay = vj.System(
        "forced-relay",
        states={"x": "m", "v": "m s-1"},
        parameters={"b": 0.5, "w": 2.0},
        field=lambda t, y, p, s: {"x": y["v"] + p["b"] * cos(p["w"] * t), "v": -4.0 * s["relay"]},
        period=lambda p: 2 * np.pi / p["w"],
        events=[vj.Switch("relay", lambda t, y, p: y["v"] + 1.5 * y["x"])],
    )
    ds = vj.run_sweep({"scene": relay, "starts": [[0.3, 0.1]], "run": {"orbits": True}}, progress=False)
    assert ds.multiplier_abs.values.ravel() == pytest.approx([np.exp(-1.5 * np.pi), 0.0], abs=1e-8)


@pytest.mark.long
def test_no_motion_grazes_a_clock():
    """Without events, the margin is that of the section, which the forcing crosses at its own rate."""
    lag = vj.System(
        "lag",
        states={"x": "1"},
        parameters={"w": 1.0, "rate": 2.0},
        field=lambda t, y, p: {"x": p["rate"] * (vj.elementary.cos(p["w"] * t) - y["x"])},
        period=lambda p: 2 * np.pi / p["w"],
    )
    run = {"settle": 40.0, "observe": 40.0, "orbits": True}
    ds = vj.run_sweep({"scene": lag, "grid": {"w": [1.0]}, "run": run}, progress=False).squeeze()
    assert ds.stable == 1 and ds.grazing_margin == 1.0

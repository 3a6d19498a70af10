"""Orbits of own systems and their multipliers, against closed forms, and lanes near unstable orbits."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from systems import BALL, IMPACT_OSCILLATOR, mass, names_of, one_state, oscillator_grazes, oscillator_orbits, system

import vibrojax as vj

OSCILLATOR = {"w": 0.9, "stiffness": 1.0, "damping": 0.1, "stop": 1.0}
R = 0.7
GRAZE = oscillator_grazes(**OSCILLATOR)
cos = vj.elementary.cos


def halves(t, y, p, s):
    """The example `piecewise` of COCO: r' = r (1 - r), phi' = 1 on the left; r' = (2 - r) r, phi' = ga + 2 - r."""
    r = vj.elementary.sqrt(y["x"] ** 2 + y["y"] ** 2)
    right, left = (1 + s["side"]) / 2, (1 - s["side"]) / 2
    growth, turn = left * (1 - r) + right * (2 - r), left + right * (p["ga"] + 2 - r)
    return {"x": growth * y["x"] - turn * y["y"], "y": growth * y["y"] + turn * y["x"]}


def test_orbits_and_multipliers_of_impact_oscillator():
    amplitudes = np.array([1.5, 2.0, 2.5, 2.9]) * GRAZE
    orbits = [oscillator_orbits(a, R, **OSCILLATOR)[-1] for a in amplitudes]
    stable = [abs(orbit.multipliers[0]) < 1 for orbit in orbits]
    sweep = {"scene": IMPACT_OSCILLATOR, "grid": {"a": amplitudes.tolist()}, "starts": [orbits[-1].section.tolist()]}
    ds = vj.run_sweep(sweep | {"run": {"orbits": True}}, progress=False)
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
    grid = {"a": (drives * g / w**2).tolist(), "r": [0.2, 0.4]}
    sweep = {"scene": BALL, "grid": grid, "starts": [[0.0, 0.0], [1.0, 0.0]], "run": {"orbits": True}}
    ds = vj.run_sweep(sweep, progress=False)
    found_flag = ds.orbit_reason.attrs["flag_meanings"].split().index("found")
    assert np.all(ds.orbit_reason == found_flag)
    lanes = ds.where(ds.impacts > 4)  # with r = 0.4, some drives throw the ball so that it never rests
    assert float(np.isfinite(lanes.impacts).mean()) > 0.7
    assert float(lanes.multiplier_abs.max()) < 1e-9 and np.nanmin(lanes.grazing_margin) > 1e-4
    assert np.ptp(ds.impacts.sel(r=0.2).values, axis=-1).max() == 0  # the same from both starts
    for drive in drives:
        a, leaves = drive * g / w**2, np.arccos(-1 / drive) / w
        height, speed = -a * np.cos(w * leaves), a * w * np.sin(w * leaves)
        above = lambda t: height + speed * t - g * t**2 / 2 + a * np.cos(w * (leaves + t))  # noqa: B023
        flight = brentq(above, 0.02, 1.0, xtol=1e-15)
        meets = a * w * np.sin(w * (leaves + flight)) - (speed - g * flight)
        lane = ds.sel(a=a, r=0.2).impact_velocity_max.values
        assert lane == pytest.approx([meets] * 2, rel=1e-7)


@pytest.mark.long
def test_section_during_sliding_has_multipliers_of_sliding_motion():
    """On the surface v + 1.5 x = 0, x' = -1.5 x + b cos w t, so the multipliers are exp(-1.5 T) and 0."""
    field = lambda t, y, p, s: {"x": y["v"] + p["b"] * cos(p["w"] * t), "v": -4.0 * s["relay"]}
    surface = vj.Switch("relay", lambda t, y, p: y["v"] + 1.5 * y["x"])
    relay = system("xv", field, surface, parameters={"b": 0.5, "w": 2.0}, period=lambda p: 2 * np.pi / p["w"])
    ds = vj.run_sweep({"scene": relay, "starts": [[0.3, 0.1]], "run": {"orbits": True}}, progress=False)
    assert ds.multiplier_abs.values.ravel() == pytest.approx([np.exp(-1.5 * np.pi), 0.0], abs=1e-8)


@pytest.mark.long
def test_discontinuous_field():
    """Both halves are separable in polar form.

    Left: r -> r e^pi/(1 + r (e^pi - 1)), and the angle is the time. Right: G(r) grows by pi, with
    G = ((ga + be)/be) ln r - (ga/be) ln|be - r|. Its time is that of r' = (be - r) r: ln(r/|be - r|) grows by be t.
    """
    be, ga = 2.0, 1.5
    side = vj.Switch("side", lambda t, y, p: y["x"])
    piecewise = system("xy", halves, side, parameters={"ga": ga}, section="y")
    tables = {"scene": piecewise, "starts": [[1.9, 0.0]], "grid": {"ga": [ga]}, "run": {"orbits": True}}
    ds = vj.run_sweep(tables, progress=False).squeeze()
    left = lambda r: r * np.exp(np.pi) / (1 + r * np.expm1(np.pi))
    G = lambda r: (ga + be) / be * np.log(r) - ga / be * np.log(be - r)

    end = {"b": be * (1 - 1e-15), "xtol": 1e-15, "rtol": 1e-15}
    right = lambda r, angle=np.pi: brentq(lambda out: G(out) - G(r) - angle, r, **end)
    pace = lambda r: (be - r) * r / (ga + be - r)
    entering = brentq(lambda r: right(left(r)) - r, 1.5, 1.99, xtol=1e-15)
    leaving = left(entering)
    slope = np.exp(np.pi) / (1 + entering * np.expm1(np.pi)) ** 2 * pace(entering) / pace(leaving)
    time = np.pi + (np.log(entering / (be - entering)) - np.log(leaving / (be - leaving))) / be
    np.testing.assert_allclose([slope, time], [0.002430511420186, 4.810271605994165], rtol=1e-12)
    assert ds.orbit_reason == 0 and ds.stable == 1
    assert [ds.period.item(), ds.multiplier_abs.item()] == pytest.approx([time, slope], abs=1e-9)
    assert ds.orbit_x.item() == pytest.approx(right(leaving, np.pi / 2), abs=1e-9)  # half-way through the right half


@pytest.mark.long
def test_departures_along_a_tangent_are_not_grazes():
    """Coulomb friction makes the mass stick in each period. The expected multiplier was computed with SciPy."""
    floor = mass(
        lambda t, y, p: 1.5 * vj.elementary.sin(p["w"] * t + 0.3) - y["x"] - 0.1 * y["v"],
        vj.Friction("floor_friction", lambda t, y, p: y["v"], lambda t, y, p: 0.8, law=1.0, acts_on="v"),
        parameters={"w": 0.3},
        period=lambda p: 2 * np.pi / p["w"],
    )
    ds = vj.run_sweep({"scene": floor, "starts": [[0.0, 0.0]], "run": {"orbits": True}}, progress=False)
    assert ds.orbit_reason.attrs["flag_meanings"].split()[ds.orbit_reason.item()] == "found"
    assert ds.multiplier_abs.values.ravel()[0] == pytest.approx(0.10922531, abs=1e-7)


# A lane near an unstable orbit is assigned to it only if the lane is shown to stay on it
DOUBLED = {"gamma": 1.032361, "v": 1.124847, "c2": 62.5, "delta": 0.001271, "k0": 6815244.917454, "c0": 0.0}


def rotor(t, y, p):
    back = 3.0 * (1.0 - y["c"] * y["c"] - y["s"] * y["s"])
    return {"c": back * y["c"] - 6.0 * y["s"], "s": back * y["s"] + 6.0 * y["c"], "y": p["growth"] * y["y"]}


ROTOR = system("csy", rotor, name="rotor", parameters={"growth": 1.0}, section="s")
"""A rotor (c, s) that returns to its circle, with y' = growth y. Only y = 0 never leaves its plane."""


@pytest.fixture(scope="module")
def doubled_lane():
    """Return a lane near an unstable 4-cycle, at least 15 s before it approaches its stable 8-cycle. It runs without
    and with orbits, and with orbits after 120 s."""
    sweep = {"scene": "vibro-impact", "parameters": DOUBLED, "grid": {"beta": [0.189708]}, "starts": ["stuck"]}
    runs = ({"settle": 60.0}, {"settle": 60.0, "orbits": True}, {"settle": 120.0, "orbits": True})
    return [vj.run_sweep(sweep | {"run": run, "unusual": True}, progress=False).squeeze() for run in runs]


def test_unstable_orbit_near_lane_is_another_orbit(doubled_lane):
    own, early, late = doubled_lane
    assert names_of(early, "orbit_reason") == ["another-orbit"] and early.stable == -1
    assert np.isnan(early.multiplier_abs).all() and np.isnan(early.orbit_x1) and early.orbit_cycles == 0
    for name in ("period", "impact_velocity", "impact_phase", "stick_fraction"):
        assert early[name] == own[name]
    assert names_of(late, "orbit_reason") == ["found"] and late.stable == 1 and late.orbit_cycles == 8
    assert abs(own.impact_velocity / late.impact_velocity - 1) > 5e-5  # so far from where it settles: there is no bound
    assert np.isinf(early.error_estimate) and np.isinf(early.drift_estimate)


@pytest.mark.parametrize(("growth", "reason"), [(1.0, "found"), (0.1, "another-orbit")])
def test_orbit_is_found_only_if_lane_would_have_left(growth, reason):
    sweep = {"scene": ROTOR, "starts": [[1.0, 0.0, 0.0]], "grid": {"growth": [growth]}, "unusual": True}
    lane = vj.run_sweep(sweep | {"run": {"orbits": True}}, progress=False).squeeze()
    assert lane.cycles == 1 and names_of(lane, "orbit_reason") == [reason]
    if reason == "found":
        assert lane.stable == 0 and lane.error_estimate < 1e-4
        np.testing.assert_allclose(lane.multiplier_abs[0], np.exp(growth * lane.period), rtol=1e-9)
    else:
        assert np.isinf(lane.error_estimate)


def test_changes_move_faster_than_the_motion():
    """Series of the motion do not show how two equal masses, which move side by side, would swing against each other.
    In the other system y = 0, and its series do not show the swing on the spring of stiffness 1 + k x²."""
    w, damping, k = 1.3, 0.2, 1e5  # 5,051 steps per period
    period = 2 * np.pi / w
    push = lambda t: cos(w * t)
    masses = {
        "x": lambda t, y: y["u"],
        "u": lambda t, y: push(t) - damping * y["u"] - y["x"] - k * (y["x"] - y["y"]),
        "y": lambda t, y: y["v"],
        "v": lambda t, y: push(t) - damping * y["v"] - y["y"] - k * (y["y"] - y["x"]),
    }
    hidden = masses | {
        "u": lambda t, y: push(t) - damping * y["u"] - y["x"],
        "v": lambda t, y: -damping * y["v"] - (1 + k * y["x"] ** 2) * y["y"],
    }
    forced = 1 / complex(1 - w**2, damping * w)
    spring = lambda t, z: [z[1], -damping * z[1] - (1 + k * (forced * np.exp(1j * w * t)).real ** 2) * z[0]]
    monodromy = [solve_ivp(spring, (0, period), e, method="DOP853", rtol=1e-12, atol=1e-14).y[:, -1] for e in np.eye(2)]
    plain = np.full(4, np.exp(-damping * period / 2))
    expected = [plain, np.sort([*np.abs(np.linalg.eigvals(monodromy)), *plain[:2]])[::-1]]
    for field, moduli in zip((masses, hidden), expected, strict=True):
        rates = lambda t, y, p, field=field: {name: rate(t, y) for name, rate in field.items()}
        changes = system("xuyv", rates, period=period)
        sweep = {"scene": changes, "starts": [[0.1, 0, 0.1 * (field is masses), 0]], "run": {"orbits": True}}
        ds = vj.run_sweep(sweep, progress=False)
        np.testing.assert_allclose(ds.multiplier_abs.values.ravel(), moduli, rtol=1e-6)


def test_two_masses_that_meet_their_stops_at_one_instant():
    """Masses of the impact oscillator side by side. Without coupling they have its multipliers twice. A spring
    between them turns the phases of two of the multipliers. With a damper, the map has another derivative for each
    order of the impacts, hence none."""
    [orbit] = oscillator_orbits(1.0, R, 1.1, 1.0, 0.1, 0.5)
    push = lambda t, p, x, v, y, u: cos(1.1 * t) - 0.1 * v - x - 0.3 * (x - y) - p["g"] * (v - u)
    rates = lambda t, p, x, u, y, v: {"x": u, "u": push(t, p, x, u, y, v), "y": v, "v": push(t, p, y, v, x, u)}
    field = lambda t, y, p: rates(t, p, *(y[name] for name in "xuyv"))
    stops = [vj.Impact(f"at_{x}", lambda t, y, p, x=x: 0.5 - y[x], velocity=v, restitution=R) for x, v in ("xu", "yv")]
    twins = system("xuyv", field, *stops, parameters={"g": 0.0}, period=2 * np.pi / 1.1)
    sweep = {"scene": twins, "grid": {"g": [0.0, 0.5]}, "starts": [[0.0] * 4], "run": {"orbits": True}}
    ds = vj.run_sweep(sweep, progress=False)
    assert names_of(ds, "orbit_reason") == ["found", "near-grazing"]
    ds = ds.isel(g=0)
    moduli = ds.multiplier_abs.values.ravel()
    assert ds.impact_velocity.item() == pytest.approx(orbit.speed, rel=1e-8)
    assert np.prod(moduli) == pytest.approx(np.prod(np.abs(orbit.multipliers)) ** 2, rel=1e-6)
    assert all(np.abs(moduli - modulus).min() < 1e-6 for modulus in np.abs(orbit.multipliers))


@pytest.mark.long
def test_no_motion_grazes_a_clock():
    """Without events, the margin is that of the section, which the forcing crosses at its own rate."""
    rate, period = lambda t, y, p: p["rate"] * (cos(p["w"] * t) - y["x"]), lambda p: 2 * np.pi / p["w"]
    lag = one_state(rate, parameters={"w": 1.0, "rate": 2.0}, period=period)
    run = {"settle": 40.0, "observe": 40.0, "orbits": True}
    ds = vj.run_sweep({"scene": lag, "grid": {"w": [1.0]}, "run": run}, progress=False).squeeze()
    assert ds.stable == 1 and ds.grazing_margin == 1.0

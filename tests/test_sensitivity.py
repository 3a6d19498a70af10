"""Test derivatives at periodic orbits against central differences of other converged orbits and closed forms."""

import numpy as np
import pytest
from systems import IMPACT_OSCILLATOR, oscillator_orbits

import vibrojax as vj
from vibrojax.periodic.derivatives import DERIVATIVE_REASONS, orbit_variables
from vibrojax.periodic.orbits import Orbits
from vibrojax.periodic.return_map import Segments

BY = ("beta", "gamma")  # as `as_jax` below
STEP = 1e-6
MOTIONS = {  # by name: beta, gamma, v, delta, start, cycles
    "single impact": (0.4, 0.75, 1.5, 0.005, "stuck", 1),
    "no impact": (0.4, 0.75, 1.5, 0.5, "stuck", 1),
    "two returns": (0.6, 0.3, 1.5, -0.005, "drive", 2),
    "irregular": (0.601, 0.818, 1.5, 0.005, "stuck", 0),
}


@pytest.fixture(scope="module")
def map_of_motions():
    """Return the sweep and sensitivities of the motions and of copies with a parameter changed: (change, motion)."""
    moves = [np.array([0.0, 0.0, 0.0, 0.0])]
    moves += [sign * STEP * (np.arange(4) == place) for place in range(len(BY)) for sign in (1, -1)]
    rows = [np.array(motion[:4]) * (1 + move) for move in moves for motion in MOTIONS.values()]
    points = dict(zip(("beta", "gamma", "v", "delta"), np.transpose(rows).tolist(), strict=True))
    points["start"] = [motion[4] for _ in moves for motion in MOTIONS.values()]
    sweep = {"scene": "vibro-impact", "points": points, "run": {"orbits": True}, "unusual": True}
    ds = vj.run_sweep(sweep, progress=False)
    return ds, vj.sensitivity(ds, by=BY, progress=False)


def test_derivatives_agree_with_central_differences_of_lanes(map_of_motions):
    _, s = map_of_motions
    count = len(MOTIONS)
    names = [str(name) for name in s.data_vars if f"d_{name}" in s]
    usual = {"period", "impact_power", "peak_impact_force", "impact_phase", "multiplier_abs", "grazing_margin"}
    assert usual <= {*names}
    for place, name in enumerate(BY):
        up, down = (s.isel(point=slice((2 * place + k) * count, (2 * place + k + 1) * count)) for k in (1, 2))
        for variable in names:
            values = s["parameter_value"].isel(point=slice(0, count)).sel(parameter=name).values
            values = values.reshape(-1, *[1] * (s[variable].ndim - 1))
            slope = (up[variable].values - down[variable].values) / (2 * STEP * values)
            derivative = s[f"d_{variable}"].isel(point=slice(0, count)).sel(parameter=name).values
            scale = np.abs(derivative) + 0.1 * np.abs(s[variable].values[:count]) / values
            deviation = np.abs(slope - derivative) / np.where(scale > 0, scale, 1)
            assert np.nanmax(deviation) < 1e-6, (variable, name, deviation)


def test_missing_derivatives_have_reason(map_of_motions):
    ds, s = map_of_motions
    count = len(MOTIONS)
    reasons = np.array(DERIVATIVE_REASONS)[s.reason.values[:count]]
    assert dict(zip(MOTIONS, reasons, strict=True)) == {**dict.fromkeys(MOTIONS, "none"), "irregular": "no-orbit"}
    assert ds.orbit_cycles.values[:count].tolist() == [motion[5] for motion in MOTIONS.values()]
    assert ((s.valid == 1) == (s.reason == 0)).all()
    for name in s.data_vars:
        if str(name).startswith("d_"):
            alike = s[name].isnull() == s[str(name).removeprefix("d_")].isnull()
            assert alike.where(s.valid == 1, True).all(), name
            assert s[name].isel(point=3).isnull().all()
    assert s.d_impact_velocity.isel(point=1).isnull().all() and (s.d_impact_power.isel(point=1) == 0).all()


def converged_lane(scene, values, returns=200):
    """Return the parameters of one lane and the state to which the return map converges."""
    p = {name: np.array([parameter.default]) for name, parameter in scene.parameters().items()}
    p |= {name: np.array([x]) for name, x in values.items()}
    driving = scene.driving_part()
    own = {name: p[name] for name in driving.parameters()}
    go, state = Segments(driving), np.array([[-0.05], [-0.05], [0.0]])
    for _ in range(returns):
        state = np.asarray(go(own, state).state)
    return p, state.T[None]


def orbit_at(scene, p, guess):
    return Orbits.find(scene, p, guess).refined()


def test_derivatives_near_grazing_are_marked_invalid():
    """The grazing margin of a striker that turns before the bit is linear in the gap. Its slope predicts the graze."""
    scene, of = vj.SCENES["vibro-impact"](), ("grazing_margin", "period")
    p, guess = converged_lane(scene, {"beta": 0.4, "gamma": 0.75, "delta": 0.034})
    orbit = orbit_at(scene, p, guess)
    far = orbit.derivatives(of, ("delta",))
    assert orbit.impacts == 0 and not far.reason.any()
    margin, slope = far.values[0, 0], far.derivatives[0, 0, 0]
    for close, reason in ((1e-3, "none"), (1e-5, "near-grazing")):
        near = orbit_at(scene, p | {"delta": p["delta"] - (margin - close) / slope}, guess).derivatives(of, ())
        assert near.values[0, 0] == pytest.approx(close, rel=1e-6)
        assert near.reason[0].tolist() == [DERIVATIVE_REASONS.index(reason)] * 2


@pytest.mark.long
def test_derivatives_with_rock_agree_with_central_differences_of_orbits():
    values, by = {"beta": 0.4, "gamma": 0.6, "zeta": 0.5, "threshold": 1e5}, ("beta", "threshold")
    scene = vj.SCENES["drilling"]()
    p, guess = converged_lane(scene, values)
    of = ("rate_of_penetration", "relief", "deepest_gap", "impact_energy", "log_multiplier")
    whole = orbit_at(scene, p, guess)
    orbit = whole.derivatives(of, by)
    assert set(of) <= set(orbit_variables(scene)) and not orbit.reason.any()
    for place, varied in enumerate(by):
        step = STEP * values[varied]
        moved = (orbit_at(scene, p | {varied: p[varied] + h}, whole.states) for h in (step, -step))
        up, down = (orbit.derivatives(of, ()) for orbit in moved)
        slope, scale = (up.values - down.values)[0] / (2 * step), 0.1 * np.abs(orbit.values[0]) / values[varied]
        np.testing.assert_array_less(np.abs(slope - orbit.derivatives[0, :, place]), 1e-6 * scale)


# One point
DRILL = {"beta": 0.4, "gamma": 0.75, "v": 1.5, "delta": 0.005, "start": "stuck"}


def at_point(scene="vibro-impact", **given):
    return vj.sensitivity(scene, progress=False, **given)


def impact_speed(**point):
    return oscillator_orbits(R=point.pop("r"), stiffness=1.0, **point)[-1].speed


def test_own_system_agrees_with_closed_form():
    point, step = {"a": 1.0, "w": 0.9, "damping": 0.1, "stop": 1.0, "r": 0.7}, 1e-6
    s = at_point(IMPACT_OSCILLATOR, of=["impact_velocity", "period"], by=["w", "r"], **point)
    assert s["valid"] == 1 and s.impact_velocity == pytest.approx(impact_speed(**point), rel=1e-8)
    for name in ("w", "r"):
        x = point[name]
        up, down = (impact_speed(**point | {name: x + sign * step}) for sign in (1, -1))
        assert s.d_impact_velocity.sel(parameter=name) == pytest.approx((up - down) / (2 * step), rel=1e-7)
    assert s.d_period.values == pytest.approx([-2 * np.pi / point["w"] ** 2, 0], abs=1e-9)


def test_wrong_points_are_refused():
    for given, message in (
        ({"of": ["peroid"]}, 'of: the scene has no "peroid" to differentiate; did you mean "period"'),
        ({"beta": [0.4, 0.5]}, "beta: .* is not a number"),
    ):
        with pytest.raises(vj.InputError, match=message):
            at_point(**given)


def test_point_without_derivative_has_reason():
    """The first motion is irregular, the other one has no impact."""
    for given, reason in (({"beta": 0.601, "gamma": 0.818}, "no-orbit"), ({"delta": 0.5}, "undefined")):
        s = at_point(of=["impact_velocity"], by=["v"], **DRILL | given)
        assert DERIVATIVE_REASONS[int(s.reason)] == reason and s["valid"] == 0 and s.d_impact_velocity.isnull().all()

"""Tests of orbits of scenes outside the package, against closed forms: a discontinuous field, and rigid impacts."""

import numpy as np
import pytest
from own_scenes import (
    Shaken,
    Switched,
    ball_appears,
    ball_doubles,
    ball_orbit,
    oscillator_doubles,
    oscillator_grazes,
    oscillator_orbits,
    restitution,
)
from scipy.optimize import brentq

import vibrojax as vj

FOUND = 0
ORBITS = {"orbits": True}


def multipliers(ds):
    return ds.multiplier_abs.values * np.exp(1j * ds.multiplier_arg.values)


# A discontinuous field


def test_discontinuous_field():
    """Both halves are separable in polar form.

    Left: r -> r e^pi/(1 + r (e^pi - 1)), and the angle is the time.
    Right: G(r) grows by pi, with G = [((ga + be)/be) ln r - (ga/be) ln|be - r|]/al. The time is that of
    r' = al (be - r) r, whose ln(r/|be - r|) grows by al be t.
    """
    al, be, ga = 1.0, 2.0, 1.5
    ds = vj.run_sweep(
        {"scene": Switched(), "grid": {"ga": [ga]}, "run": ORBITS | {"observe": 60.0}}, progress=False
    ).squeeze("ga")

    def left(r):
        return r * np.exp(np.pi) / (1 + r * np.expm1(np.pi))

    def G(r):
        return ((ga + be) / be * np.log(r) - ga / be * np.log(be - r)) / al

    def right(r, angle=np.pi):
        return brentq(lambda out: G(out) - G(r) - angle, r, be * (1 - 1e-15), xtol=1e-15, rtol=1e-15)

    def pace(r):
        return al * (be - r) * r / (ga + be - r)

    entering = brentq(lambda r: right(left(r)) - r, 1.5, 1.99, xtol=1e-15)
    leaving = left(entering)
    np.testing.assert_allclose([entering, leaving], [1.934147003189647, 1.021316191287060], rtol=1e-14)
    slope = np.exp(np.pi) / (1 + entering * np.expm1(np.pi)) ** 2 * pace(entering) / pace(leaving)
    time = np.pi + (np.log(entering / (be - entering)) - np.log(leaving / (be - leaving))) / (al * be)
    np.testing.assert_allclose([slope, time], [0.002430511420186, 4.810271605994165], rtol=1e-12)

    assert ds.orbit_reason == FOUND and ds.stable == 1
    np.testing.assert_allclose(ds.period, time, rtol=0, atol=1e-10)
    np.testing.assert_allclose(multipliers(ds), [slope], rtol=0, atol=1e-10)
    # The orbit crosses the section half-way through the right half.
    np.testing.assert_allclose(ds.orbit_x, right(leaving, np.pi / 2), rtol=0, atol=1e-10)


# Rigid impacts, as the limit of a stiff contact

XI = 0.1
R = restitution(XI)
STIFF = [1e6, 4e6, 16e6]
"""Stiffness per mass [1/s²] in steps of a factor 4, which halves an error proportional to its inverse root."""


def limit(values):
    """Return the limit of the values at three k0 in steps of a factor 4, with errors as k0^(-1/2) and 1/k0."""
    first, second = 2 * values[1] - values[0], 2 * values[2] - values[1]
    return (4 * second - first) / 3


def halves(values, exact):
    """Return whether the distance from `exact` halves with each value, as the inverse root of the stiffness."""
    errors = np.abs(np.asarray(values) - exact)
    return np.allclose(errors[:-1] / errors[1:], 2, atol=0.1)


def shaken_orbits(start, run, **values):
    """Return the orbits of a shaken mass that starts at the section, by stiffness."""
    columns = {name: [value] * len(STIFF) for name, value in values.items()} | {"k0": STIFF, "xi": [XI] * len(STIFF)}
    sweep = {"scene": Shaken(), "points": columns, "starts": [np.asarray(start).tolist()], "unusual": True}
    ds = vj.run_sweep(sweep | {"run": ORBITS | run}, progress=False).squeeze("start")
    assert (ds.orbit_reason == FOUND).all()
    assert (ds.cycles == 1).all() and (ds.impacts == 1).all()
    return ds


def assert_converges_to(ds, rigid, tolerance):
    values = multipliers(ds)
    for computed, exact in (
        (ds.impact_phase.values, rigid.phase),
        (ds.impact_velocity.values, rigid.speed),
        (values.sum(axis=1).real, rigid.multipliers.sum().real),
        (np.abs(values).prod(axis=1), np.abs(rigid.multipliers).prod()),
    ):
        assert halves(computed, exact)
        assert abs(limit(computed) - exact) < tolerance


def test_rigid_orbits_bifurcate_at_closed_forms():
    """The closed forms of parameters and of multipliers agree: 1 at the fold, -1 at the doublings."""
    w, gravity = 2 * np.pi, 9.81
    fold, doubling = (ball_orbit(ratio * (1 + 1e-12), R, w, gravity) for ratio in (ball_appears(R), ball_doubles(R)))
    np.testing.assert_allclose(sorted(fold.multipliers.real), [R**2, 1], atol=1e-5)
    np.testing.assert_allclose(sorted(doubling.multipliers.real), [-1, -(R**2)], atol=1e-9)
    values = {"w": 0.9, "stiffness": 1.0, "damping": 0.1, "stop": 1.0}
    grazing = oscillator_grazes(**values)
    a = oscillator_doubles((1.5 * grazing, 3 * grazing), R, **values)
    np.testing.assert_allclose(oscillator_orbits(a, R, **values)[-1].multipliers[0], -1, atol=1e-12)


@pytest.mark.parametrize("share", [0.3, 0.95])
def test_bouncing_ball(share):
    """Between fold and period doubling the multipliers are a pair; near the doubling one of them is close to -1."""
    ratio, w, gravity = ball_appears(R) + share * (ball_doubles(R) - ball_appears(R)), 2 * np.pi, 9.81
    rigid = ball_orbit(ratio, R, w, gravity)
    values = {"gravity": gravity, "stiffness": 0.0, "damping": 0.0, "a": ratio * gravity, "w": w, "stop": 0.0}
    ds = shaken_orbits(rigid.section, {"settle": 60.0, "observe": 20.0}, **values)
    np.testing.assert_allclose(ds.period, 1.0, rtol=1e-13)
    assert_converges_to(ds, rigid, 1e-5)


@pytest.mark.parametrize("times", [2.9, 5.0])
def test_impact_oscillator(times):
    w, stiffness, damping, stop = 0.9, 1.0, 0.1, 1.0
    a = times * oscillator_grazes(w, stiffness, damping, stop)
    *_, rigid = oscillator_orbits(a, R, w, stiffness, damping, stop)
    values = {"gravity": 0.0, "stiffness": stiffness, "damping": damping, "a": a, "w": w, "stop": stop}
    ds = shaken_orbits(rigid.section, {"settle": 150.0, "observe": 100.0}, **values)
    assert_converges_to(ds, rigid, 1e-5)


def test_no_contact_just_below_grazing():
    """The mass grazes at the amplitude of the forced motion. The stop, soft or rigid, plays no part."""
    w, stiffness, damping, stop = 0.9, 1.0, 0.1, 1.0
    a = oscillator_grazes(w, stiffness, damping, stop)
    points = {"a": [a * (1 - 1e-6), a * (1 + 1e-6)], "w": [w] * 2, "stop": [stop] * 2, "k0": [1.0] * 2}
    points |= {"stiffness": [stiffness] * 2, "damping": [damping] * 2}
    sweep = {"scene": Shaken(), "points": points, "run": ORBITS | {"settle": 600.0, "observe": 100.0}}
    ds = vj.run_sweep(sweep, progress=False).squeeze("start")
    assert ds.impacts.values.tolist() == [0, 1]
    assert ds.amplitude.attrs["units"] == "m" and "amplitude" in vj.list_variables(Shaken()).index
    # Below the stop the map is that of the linear flow: |multiplier| = exp(-damping/2 T).
    np.testing.assert_allclose(ds.multiplier_abs[0], np.exp(-damping / 2 * 2 * np.pi / w), rtol=1e-9)


# Families of these orbits


def special_values(family, kind, count):
    """Return the parameter values at the special points of a kind, in the order of the families."""
    flag = family.special_kind.attrs["flag_meanings"].split().index(kind)
    mask = (family.special_kind == flag).values
    assert family.special_family.values[mask].tolist() == list(range(count))
    return family.special_value.values[mask]


def test_ball_appears_and_doubles_as_on_a_rigid_table():
    w, gravity = 2 * np.pi, 9.81
    rigid = ball_orbit(1.5 * ball_appears(R), R, w, gravity)
    family = vj.follow(
        Shaken(),
        along="a",
        at=1.5 * ball_appears(R) * gravity,
        span=(0.9 * ball_appears(R) * gravity, 1.05 * ball_doubles(R) * gravity),
        start=rigid.section.tolist(),
        k0=STIFF,
        settle=60.0,
        progress=False,
        **{"gravity": gravity, "stiffness": 0.0, "damping": 0.0, "w": w, "stop": 0.0, "xi": XI},
    )
    for kind, exact in (("fold", ball_appears(R)), ("period-doubling", ball_doubles(R))):
        values = special_values(family, kind, 3) / gravity
        assert halves(values, exact)
        assert abs(limit(values) - exact) < 1e-6


def test_oscillator_grazes_and_doubles_as_with_a_rigid_stop():
    values = {"w": 9.0, "stiffness": 100.0, "damping": 1.0, "stop": 1.0}
    grazes = oscillator_grazes(**values)
    doubles = oscillator_doubles((1.5 * grazes, 3 * grazes), R, **values)
    section = oscillator_orbits(3 * grazes, R, **values)[-1].section.tolist()
    settings = {"along": "a", "at": 3 * grazes, "start": section, "settle": 20.0, "progress": False}
    stiff = [100 * k0 for k0 in STIFF]
    family = vj.follow(Shaken(), span=(2 * grazes, 3.2 * grazes), k0=stiff, gravity=0.0, xi=XI, **settings, **values)
    doublings = special_values(family, "period-doubling", 3)
    assert halves(doublings, doubles)
    assert abs(limit(doublings) / doubles - 1) < 1e-6
    # A soft stop is touched at the same amplitude. With a stiff stop the map behaves like a square root there.
    soft = vj.follow(
        Shaken(), span=(0.5 * grazes, 3.2 * grazes), k0=[stiff[0]], gravity=0.0, xi=XI, **settings, **values
    )
    np.testing.assert_allclose(special_values(soft, "grazing", 1), grazes, rtol=1e-8)

"""Orbits of scenes written outside the package, against closed forms: a flow that switches, and rigid impacts."""

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


def multipliers(found):
    return found.multiplier_abs.values * np.exp(1j * found.multiplier_arg.values)


# A flow that switches


def test_a_field_that_jumps():
    """Both halves are separable in polar form: left r -> r e^pi/(1 + r (e^pi - 1)); right G(r) grows by pi, with
    G = [((ga + be)/be) ln r - (ga/be) ln|be - r|]/al. The left's angle is time; the right's time is that of
    r' = al (be - r) r, whose ln(r/|be - r|) grows by al be t."""
    al, be, ga = 1.0, 2.0, 1.5
    found = vj.run_sweep(
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

    assert found.orbit_reason == FOUND and found.stable == 1
    np.testing.assert_allclose(found.period, time, rtol=0, atol=1e-10)
    np.testing.assert_allclose(multipliers(found), [slope], rtol=0, atol=1e-10)
    # Half-way through the right half it passes the section.
    np.testing.assert_allclose(found.orbit_x, right(leaving, np.pi / 2), rtol=0, atol=1e-10)


# Rigid impacts, as the contact gets stiffer

XI = 0.1
R = restitution(XI)
STIFF = [1e6, 4e6, 16e6]
"""In steps of 4, by which an error of the inverse root halves; per mass [1/s²]."""


def limit(values):
    """Where values that approach as k0^(-1/2) and 1/k0 end, from three in steps of 4."""
    one, two = 2 * values[1] - values[0], 2 * values[2] - values[1]
    return (4 * two - one) / 3


def halves(values, exact):
    """Whether the distance from `exact` halves from each to the next: by the inverse root of the stiffness."""
    off = np.abs(np.asarray(values) - exact)
    return np.allclose(off[:-1] / off[1:], 2, atol=0.1)


def shaken(start, run, **values):
    """The orbits of a shaken mass that starts at the section, over stiffness."""
    columns = {name: [value] * len(STIFF) for name, value in values.items()} | {"k0": STIFF, "xi": [XI] * len(STIFF)}
    sweep = {"scene": Shaken(), "points": columns, "starts": [np.asarray(start).tolist()], "unusual": True}
    found = vj.run_sweep(sweep | {"run": ORBITS | run}, progress=False).squeeze("start")
    assert (found.orbit_reason == FOUND).all()
    assert (found.cycles == 1).all() and (found.impacts == 1).all()
    return found


def assert_ends_at(found, rigid, within):
    values = multipliers(found)
    for one, exact in (
        (found.impact_phase.values, rigid.phase),
        (found.impact_velocity.values, rigid.speed),
        (values.sum(axis=1).real, rigid.multipliers.sum().real),
        (np.abs(values).prod(axis=1), np.abs(rigid.multipliers).prod()),
    ):
        assert halves(one, exact)
        assert abs(limit(one) - exact) < within


def test_the_rigid_orbits_bifurcate_where_they_should():
    """The closed forms of parameters and of multipliers agree: 1 at the fold, -1 at the doublings."""
    w, gravity = 2 * np.pi, 9.81
    fold, doubling = (ball_orbit(one * (1 + 1e-12), R, w, gravity) for one in (ball_appears(R), ball_doubles(R)))
    np.testing.assert_allclose(sorted(fold.multipliers.real), [R**2, 1], atol=1e-5)
    np.testing.assert_allclose(sorted(doubling.multipliers.real), [-1, -(R**2)], atol=1e-9)
    values = {"w": 0.9, "stiffness": 1.0, "damping": 0.1, "stop": 1.0}
    grazing = oscillator_grazes(**values)
    a = oscillator_doubles((1.5 * grazing, 3 * grazing), R, **values)
    np.testing.assert_allclose(oscillator_orbits(a, R, **values)[-1].multipliers[0], -1, atol=1e-12)


@pytest.mark.parametrize("share", [0.3, 0.95])
def test_the_bouncing_ball(share):
    """Between its fold and its period doubling: of a pair, and near the doubling of one multiplier close to -1."""
    ratio, w, gravity = ball_appears(R) + share * (ball_doubles(R) - ball_appears(R)), 2 * np.pi, 9.81
    rigid = ball_orbit(ratio, R, w, gravity)
    values = {"gravity": gravity, "stiffness": 0.0, "damping": 0.0, "a": ratio * gravity, "w": w, "stop": 0.0}
    found = shaken(rigid.section, {"settle": 60.0, "observe": 20.0}, **values)
    np.testing.assert_allclose(found.period, 1.0, rtol=1e-13)
    assert_ends_at(found, rigid, 1e-5)


@pytest.mark.parametrize("times", [2.9, 5.0])
def test_the_impact_oscillator(times):
    w, stiffness, damping, stop = 0.9, 1.0, 0.1, 1.0
    a = times * oscillator_grazes(w, stiffness, damping, stop)
    *_, rigid = oscillator_orbits(a, R, w, stiffness, damping, stop)
    values = {"gravity": 0.0, "stiffness": stiffness, "damping": damping, "a": a, "w": w, "stop": stop}
    found = shaken(rigid.section, {"settle": 150.0, "observe": 100.0}, **values)
    assert_ends_at(found, rigid, 1e-5)


def test_just_under_the_graze_it_does_not_touch():
    """The amplitude at which it grazes is that of the forced motion, and the stop, soft or rigid, plays no part."""
    w, stiffness, damping, stop = 0.9, 1.0, 0.1, 1.0
    a = oscillator_grazes(w, stiffness, damping, stop)
    points = {"a": [a * (1 - 1e-6), a * (1 + 1e-6)], "w": [w] * 2, "stop": [stop] * 2, "k0": [1.0] * 2}
    points |= {"stiffness": [stiffness] * 2, "damping": [damping] * 2}
    sweep = {"scene": Shaken(), "points": points, "run": ORBITS | {"settle": 600.0, "observe": 100.0}}
    found = vj.run_sweep(sweep, progress=False).squeeze("start")
    assert found.impacts.values.tolist() == [0, 1]
    assert found.amplitude.attrs["units"] == "m" and "amplitude" in vj.list_variables(Shaken()).index
    # Short of the stop the map is that of the linear flow: |multiplier| = exp(-damping/2 T).
    np.testing.assert_allclose(found.multiplier_abs[0], np.exp(-damping / 2 * 2 * np.pi / w), rtol=1e-9)


# Families of them


def special(family, kind, count):
    """Values of the parameter at the special points of a kind, in the order of the families."""
    flag = family.special_kind.attrs["flag_meanings"].split().index(kind)
    here = (family.special_kind == flag).values
    assert family.special_family.values[here].tolist() == list(range(count))
    return family.special_value.values[here]


def test_the_ball_appears_and_doubles_where_it_does_on_a_rigid_table():
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
        values = special(family, kind, 3) / gravity
        assert halves(values, exact)
        assert abs(limit(values) - exact) < 1e-6


def test_the_oscillator_grazes_and_doubles_where_it_does_with_a_rigid_stop():
    values = {"w": 9.0, "stiffness": 100.0, "damping": 1.0, "stop": 1.0}
    grazes = oscillator_grazes(**values)
    doubles = oscillator_doubles((1.5 * grazes, 3 * grazes), R, **values)
    begins = oscillator_orbits(3 * grazes, R, **values)[-1].section.tolist()
    about = {"along": "a", "at": 3 * grazes, "start": begins, "settle": 20.0, "progress": False}
    stiff = [100 * one for one in STIFF]
    family = vj.follow(Shaken(), span=(2 * grazes, 3.2 * grazes), k0=stiff, gravity=0.0, xi=XI, **about, **values)
    found = special(family, "period-doubling", 3)
    assert halves(found, doubles)
    assert abs(limit(found) / doubles - 1) < 1e-6
    # However soft the stop is, it is touched at the same amplitude; towards a stiff one the map has a root there.
    soft = vj.follow(Shaken(), span=(0.5 * grazes, 3.2 * grazes), k0=[stiff[0]], gravity=0.0, xi=XI, **about, **values)
    np.testing.assert_allclose(special(soft, "grazing", 1), grazes, rtol=1e-8)

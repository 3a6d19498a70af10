"""Tests of families of shaken masses at a stop, against closed forms of the rigid stop as the stop gets stiffer."""

import numpy as np
import pytest
from own_scenes import (
    RigidlyStopped,
    Shaken,
    ball_appears,
    ball_doubles,
    ball_orbit,
    oscillator_doubles,
    oscillator_grazes,
    oscillator_orbits,
    restitution,
)
from test_follow import specials
from test_orbits_elsewhere import halves, limit

import vibrojax as vj

XI = 0.1
R = restitution(XI)
STIFF = [1e6, 4e6, 16e6]
OSCILLATOR = {"w": 0.9, "stiffness": 1.0, "damping": 0.1, "stop": 1.0}
BALL = {"gravity": 9.81, "stiffness": 0.0, "damping": 0.0, "w": 2 * np.pi, "stop": 0.0}


def families(start, at, span, settle, **values):
    """Return a family over the amplitude of the force for each stiffness."""
    start = np.asarray(start).tolist()
    settings = {"xi": XI, "k0": STIFF, "progress": False, "settle": settle, "observe": 100.0}
    return vj.follow(Shaken(), along="a", at=at, span=span, start=start, **values, **settings)


def specials_by_stiffness(family, kind, branch=0):
    """Return the special points of a kind for each stiffness."""
    return [specials(family.isel(special=family.special_family.values == n), kind, branch) for n in range(len(STIFF))]


@pytest.mark.long
def test_bouncing_ball_appears_and_doubles():
    gravity, low, high = BALL["gravity"], ball_appears(R), ball_doubles(R)
    middle = (low + high) / 2
    begin = ball_orbit(middle, R, BALL["w"], gravity).section
    span = (0.9 * low * gravity, 1.05 * high * gravity)
    family = families(begin, middle * gravity, span, 60.0, **BALL)
    for kind, exact in (("fold", low), ("period-doubling", high)):
        values = [
            points[np.abs(points / gravity - exact).argmin()] / gravity
            for points in specials_by_stiffness(family, kind)
        ]
        assert halves(values, exact)
        assert abs(limit(values) - exact) < 1e-5
    # Beyond the fold the family returns as the orbit at the lower phase, which is unstable.
    branch = family.isel(point=(family.point_family.values == 2) & (family.branch.values == 0))
    assert {0, 1} <= set(branch.stable.values.tolist())
    assert (branch.a.values > specials(family.isel(special=family.special_family.values == 2), "fold")[0] - 1e-9).all()
    # The doubled branch begins there, with two impacts in two periods.
    double = family.isel(point=(family.point_family.values == 2) & (family.branch.values == 1))
    assert (double.cycles == 2).all() and double.impacts[0] == 2 and double.stable[1] == 1


def test_impact_oscillator_doubles():
    graze = oscillator_grazes(**OSCILLATOR)
    exact = oscillator_doubles((1.5 * graze, 3 * graze), R, **OSCILLATOR)
    begin = oscillator_orbits(2.9 * graze, R, **OSCILLATOR)[-1].section
    family = families(begin, 2.9 * graze, (0.95 * exact, 3 * graze), 150.0, gravity=0.0, **OSCILLATOR)
    values = [points[np.abs(points - exact).argmin()] for points in specials_by_stiffness(family, "period-doubling")]
    assert halves(values, exact)
    assert abs(limit(values) - exact) < 1e-5


@pytest.mark.parametrize("k0", [1.0, 1e4, 1e8])
def test_impact_oscillator_grazes_where_forced_motion_touches(k0):
    """The family without impact reaches the graze, which is the same for any stiffness, and continues with impacts."""
    graze = oscillator_grazes(**OSCILLATOR)
    settings = {"xi": XI, "k0": k0, "gravity": 0.0, "progress": False, "settle": 300.0, "observe": 100.0, "cycles": 1}
    family = vj.follow(Shaken(), along="a", at=0.9 * graze, span=(0.8 * graze, 1.2 * graze), **OSCILLATOR, **settings)
    grazes = specials(family, "grazing")
    assert np.abs(grazes - graze).min() < 1e-8
    below = family.a.values < graze - 1e-7
    assert (family.impacts.values[below & (np.arange(len(below)) < below.argmin())] == 0).all()
    assert family.impacts.values.max() >= 1


def test_graze_is_found_if_only_impact_free_orbits_are_near_it():
    """The stop is so stiff that the multiplier grows from 30 to over 1e3 within a step before the graze."""
    stiff = {"w": 9.0, "stiffness": 100.0, "damping": 1.0, "stop": 1.0}
    settings = {"xi": XI, "k0": 4e8, "gravity": 0.0, "progress": False, "settle": 20.0, "observe": 30.0, "cycles": 1}
    family = vj.follow(Shaken(), along="a", at=63.0, span=(10.5, 67.3), **stiff, **settings)
    [graze] = specials(family, "grazing")
    assert abs(graze - oscillator_grazes(**stiff)) < 1e-8


def test_rigid_graze_without_mode_is_grazing():
    """Only the margin shows that the family without impact touches the stop, where it ends."""
    graze = oscillator_grazes(**OSCILLATOR)
    settings = {"progress": False, "settle": 300.0, "observe": 100.0, "cycles": 1}
    family = vj.follow(
        RigidlyStopped(), along="a", at=0.9 * graze, span=(0.8 * graze, 1.2 * graze), **OSCILLATOR, **settings
    )
    assert specials(family, "grazing") == pytest.approx([graze], rel=1e-9)
    assert specials(family, "end") == pytest.approx([0.8 * graze])
    assert family.special_note.values.tolist() == ["the first value is reached", "the family ends here"]

"""Families whose amplitude shrinks to zero end there; nothing is continued or invented beyond. Compare closed forms."""

import numpy as np
import pytest

import vibrojax as vj

e = vj.elementary


def normal_form(t, y, p):
    growth = p["m"] - 1 - (y["x"] * y["x"] + y["y"] * y["y"])
    return {"x": growth * y["x"] - 1.4 * y["y"], "y": 1.4 * y["x"] + growth * y["y"]}


def brusselator(t, y, p):
    """Return the rates, where the states are relative to the equilibrium (A, B/A)."""
    u, w = p["A"] + y["u"], p["B"] / p["A"] + y["w"]
    return {"u": p["A"] + u * u * w - (p["B"] + 1) * u, "w": p["B"] * u - u * u * w}


def predators(t, y, p):
    fish, sharks = y["fish"], y["sharks"]
    caught = p["quota"] * (1 - e.exp(-5 * fish))
    return {"fish": 3 * fish * (1 - fish) - fish * sharks - caught, "sharks": -sharks + 3 * fish * sharks}


def planar(name, states, parameters, field, section):
    return vj.System(name, states=dict.fromkeys(states, "1"), parameters=parameters, field=field, section=section)


NORMAL_FORM = planar("normal form", ("x", "y"), {"m": 1.25}, normal_form, "y")
BRUSSELATOR = planar("Brusselator", ("u", "w"), {"A": 1.0, "B": 3.0}, brusselator, "u")
PREDATORS = planar("predators", ("fish", "sharks"), {"quota": 0.7}, predators, ("fish", 1 / 3))
START = {"along": "m", "at": 1.25, "span": (0.5, 2.0), "start": [0.4, 0.0], "cycles": 1}


def follow(system, **settings):
    return vj.follow(system, progress=False, **{"cycles": 1} | settings)


def specials(family):
    """Return kind and parameter value of the special points, in the order of the values."""
    names = family.special_kind.attrs["flag_meanings"].split()
    values = family.special_value.values
    return [(names[int(family.special_kind[k])], float(values[k])) for k in np.argsort(values)]


@pytest.mark.long
def test_normal_form_ends_at_zero_amplitude():
    family = follow(NORMAL_FORM, **START)
    (first, place), last = specials(family)
    assert (first, last) == ("hopf", ("end", 2.0)) and place == pytest.approx(1.0, abs=1e-12)
    m = family.m.values
    assert m.min() == place and (m < 1.0 + 1e-5).sum() < 8
    np.testing.assert_allclose(family.orbit_x, np.sqrt(m - 1), atol=1e-7)
    np.testing.assert_allclose(family.multiplier_abs[:, 0], np.exp(-4 * np.pi * (m - 1) / 1.4), rtol=1e-6)


@pytest.mark.long
def test_planar_flows_have_no_invented_points():
    """The Brusselator's Hopf points are at B = 1 + A². Multipliers of planar flows are positive."""
    family = follow(BRUSSELATOR, along="B", at=3.0, span=(1.5, 3.5), start=[0.3, 0.0], A=[0.9, 1.1])
    assert len(specials(family)) == 4
    for number, a in enumerate((0.9, 1.1)):
        (first, place), last = specials(family.isel(special=family.special_family.values == number))
        assert (first, last) == ("hopf", ("end", 3.5)) and place == pytest.approx(1 + a * a, abs=1e-9)
    assert (family.multiplier_arg.values == 0).all() and (
        family.stable.values[family.multiplier_abs[:, 0] < 0.99] == 1
    ).all()


@pytest.mark.long
def test_predators_and_prey_end_at_zero_amplitude_and_at_long_periods():
    family = follow(PREDATORS, along="quota", at=0.7, span=(0.5, 0.8), start=[0.35, 0.3], settle=500.0, observe=200.0)
    (first, place), (last, long) = specials(family)
    far = np.exp(-5 / 3)
    assert (first, last) == ("hopf", "end") and place == pytest.approx(1 / (3 * (1 - far) - 5 * far), abs=1e-9)
    # Orbits approach the saddle at which one of the species is extinct, and their periods grow without limit.
    assert family.period.values[np.abs(family.quota.values - long).argmin()] > 50
    assert all(family.special_note.values)


@pytest.mark.long
def test_hopf_points_of_a_system_without_events_are_continued():
    """The Brusselator's Hopf points are at B = 1 + A²."""
    family = follow(BRUSSELATOR, along="B", at=2.5, span=(1.5, 3.0), start=[0.3, 0.0], A=1.0)
    curves = vj.curves(family, by="A", span=(0.8, 1.2), at={"A": 0.9}, progress=False)
    np.testing.assert_allclose(curves.B, 1 + curves.A**2, atol=1e-9)
    assert curves.A.values.min() == 0.8 and curves.A.values.max() == 1.2
    assert curves.crossing_B.values == pytest.approx([1.81], abs=1e-10)

"""Families whose amplitude shrinks to zero end there; nothing is continued or invented beyond. Compare closed forms."""

import numpy as np
import pytest
from systems import IMPACT_OSCILLATOR

import vibrojax as vj

e = vj.elementary


def van_der_pol(t, y, p):
    return {"x": y["v"], "v": p["mu"] * (1 - y["x"] * y["x"]) * y["v"] - y["x"]}


def brusselator(t, y, p):
    """Return the rates, where the states are relative to the equilibrium (A, B/A)."""
    u, w = p["A"] + y["u"], p["B"] / p["A"] + y["w"]
    return {"u": p["A"] + u * u * w - (p["B"] + 1) * u, "w": p["B"] * u - u * u * w}


def planar(name, states, parameters, field, section):
    return vj.System(name, states=dict.fromkeys(states, "1"), parameters=parameters, field=field, section=section)


VAN_DER_POL = planar("van der Pol", ("x", "v"), {"mu": 0.4}, van_der_pol, "x")
BRUSSELATOR = planar("Brusselator", ("u", "w"), {"A": 1.0, "B": 3.0}, brusselator, "u")


def follow(system, **settings):
    return vj.follow(system, progress=False, **{"cycles": 1} | settings)


def specials(family):
    """Return kind and parameter value of the special points, in the order of the values."""
    names = family.special_kind.attrs["flag_meanings"].split()
    values = family.special_value.values
    return [(names[int(family.special_kind[k])], float(values[k])) for k in np.argsort(values)]


def test_family_passes_centre_of_large_amplitude():
    """Reversed time takes van der Pol's oscillator at mu to that at -mu: periods are equal, multipliers reciprocal.

    At mu = 0, the family crosses that of a centre, whose orbits have every amplitude and the period 2 pi.
    """
    whole = follow(VAN_DER_POL, along="mu", at=0.4, span=(-0.4, 0.4), start=[1.0, 0.0])
    family = whole.isel(point=whole.branch.values == 0, special=whole.special_branch.values == 0)
    assert [kind for kind, _ in specials(family)] == ["end", "branch-point", "end"]
    np.testing.assert_allclose(family.special_value, [-0.4, 0.0, 0.4], atol=1e-9)
    ends = [family.isel(point=int(np.abs(family.mu.values - mu).argmin())) for mu in (-0.4, 0.4)]
    assert float(ends[0].period) == pytest.approx(float(ends[1].period), rel=1e-9)
    assert float(ends[0].multiplier_abs[0] * ends[1].multiplier_abs[0]) == pytest.approx(1.0, abs=1e-7)
    away = np.abs(family.mu.values) > 1e-6
    np.testing.assert_array_equal(family.stable.values[away] == 1, family.mu.values[away] > 0)
    centre = whole.isel(point=whole.branch.values == 1, special=whole.special_branch.values == 1)
    np.testing.assert_allclose(centre.period, 2 * np.pi, rtol=1e-7)
    np.testing.assert_allclose(centre.mu, 0.0, atol=1e-7)
    assert centre.orbit_v.min() < 1e-9 and centre.orbit_v.max() > 4
    assert sorted(kind for kind, _ in specials(centre)) == ["end", "hopf"]


def test_small_forced_motion_goes_on():
    """The amplitude of a forced motion below the stop is proportional to the force, however small."""
    family = follow(IMPACT_OSCILLATOR, along="a", at=0.05, span=(1e-6, 0.06), start=[0.0, 0.0], w=0.9)
    (first, least), (last, _) = specials(family)
    assert (first, last) == ("end", "end") and least == pytest.approx(1e-6)
    ratio = family.orbit_x.values / family.a.values
    np.testing.assert_allclose(ratio, ratio[0], rtol=1e-6)


@pytest.mark.long
def test_hopf_points_of_a_system_without_events_are_continued():
    """The Brusselator's Hopf points are at B = 1 + A²."""
    family = follow(BRUSSELATOR, along="B", at=2.5, span=(1.5, 3.0), start=[0.3, 0.0], A=1.0)
    curves = vj.curves(family, by="A", span=(0.8, 1.2), at={"A": 0.9}, progress=False)
    np.testing.assert_allclose(curves.B, 1 + curves.A**2, atol=1e-9)
    assert curves.A.values.min() == 0.8 and curves.A.values.max() == 1.2
    assert curves.crossing_B.values == pytest.approx([1.81], abs=1e-10)

"""Families whose amplitude shrinks to zero end there; nothing is continued or invented beyond. Compare closed forms."""

import numpy as np
import pytest
from systems import IMPACT_OSCILLATOR

import vibrojax as vj

e = vj.elementary


def van_der_pol(t, y, p):
    return {"x": y["v"], "v": p["mu"] * (1 - y["x"] * y["x"]) * y["v"] - y["x"]}


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
    system = vj.System(
        "van der Pol", states={"x": "1", "v": "1"}, parameters={"mu": 0.4}, field=van_der_pol, section="x"
    )
    whole = follow(system, along="mu", at=0.4, span=(-0.4, 0.4), start=[1.0, 0.0])
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

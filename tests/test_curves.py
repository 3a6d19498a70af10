"""Test curves of special points in two parameters against closed forms of the impact oscillator."""

import json

import numpy as np
import pytest
import xarray as xr
from scipy.optimize import brentq
from systems import IMPACT_OSCILLATOR, SHAKEN, friction_stops, oscillator_doubles, oscillator_grazes, oscillator_orbits
from test_follow import eigenvalue

import vibrojax as vj
from vibrojax.io.kinds import SPECIAL_KINDS

R, W, FOLDING = 0.7, 0.9, 1.25
FIXED = {"stiffness": 1.0, "damping": 0.1, "stop": 1.0}
W_SPAN = (0.7, 1.3)
NATURAL = np.sqrt(1 - 0.05**2)  # natural frequency of the damped oscillator [rad/s]


def fold_amplitude(w):
    """Return the amplitude at which the two orbits with one impact per forcing period meet. The impact speeds V are the
    roots of c0 V² + c1 V + 1 - (a G)², where G is the gain without stop."""
    gain = 1 / abs(complex(1 - w**2, 0.1 * w))
    speeds = [oscillator_orbits(a / gain, R, w, **FIXED)[-1].speed for a in (2.0, 3.0)]
    c0, c1 = np.linalg.solve([[v**2, v] for v in speeds], [3.0, 8.0])
    return float(np.sqrt(1 - c1**2 / (4 * c0)) / gain)


def points_of_kind(ds, kind):
    flag = ds.kind.attrs["flag_meanings"].split().index(kind)
    mask = np.isin(ds.point_curve.values, np.flatnonzero(ds.kind.values == flag))
    assert mask.sum() > 20
    return ds.isel(point=mask)


def family(kind, a, w, section, span=(0.05, 0.65)):
    """Return the dataset of a branch with one special point, as `follow` writes it."""
    points = {"a": a, "branch": 0, "cycles": 1, "stable": 0, "period": 2 * np.pi / w, "grazing_margin": 0.0}
    points |= zip(("orbit_x", "orbit_v"), section, strict=True)
    variables = {name: ("point", [value]) for name, value in points.items()}
    kinds = {"flag_meanings": " ".join(SPECIAL_KINDS), "flag_values": range(len(SPECIAL_KINDS))}
    variables["special_kind"] = ("special", [SPECIAL_KINDS.index(kind)], kinds)
    variables |= {name: ("special", [value]) for name, value in (("special_value", a), ("special_branch", 0))}
    parameters = json.dumps(FIXED | {"w": w, "r": R})
    about = {"kind": "family", "scene": IMPACT_OSCILLATOR.name, "along": "a", "span": span, "parameters": parameters}
    return xr.Dataset(variables, attrs=about)


def test_grazing_follows_closed_form():
    a = oscillator_grazes(W, **FIXED)
    forced = a / complex(1 - W**2, 0.1 * W)
    grazing_branch = family("grazing", a, W, (forced.real, -W * forced.imag), (0.15, 0.25))
    ds = vj.curves(grazing_branch, by="w", span=W_SPAN, at={"w": W}, progress=False)
    curve = points_of_kind(ds, "grazing")
    exact = np.array([oscillator_grazes(float(w), **FIXED) for w in curve.w])
    assert np.abs(curve.a.values - exact).max() < 1e-9
    assert float(ds.crossing_w[0]) == W
    assert abs(float(ds.crossing_a[0]) - oscillator_grazes(W, **FIXED)) < 1e-10
    assert ds.curve_note.values.tolist() == ["the last value of a is reached; the first value of a is reached"]


@pytest.mark.long
def test_doubling_follows_closed_form_up_to_grazing():
    a = oscillator_doubles((0.4, 0.63), R, W, **FIXED)
    doubling_branch = family("period-doubling", a, W, oscillator_orbits(a, R, W, **FIXED)[-1].section)
    ds = vj.curves(doubling_branch, by="w", span=(0.6, 1.3), at={"a": 0.5}, progress=False)
    curve = points_of_kind(ds, "period-doubling")
    for k in range(0, curve.sizes["point"], 9):
        a, w = float(curve.a[k]), float(curve.w[k])
        if abs(a / oscillator_grazes(w, **FIXED) - 1) > 0.05:  # the impact speed vanishes near the graze
            assert abs(oscillator_doubles((0.99 * a, 1.01 * a), R, w, **FIXED) - a) < 1e-8
    doubles = ds.isel(crossing=np.flatnonzero(ds.crossing_curve.values == 0))
    for a, w in zip(doubles.crossing_a.values, doubles.crossing_w.values, strict=True):
        assert a == 0.5 and abs(oscillator_doubles((0.49, 0.51), R, float(w), **FIXED) - 0.5) < 1e-8
    # The impact speed is zero there. The free oscillation then makes one and a half turns, or one.
    corners = ds.codim2_w.values[ds.codim2_kind.values == "grazing-doubling"]
    assert np.sort(corners) == pytest.approx([2 * NATURAL / 3, NATURAL], abs=1e-9)
    # The grazing curve starts from either corner, and is listed once.
    grazing = points_of_kind(ds, "grazing")
    grazing = grazing.isel(point=grazing.cycles.values == 1)
    exact = np.array([oscillator_grazes(float(w), **FIXED) for w in grazing.w])
    assert np.abs(grazing.a.values - exact).max() < 1e-9
    first, *others = ds.special.values
    assert first == 0 and set(others) == {-1} and len(set(grazing.point_curve.values)) == 1
    assert "begins at the point grazing-doubling" in str(ds.curve_note.values[grazing.point_curve.values[0]])
    # The folds of the doubled orbit end at the generalised flip. Orbits of small amplitude are omitted.
    folds = points_of_kind(ds, "fold")
    assert set(folds.cycles.values) == {2}
    there = np.array([folds.w.values, folds.a.values])[:, None]
    flips = np.array([ds.codim2_w.values, ds.codim2_a.values])[:, ds.codim2_kind.values == "generalised flip", None]
    assert np.abs(flips - there).max(axis=0).min() < 1e-3


def test_fold_follows_closed_form():
    options = {"special": [0, 0], "at": {"w": 1.15}, "progress": False}
    ds = vj.curves(family("fold", *fold_point(FOLDING)), by="w", span=(1.05, 1.3), **options)
    assert ds.sizes["curve"] == 1
    curve = points_of_kind(ds, "fold")
    assert max(abs(fold_amplitude(float(w)) - float(a)) for a, w in zip(curve.a[::7], curve.w[::7], strict=True)) < 1e-8
    assert ds.crossing_a.values == pytest.approx([fold_amplitude(1.15)], rel=1e-8)
    assert ds.multiplier_abs.values[:, 0] == pytest.approx(1.0, abs=1e-7)
    assert len(vj.picture(ds).axes) == 1


def fold_point(w):
    """Return amplitude, frequency and section state at which two orbits meet."""
    a = fold_amplitude(w)
    return a, w, oscillator_orbits(a * (1 + 1e-12), R, w, **FIXED)[-1].section


def test_wrong_arguments_are_refused():
    for given, words in (
        ({"by": "a"}, "is the parameter of the family"),
        ({"span": (2.0, 3.0)}, "which is not between 2 and 3"),
        ({"special": 99}, "a whole number from 0"),
        ({"at": {"damping": 0.1}}, "is not a or w with a value"),
    ):
        with pytest.raises(vj.InputError, match=words):
            vj.curves(family("fold", *fold_point(FOLDING)), **{"by": "w", "span": W_SPAN, "progress": False} | given)


def test_hopf_points_follow_linear_stability_of_sliding():
    v, beta = 1.5, 0.4
    low, high = 0.89, 1.0
    gamma = brentq(lambda gamma: eigenvalue(gamma, beta, v).real, low, high, xtol=1e-15)
    force = 250 * 9.81 * 0.4 * (1 - v / 3 + v**3 / 81)
    states = {f"orbit_{name}": -force / 156250 for name in ("x1", "x2")} | {"orbit_v2": 0.0}
    parameters = {name: float(x) for name, x in vj.list_parameters("rotary").default[:9].items()}
    branch = family("hopf", gamma, 1.0, (0.0, 0.0), (low, high)).drop_vars(("a", "orbit_x", "orbit_v"))
    branch = branch.assign({name: ("point", [x]) for name, x in (states | {"gamma": gamma}).items()})
    attributes = {"scene": "rotary", "along": "gamma", "parameters": json.dumps(parameters | {"beta": beta, "v": v})}
    ds = vj.curves(branch.assign_attrs(attributes), by="beta", span=(0.3, 0.5), at={"beta": 0.45}, progress=False)
    rates = [eigenvalue(float(x), float(y), v).real for x, y in zip(ds.gamma, ds.beta, strict=True)]
    assert len(rates) > 10 and np.abs(rates).max() < 1e-8
    exact = brentq(lambda gamma: eigenvalue(gamma, 0.45, v).real, 0.8, high, xtol=1e-15)
    assert ds.crossing_gamma.values == pytest.approx([exact], abs=1e-10)


@pytest.mark.long
def test_stops_against_friction_follow_published_boundary():
    """Compare with the diagram of Den Hartog (1931), and with viscous damping of Shaw (1986)."""
    onset = friction_stops(1.5, 0.1)
    moving = vj.follow(SHAKEN, along="grip", at=0.9 * onset, span=(0.3, 0.85), cycles=1, progress=False)
    kinds = moving.special_kind.values == SPECIAL_KINDS.index("stick")
    # Both turning points begin to stick at the same value.
    assert np.abs(moving.special_value.values[kinds] - onset).max() < 1e-9
    ds = vj.curves(moving, by="w", span=(1.0, 2.5), at={"w": 2.0}, progress=False)
    curve = points_of_kind(ds, "stick")
    exact = [friction_stops(float(w), 0.1) for w in curve.w]
    assert np.abs(curve.grip.values - exact).max() < 1e-9
    assert "multipliers of one side" in ds.multiplier_abs.attrs["comment"]
    assert ds.crossing_grip.values == pytest.approx([friction_stops(2.0, 0.1)], abs=1e-10)
    # Den Hartog's closed form has no damping.
    assert friction_stops(1.5, 0.0) == pytest.approx(0.8 / np.hypot(np.sqrt(3) / 1.5, 1 / 2.25), rel=1e-12)

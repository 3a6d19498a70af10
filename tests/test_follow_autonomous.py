"""Families of autonomous systems without events: branch points, hopf points, doublings, and ends at zero amplitude."""

import numpy as np
import pytest
from refusals import refusal
from systems import IMPACT_OSCILLATOR, VAN_DER_POL, lorenz, mass, names_of, one_state, system

import vibrojax as vj
from vibrojax.cli import main
from vibrojax.studies.family_analysis import families

E = vj.elementary


def points(family, kind):
    """Return the special points of a kind as (branch, value), in the order of the dataset."""
    own = np.array(names_of(family, "special_kind")) == kind
    return list(zip(family.special_branch.values[own].tolist(), family.special_value.values[own].tolist(), strict=True))


def kinds(family):
    return set(names_of(family, "special_kind"))


@pytest.mark.long
def test_pair_of_mirrored_orbits_meets_the_symmetric_one():
    """The pair of orbits of the Lorenz system is born at a pitchfork near r = 313, where it turns back."""
    settled = {"start": [30.0, 30.0, 1.0], "settle": 60.0, "observe": 20.0, "cycles": 1, "progress": False}
    family = vj.follow(lorenz("x"), along="r", at=280.0, span=(200.0, 330.0), **settled)
    assert kinds(family) == {"branch-point", "period-doubling", "end"}
    [(_, pair)] = points(family, "branch-point")
    assert pair == pytest.approx(312.97353, abs=1e-5)
    doublings = [value for branch, value in points(family, "period-doubling") if branch == 0]
    assert doublings == pytest.approx([229.4067086] * 2, abs=1e-7)  # AUTO: 229.40671; once for each of the pair
    assert family.r.values[family.branch.values == 0].max() == pytest.approx(pair, abs=1e-9)
    beyond = (family.branch.values == 1) & (family.r.values > pair)
    assert beyond.any() and family.stable.values[beyond].all()


def subcritical(t, y, p):
    square = y["x"] ** 2 + y["y"] ** 2
    growth, z = p["m"] + square - square**2, (p["m"] - 0.5) * y["z"] - y["z"] ** 3
    return {"x": growth * y["x"] - p["w"] * y["y"], "y": growth * y["y"] + p["w"] * y["x"], "z": z}


SUBCRITICAL = system("xyz", subcritical, name="subcritical", parameters={"m": -0.1, "w": 1.5}, section="y")
"""Circles with m = r⁴ - r² around a Hopf point at m = 0, with a fold at -1/4; a pitchfork of equilibria at m = 1/2."""


@pytest.fixture(scope="module")
def standing():
    """Equilibria of `SUBCRITICAL`, from the one at rest."""
    return vj.follow(SUBCRITICAL, along="m", at=-0.1, span=(-0.4, 0.9), start=[0.01] * 3, cycles=0, progress=False)


def test_equilibria_have_hopf_and_branch_points(standing):
    assert kinds(standing) == {"hopf", "branch-point", "end"}
    assert points(standing, "hopf")[0] == (0, pytest.approx(0.0, abs=1e-10))
    assert points(standing, "branch-point") == [(0, pytest.approx(0.5, abs=1e-9))]
    assert (standing.cycles.values == 0).all() and np.isnan(standing.period.values).all()
    m, branch = standing.m.values, standing.branch.values
    z = np.abs(standing.orbit_z.values)
    assert z == pytest.approx(np.where(branch == 1, np.sqrt(np.maximum(m - 0.5, 0.0)), 0.0), abs=1e-8)
    third = np.where(branch == 1, -2 * (m - 0.5), m - 0.5)
    expected = -np.sort(-np.stack([m, m, third], axis=1), axis=1)
    assert standing.eigenvalue_re.values == pytest.approx(expected, abs=1e-7)
    plane = families(standing).plots[-1]  # each axis fits its values
    greatest = np.abs(expected[branch == 0]).max()
    assert (plane.x.limits[1], plane.y.limits[1]) == pytest.approx((1.1 * greatest, 1.1 * 1.5), rel=1e-6)
    assert np.abs(standing.eigenvalue_im.values).max(axis=1) == pytest.approx(1.5, abs=1e-12)
    assert np.array_equal(standing.stable.values == 1, (expected < 0).all(axis=1))
    assert "holds equilibria" in refusal(vj.curves, standing, by="w", span=(1.0, 2.0), progress=False)


def test_hopf_points_are_exact_where_eigenvalues_change_slowly():
    """Lorenz's equilibria lose their stability at r = 470/19; the residual of 1e-10 alone leaves an error of 2e-7."""
    family = vj.follow(lorenz("x"), along="r", at=10.0, span=(0.2, 40.0), start=[4.9, 4.9, 0], cycles=0, progress=False)
    assert [value for _, value in points(family, "hopf")] == pytest.approx([470 / 19] * 2, abs=1e-9)


def test_equilibria_turn_back_at_a_fold():
    family = roots(1.0, (-1.0, 2.0), start=0.8, cm=1.0, c2=-1.0)
    assert kinds(family) == {"fold", "end"} and points(family, "fold") == [(0, pytest.approx(0.0, abs=1e-9))]
    assert family.orbit_x.values**2 == pytest.approx(family.m.values, abs=1e-9)
    assert family.eigenvalue_re.values[:, 0] == pytest.approx(-2 * family.orbit_x.values, abs=1e-8)


def test_unstable_orbits_begin_at_a_hopf_point(standing, tmp_path):
    """The command takes the family's file; the orbits are circles, stable beyond the fold."""
    vj.write_dataset(standing, tmp_path / "standing.nc")
    family = vj.follow(SUBCRITICAL, from_hopf=tmp_path / "standing.nc", cycles=1, progress=False)
    own = family.branch.values == 0
    square = family.orbit_x.values[own] ** 2
    assert family.m.values[own] == pytest.approx(square**2 - square, abs=1e-8)
    assert points(family, "fold")[0] == (0, pytest.approx(-0.25, abs=1e-9))
    assert points(family, "hopf")[0] == (0, pytest.approx(0.0, abs=1e-9))
    away = own & (np.abs(family.m.values + 0.25) > 1e-6) & (family.m.values < 0.4)
    largest = np.exp((2 * family.orbit_x.values**2 - 4 * family.orbit_x.values**4) * 2 * np.pi / 1.5)
    across = np.exp((family.m.values - 0.5) * 2 * np.pi / 1.5)
    assert family.multiplier_abs.values[away, 0] == pytest.approx(np.maximum(largest, across)[away], rel=1e-6)


@pytest.mark.long
def test_command_follows_onset_of_self_excited_vibration(here):
    """Steady sliding of the bit loses its stability at a drive speed; from there, orbits grow until the bit sticks."""
    span = ["along=v", "at=3.0", "from=1.0", "to=3.2"]
    assert main(["follow", "rotary", *span, "cycles=0", "start=drive", "-o", "still.nc"]) == 0
    assert main(["follow", "rotary", "from-hopf=still.nc", "cycles=1", "-o", "orbits.nc"]) == 0
    still, orbits = vj.open_dataset("still.nc"), vj.open_dataset("orbits.nc")
    [(_, onset)] = points(still, "hopf")
    assert points(orbits, "hopf") == [(0, pytest.approx(onset, abs=1e-8))]
    away = np.abs(still.v.values - onset) > 1e-6
    assert (still.stable.values == (still.v.values > onset))[away].all()
    sticks = max(value for _, value in points(orbits, "stick"))
    assert sticks < onset and np.nanmax(orbits.stick_fraction.values[orbits.v.values > sticks + 1e-6]) == 0


def test_family_begins_at_a_given_orbit():
    """The circle with the smaller radius at m = -0.1 is unstable: no motion settles on it."""
    square = 0.5 - np.sqrt(0.25 - 0.1)
    begin = {"states": [0.0, np.sqrt(square) + 0.005, 0.0], "period": 4.15}
    settings = {"along": "m", "at": -0.1, "span": (-0.4, 0.2), "cycles": 1, "progress": False}
    family = vj.follow(SUBCRITICAL, orbit=begin, **settings)
    here = np.flatnonzero(family.m.values == -0.1)
    assert np.abs(family.orbit_x.values[here]).min() == pytest.approx(np.sqrt(square), abs=1e-9)
    assert {"hopf", "fold", "end"} == kinds(family)
    twice = vj.follow(SUBCRITICAL, orbit=begin | {"period": 2 * 4.18}, **settings)
    assert (twice.cycles == 1).all() and points(twice, "fold") == [(0, pytest.approx(points(family, "fold")[0][1]))]
    with pytest.raises(vj.InputError, match="no periodic orbit near these states"):
        vj.follow(SUBCRITICAL, orbit={"states": [0.0, 3.0, 1.0], "period": 1.0}, **settings)


def test_forced_branches_cross():
    """1/x² of x' = (a + cos t) x - x³ is linear: orbits ±x meet that at rest at a = 0, where they turn back."""
    rate = lambda t, y, p: (p["a"] + E.cos(t)) * y["x"] - y["x"] ** 3
    forced = one_state(rate, parameters={"a": 0.3}, period=lambda p: 2 * np.pi)
    family = vj.follow(forced, along="a", at=0.3, span=(-0.2, 0.5), start=[1.0], settle=200.0, progress=False)
    assert kinds(family) == {"branch-point", "end"}
    assert points(family, "branch-point") == [(0, pytest.approx(0.0, abs=1e-9))]
    a, rest = family.a.values, family.branch.values == 1
    assert family.orbit_x.values[rest] == pytest.approx(0.0, abs=1e-7) and a[rest].min() == -0.2
    assert family.multiplier_abs.values[:, 0] == pytest.approx(np.exp(2 * np.pi * a * np.where(rest, 1, -2)), rel=1e-6)
    assert family.orbit_x.values[~rest].min() < -0.5 < 0.5 < family.orbit_x.values[~rest].max()


def test_bodies_that_friction_holds_are_no_equilibria():
    belt = vj.Friction("belt", relative=lambda t, y, p: y["v"], normal=lambda t, y, p: 1.0, acts_on="v", law=0.3)
    held = mass(lambda t, y, p: -p["k"] * y["x"] - 0.2 * y["v"], belt, parameters={"k": 1.0}, section="x")
    with pytest.raises(vj.InputError, match="where friction holds a body, none is isolated"):
        vj.follow(held, along="k", at=1.0, span=(0.5, 2.0), start=[0.1, 0.0], cycles=0, progress=False)


def test_wrong_beginnings_are_refused():
    for more, words in (
        ({"orbit": {"states": [1.0], "period": 2.0}}, "orbit.states: .* is not 3 numbers: x, y, z"),
        ({"orbit": {"states": [1.0, 0.0, 0.0], "period": -2.0}}, "orbit.period: is -2; it must be above 0 s"),
        ({"orbit": {}, "start": [0.0] * 3}, "orbit: and start both say where the family begins"),
        ({"from_hopf": 3}, "from_hopf: is not a family of equilibria"),
        ({"at": None}, "at is missing"),
    ):
        settings = {"along": "m", "at": -0.1, "span": (-0.4, 0.2), "progress": False} | more
        with pytest.raises(vj.InputError, match=words):
            vj.follow(SUBCRITICAL, **settings)


POLYNOMIAL = one_state(
    lambda t, y, p: (
        p["c0"] + p["cm"] * p["m"] + (p["c1"] + p["c1m"] * p["m"] + (p["c2"] + p["c3"] * y["x"]) * y["x"]) * y["x"]
    ),
    parameters=dict.fromkeys(("m", "c0", "cm", "c1", "c1m", "c2", "c3"), 0.0),
    section="x",
)
"""x' = c0 + cm m + (c1 + c1m m) x + c2 x² + c3 x³, for folds and pitchforks that share one kernel."""


def roots(at, span, start=0.0, **coefficients):
    """Return the equilibria of `POLYNOMIAL` along m."""
    more = {"start": [start], "cycles": 0, "progress": False}
    return vj.follow(POLYNOMIAL, along="m", at=at, span=span, **more, **coefficients)


def rests(states, field, at, span, *events, parameters=None, start=(), **more):
    """Return a system and its equilibria along m, from the one near `start`, by default 0."""
    start = list(start) or [0.0] * len(states)
    own = system(states, field, *events, name="rests", parameters={"m": 0.0} | (parameters or {}), section="x", **more)
    return own, vj.follow(own, along="m", at=at, span=span, start=start, cycles=0, progress=False)


@pytest.mark.parametrize("cubic", [1e6, 1e-8])
def test_equilibria_at_zero_show_their_scale_by_the_field(cubic):
    """The branches x² = m/cubic of a pitchfork are long and short, and both lead to the end."""
    family = roots(-1.0, (-1.0, 1.0), c1m=1.0, c3=-cubic)
    assert points(family, "branch-point") == [(0, pytest.approx(0.0, abs=1e-9))]
    own = family.branch.values == 1
    assert family.m.values[own].max() == 1.0
    assert family.orbit_x.values[own] ** 2 == pytest.approx(family.m.values[own] / cubic, abs=1e-9 / cubic)


def test_branches_that_nearly_meet_do_not_cross():
    family = roots(-1.0, (-1.0, 1.0), c0=1e-6, c1m=1.0, c3=-1.0)
    assert kinds(family) == {"end"} and family.stable.values.all()
    assert family.orbit_x.values.max() == pytest.approx(1.0, abs=1e-6)


@pytest.mark.long
def test_hopf_points_at_the_beginning_and_next_to_each_other():
    """At m = 1/2, real eigenvalues of opposite sign sum to zero: that is no Hopf point."""

    def field(t, y, p):
        m, n = p["m"], p["m"] - 1e-3
        first = {"x": m * y["x"] - y["y"], "y": y["x"] + m * y["y"]}
        second = {"z": n * y["z"] - 2 * y["w"], "w": 2 * y["z"] + n * y["w"]}
        return first | second | {"u": 0.5 * y["u"], "q": (m - 1) * y["q"]}

    _, family = rests("xyzwuq", field, 0.0, (-1.0, 0.9))
    assert kinds(family) == {"hopf", "end"}
    assert [value for _, value in points(family, "hopf")] == pytest.approx([0.0, 1e-3], abs=1e-9)


@pytest.mark.long
def test_equilibria_meet_a_switch_and_end_at_a_stop():
    """A spring under the load m stiffens at x = 0.3, a point that bears the name of the switch, and rests on the stop
    at x = d from m = 2 d - 0.3 on: beyond that the field has no equilibrium."""
    second = vj.Switch("second", lambda t, y, p: y["x"] - 0.3)
    stop = vj.Impact("stop", gap=lambda t, y, p: p["d"] - y["x"], velocity="v", restitution=lambda p: 0.7)

    def field(t, y, p, s):
        return {"x": y["v"], "v": p["m"] - y["x"] - 0.5 * (s["second"] + 1) * (y["x"] - 0.3) - 0.2 * y["v"]}

    states = {"x": "m", "v": "m s-1"}
    spring, family = rests(states, field, 0.1, (0.0, 1.0), second, stop, parameters={"d": 0.5})
    assert points(family, "second") == [(0, pytest.approx(0.3, abs=1e-9))]
    assert family.special_kind.attrs["flag_values"].dtype == family.special_kind.dtype  # CF: flags
    assert family.m.values.max() == pytest.approx(0.7, abs=1e-8) and family.m.values.max() <= 0.7
    assert family.orbit_v.attrs == {"units": "m s-1", "long_name": "v, at the equilibrium"}
    assert vj.picture(family) is not None
    with pytest.raises(vj.InputError, match="no isolated equilibrium"):
        vj.follow(spring, along="m", at=0.8, span=(0.0, 1.0), start=[0.0, 0.0], cycles=0, progress=False)


def test_equilibria_turn_back_at_a_kink():
    """The branches x = m and x = -m of x' = m - |x| meet at m = 0, where the derivative jumps from -1 to 1."""
    _, family = rests("x", lambda t, y, p: {"x": p["m"] - E.absolute(y["x"])}, 1.0, (-1.0, 2.0), start=[0.9])
    assert kinds(family) == {"grazing", "end"} and points(family, "grazing") == [(0, pytest.approx(0.0, abs=1e-8))]
    assert np.abs(family.orbit_x.values) == pytest.approx(family.m.values, abs=1e-9)
    assert sorted(family.orbit_x.values)[0] == -2.0 and sorted(family.orbit_x.values)[-1] == 2.0
    assert "kink" in str(family.special_note.values[family.special_value.values < 1.0][0])


def test_equilibria_end_at_the_edge_of_the_domain():
    """The equilibrium x = m² of x' = m - √x ends at m = 0: the root of no number is negative."""
    _, family = rests("x", lambda t, y, p: {"x": p["m"] - E.sqrt(y["x"])}, 1.0, (-1.0, 2.0), start=[0.9])
    assert kinds(family) == {"end"} and family.sizes["point"] < 100
    assert family.m.values.min() == pytest.approx(0.0, abs=1e-5)
    assert "edge of its domain" in str(family.special_note.values[family.special_value.values < 1.0][0])


def test_double_zero_eigenvalue_is_a_fold():
    """Bogdanov and Takens: at m = 0 both eigenvalues vanish, and no pair turns."""
    field = lambda t, y, p: {"x": y["y"], "y": p["m"] - y["x"] ** 2 + y["x"] * y["y"]}
    _, family = rests("xy", field, 1.0, (-1.0, 2.0), start=[1.0, 0.0])
    assert kinds(family) == {"fold", "end"} and points(family, "fold") == [(0, pytest.approx(0.0, abs=1e-9))]


def test_families_without_an_equilibrium_do_not_stop_others():
    """Of x' = m + c0 - x², only c0 = 1 has equilibria at m = 0."""
    family = roots(0.0, (-0.5, 1.0), start=0.9, cm=1.0, c2=-1.0, c0=[-1.0, 1.0])
    assert set(family.point_family.values.tolist()) == {1}
    assert "no isolated equilibrium" in refusal(roots, 0.0, (-0.5, 1.0), start=0.9, cm=1.0, c2=-1.0, c0=-1.0)


# Families of orbits whose amplitude shrinks
def test_family_passes_centre_of_large_amplitude():
    """Reversed time takes van der Pol's oscillator at mu to that at -mu: periods are equal, multipliers reciprocal. At
    mu = 0, the family crosses that of a centre, whose orbits have every amplitude and the period 2 pi."""
    begin = {"at": 0.4, "span": (-0.4, 0.4), "start": [1.0, 0.0], "cycles": 1}
    whole = vj.follow(VAN_DER_POL, along="mu", progress=False, **begin)
    family = whole.isel(point=whole.branch.values == 0, special=whole.special_branch.values == 0)
    assert points(family, "branch-point") == [(0, pytest.approx(0.0, abs=1e-9))]
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
    assert kinds(centre) == {"end", "hopf"}


@pytest.mark.long
def test_orbits_begin_at_the_hopf_points_of_mirrored_equilibria():
    """Circles r² = m around both equilibria z² = 1 + m."""

    def field(t, y, p):
        growth = y["z"] ** 2 - 1 - y["x"] ** 2 - y["y"] ** 2
        z = (p["m"] + 1) * y["z"] - y["z"] ** 3
        return {"x": growth * y["x"] - y["y"], "y": growth * y["y"] + y["x"], "z": z}

    pair, family = rests("xyz", field, -1.5, (-2.0, 1.0))
    assert [value for _, value in points(family, "hopf")] == pytest.approx([0.0, 0.0], abs=1e-9)
    assert family.special_note.values[family.special_value.values > 0.9].tolist() == ["the last value is reached"] * 3
    circles = vj.follow(pair, from_hopf=family, cycles=1, span=(-0.1, 0.5), progress=False)
    last = circles.m.values == 0.5
    assert sorted(circles.orbit_z.values[last]) == pytest.approx([-(1.5**0.5), 1.5**0.5], abs=1e-8)
    assert "outside the span" in refusal(vj.follow, pair, from_hopf=family, span=(0.2, 0.5), progress=False)


def test_orbits_begin_at_a_hopf_point_with_a_function_as_section():
    """Circles r² = m around 0."""

    def field(t, y, p):
        growth = p["m"] - y["x"] ** 2 - y["y"] ** 2
        return {"x": growth * y["x"] - y["y"], "y": growth * y["y"] + y["x"]}

    disc = system("xy", field, parameters={"m": 0.1}, section=lambda t, y, p: y["x"] + y["y"])
    rest = vj.follow(disc, along="m", at=0.1, span=(-0.2, 0.3), start=[0, 0], cycles=0, progress=False)
    circles = vj.follow(disc, from_hopf=rest, cycles=1, progress=False)
    assert circles.m.values.max() == 0.3 and points(circles, "hopf")[0][1] == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose(circles.orbit_x**2 + circles.orbit_y**2, circles.m, atol=1e-8)


GEAR = mass(
    lambda t, y, p, s: 0.2 + p["fa"] * E.cos(p["om"] * t) - 0.1 * y["v"] - 0.5 * (s["right"] + 1) * (y["x"] - 1),
    vj.Switch("right", lambda t, y, p: y["x"] - 1),
    name="gear",
    parameters={"om": 1.5, "fa": 0.2},
    period=lambda p: 2 * np.pi / p["om"],
)


def test_small_forced_motion_goes_on():
    """The amplitude of a forced motion below the stop is proportional to the force, however small."""
    begin = {"at": 0.05, "span": (1e-6, 0.06), "start": [0.0, 0.0], "cycles": 1}
    family = vj.follow(IMPACT_OSCILLATOR, along="a", w=0.9, progress=False, **begin)
    assert kinds(family) == {"end"} and family.special_value.values.min() == pytest.approx(1e-6)
    ratio = family.orbit_x.values / family.a.values
    np.testing.assert_allclose(ratio, ratio[0], rtol=1e-6)


@pytest.mark.long
def test_mirrored_branch_points_are_all_followed():
    """Two pitchforks at m = 0 and 1 that do not act upon each other have nine equilibria."""
    field = lambda t, y, p: {"x": p["m"] * y["x"] - y["x"] ** 3, "y": (p["m"] - 1) * y["y"] - y["y"] ** 3}
    _, family = rests("xy", field, -0.5, (-1.0, 2.0))
    last = family.m.values == 2.0
    ends = np.round(np.column_stack([family.orbit_x.values, family.orbit_y.values])[last] / [2**0.5, 1.0], 9) + 0.0
    assert {tuple(x) for x in ends.tolist()} == {(x, y) for x in (-1.0, 0.0, 1.0) for y in (-1.0, 0.0, 1.0)}
    assert [value for _, value in points(family, "branch-point")] == pytest.approx([0.0, 1.0, 1.0, 1.0], abs=1e-9)


@pytest.mark.long
def test_points_and_curves_bear_the_names_of_switches():
    """Teeth of a gear touch on one side, and part: nothing sticks."""
    settled = {"start": [1.2, 0.0], "settle": 150.0, "observe": 30.0, "cycles": 1, "progress": False}
    family = vj.follow(GEAR, along="om", at=1.43, span=(1.4, 1.44), **settled)
    assert kinds(family) == {"right", "end"}
    linear = 1.2 - 0.2 / np.hypot(1 - 1.41067**2, 0.141067)  # the teeth just part at the amplitude 0.2
    assert points(family, "right") == [(0, pytest.approx(1.41067, abs=1e-5))] and linear == pytest.approx(1.0, abs=1e-5)
    curves = vj.curves(family, by="fa", span=(0.1, 0.3), progress=False)
    assert np.array(curves.kind.attrs["flag_meanings"].split())[curves.kind.values].tolist() == ["right"]


def brusselator(t, y, p):
    """Return the rates, where the states are relative to the equilibrium (A, B/A)."""
    u, w = p["A"] + y["u"], p["B"] / p["A"] + y["w"]
    return {"u": p["A"] + u * u * w - (p["B"] + 1) * u, "w": p["B"] * u - u * u * w}


def predators(t, y, p):
    fish, sharks = y["fish"], y["sharks"]
    caught = p["quota"] * (1 - E.exp(-5 * fish))
    return {"fish": 3 * fish * (1 - fish) - fish * sharks - caught, "sharks": -sharks + 3 * fish * sharks}


BRUSSELATOR = system("uw", brusselator, name="Brusselator", parameters={"A": 1.0, "B": 3.0}, section="u")
PREDATORS = system(("fish", "sharks"), predators, parameters={"quota": 0.7}, section=("fish", 1 / 3))


def follow(own, **settings):
    return vj.follow(own, progress=False, **{"cycles": 1} | settings)


def sorted_points(family):
    """Return kind and parameter value of the special points, in the order of the values."""
    named = zip(names_of(family, "special_kind"), family.special_value.values, strict=True)
    return sorted(named, key=lambda point: point[1])


@pytest.mark.long
def test_planar_flows_have_no_invented_points():
    """The Brusselator's Hopf points are at B = 1 + A². Multipliers of planar flows are positive."""
    family = follow(BRUSSELATOR, along="B", at=3.0, span=(1.5, 3.5), start=[0.3, 0.0], A=[0.9, 1.1])
    assert len(sorted_points(family)) == 4
    for number, a in enumerate((0.9, 1.1)):
        (first, place), last = sorted_points(family.isel(special=family.special_family.values == number))
        assert (first, last) == ("hopf", ("end", 3.5)) and place == pytest.approx(1 + a * a, abs=1e-9)
    assert (family.multiplier_arg.values == 0).all()
    assert (family.stable.values[family.multiplier_abs[:, 0] < 0.99] == 1).all()


@pytest.mark.long
def test_predators_and_prey_end_at_zero_amplitude_and_at_long_periods():
    family = follow(PREDATORS, along="quota", at=0.7, span=(0.5, 0.8), start=[0.35, 0.3], settle=500.0, observe=200.0)
    (first, place), (last, long) = sorted_points(family)
    far = np.exp(-5 / 3)
    assert (first, last) == ("hopf", "end") and place == pytest.approx(1 / (3 * (1 - far) - 5 * far), abs=1e-9)
    begin = {"states": [1 / 3, float(family.orbit_sharks[2])], "period": float(family.period[2])}
    again = follow(PREDATORS, along="quota", at=float(family.quota[2]), span=(0.5, 0.68), orbit=begin)
    assert sorted_points(again)[0][1] == pytest.approx(place, abs=1e-9)  # the section is at a level of fish
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


@pytest.mark.parametrize(
    ("q", "at", "span", "start"),
    [(0, -0.1, (-0.12, 0.1), [1.5, 0.0]), pytest.param(1, 0.4, (-0.3, 0.5), [1.0, 0.0], marks=pytest.mark.long)],
)
def test_periods_grow_without_limit(q, at, span, start):
    """Cycles x³/3 - x²/2 + v²/2 = m end at the saddle's loop, m = 0; the rotation 1 + m - x has a zero at m = 0."""

    def field(t, y, p):
        x, v = y["x"], y["v"]
        off, growth, turn = x**3 / 3 - x**2 / 2 + v**2 / 2 - p["m"], 1 - x**2 - v**2, 1 + p["m"] - x
        cycle = v - off * (x**2 - x), x - x**2 - off * v
        circle = growth * x - turn * v, growth * v + turn * x
        return {name: (1 - p["q"]) * a + p["q"] * b for name, a, b in zip("xv", cycle, circle, strict=True)}

    own = system("xv", field, name="unbounded", parameters={"m": 0.0, "q": 0.0}, section="v")
    family = follow(own, along="m", at=at, span=span, start=start, settle=100.0, observe=150.0, q=q)
    notes = dict(zip(family.special_value.values, family.special_note.values, strict=True))
    [end] = [value for value, note in notes.items() if note == "the period grows without limit"]
    assert len(notes) == 2 and abs(end) < (2e-5 if q else 1e-9) and family.sizes["point"] < 400

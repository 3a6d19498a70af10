"""Test systems written as plain functions against closed forms, and one-line errors for mistakes in them."""

import pickle
import re

import numpy as np
import pytest
import systems
from own_scenes import (
    ball_appears,
    ball_doubles,
    ball_orbit,
    oscillator_doubles,
    oscillator_grazes,
    oscillator_orbits,
)
from scipy.optimize import brentq
from systems import BALL, BELT, BILINEAR, IMPACT_OSCILLATOR, RELAY, belt_period

import vibrojax as vj
from vibrojax.studies.trajectory import feature_lines

OSCILLATOR = {"w": 0.9, "stiffness": 1.0, "damping": 0.1, "stop": 1.0}
R = 0.7
GRAZE = oscillator_grazes(**OSCILLATOR)


def special_values(family, kind, branch=0):
    """Return the parameter values of the special points of a kind on a branch."""
    flag = family.special_kind.attrs["flag_meanings"].split().index(kind)
    chosen = (family.special_kind.values == flag) & (family.special_branch.values == branch)
    return family.special_value.values[chosen]


def test_orbits_and_multipliers_of_impact_oscillator():
    amplitudes = np.array([1.5, 2.0, 2.5, 2.9]) * GRAZE
    orbits = [oscillator_orbits(a, R, **OSCILLATOR)[-1] for a in amplitudes]
    stable = [abs(orbit.multipliers[0]) < 1 for orbit in orbits]
    points = {"a": amplitudes.tolist(), "x": [], "v": []}
    ds = vj.run_sweep(
        {
            "scene": IMPACT_OSCILLATOR,
            "grid": {"a": points["a"]},
            "starts": [orbits[-1].section.tolist()],
            "run": {"orbits": True},
        },
        progress=False,
    )
    assert any(stable) and ds.regime.attrs["flag_meanings"].split()[2] == "impact-free"
    for k in np.flatnonzero(stable):
        lane = ds.isel(a=int(k), start=0)
        assert lane.impacts == 1 and int(lane.regime) == 3
        assert float(lane.impact_velocity) == pytest.approx(orbits[k].speed, rel=1e-6)
        assert [float(lane.orbit_x), float(lane.orbit_v)] == pytest.approx(orbits[k].section.tolist(), abs=1e-8)
        known = np.sort(np.abs(orbits[k].multipliers))
        assert np.sort(lane.multiplier_abs.values) == pytest.approx(known, rel=1e-6)


def test_period_doubling_and_grazing_of_impact_oscillator():
    doubles = oscillator_doubles((1.5 * GRAZE, 3 * GRAZE), R, **OSCILLATOR)
    begin = oscillator_orbits(2.9 * GRAZE, R, **OSCILLATOR)[-1].section.tolist()
    family = vj.follow(
        IMPACT_OSCILLATOR, along="a", at=2.9 * GRAZE, span=(0.95 * doubles, 3 * GRAZE), start=begin, progress=False
    )
    assert special_values(family, "period-doubling") == pytest.approx([doubles], rel=1e-8)
    free = vj.follow(
        IMPACT_OSCILLATOR, along="a", at=0.9 * GRAZE, span=(0.8 * GRAZE, 1.2 * GRAZE), cycles=1, progress=False
    )
    assert special_values(free, "grazing") == pytest.approx([GRAZE], rel=1e-8)


@pytest.mark.long
def test_fold_and_period_doubling_of_ball_on_shaken_table():
    w, g = 2 * np.pi, 9.81
    low, high = ball_appears(0.5), ball_doubles(0.5)
    a = (low + high) / 2 * g / w**2
    orbit = ball_orbit((low + high) / 2, 0.5, w, g)
    start = [-a - float(orbit.section[0]), -float(orbit.section[1])]  # relative to the table, positive downwards
    span = (0.9 * low * g / w**2, 1.05 * high * g / w**2)
    family = vj.follow(BALL, along="a", at=a, span=span, start=start, cycles=1, progress=False)
    assert special_values(family, "fold") * w**2 / g == pytest.approx([low], rel=1e-8)
    assert special_values(family, "period-doubling") * w**2 / g == pytest.approx([high], rel=1e-8)


def test_accumulating_bounces_end_at_rest():
    motion = vj.simulate(BALL, start=[1.0, 0.0], duration=20.0, progress=False)
    impacts = motion.event_time.values[motion.event_kind.values == 3]
    ends = np.sqrt(2 / 9.81) * (1 + 0.5) / (1 - 0.5)
    assert impacts[-1] == pytest.approx(
        ends, abs=1e-6
    )  # the slowest bounces are omitted; their height is rounding error
    assert abs(float(motion.x[-1])) < 1e-12 and float(motion.v[-1]) == 0
    assert motion.regime.attrs["flag_meanings"].split()[int(motion.regime)] == "equilibrium"


def test_orbit_with_rest_in_each_period_has_zero_multipliers():
    """The table throws the ball where a w² cos(w t) = -g. After the first impact, bounces end at rest."""
    w, g, drives = 2 * np.pi, 9.81, np.linspace(1.1, 1.9, 9)
    ds = vj.run_sweep(
        {
            "scene": BALL,
            "grid": {"a": (drives * g / w**2).tolist(), "r": [0.2, 0.4]},
            "starts": [[0.0, 0.0], [1.0, 0.0]],
            "run": {"orbits": True},
        },
        progress=False,
    )
    found_flag = ds.orbit_reason.attrs["flag_meanings"].split().index("found")
    assert np.all(ds.orbit_reason == found_flag)
    lanes = ds.where(ds.impacts > 4)  # with r = 0.4, some drives throw the ball so that it never rests
    assert float(np.isfinite(lanes.impacts).mean()) > 0.7
    assert float(lanes.multiplier_abs.max()) < 1e-9 and np.nanmin(lanes.grazing_margin) > 1e-4
    assert np.ptp(ds.impacts.sel(r=0.2).values, axis=-1).max() == 0  # the same from both starts
    for drive in drives:
        a, leaves = drive * g / w**2, np.arccos(-1 / drive) / w
        height, speed = -a * np.cos(w * leaves), a * w * np.sin(w * leaves)
        above = lambda t: height + speed * t - g * t**2 / 2 + a * np.cos(w * (leaves + t))  # noqa: B023, E731
        flight = brentq(above, 0.02, 1.0, xtol=1e-15)
        meets = a * w * np.sin(w * (leaves + flight)) - (speed - g * flight)
        lane = ds.sel(a=a, r=0.2).impact_velocity_max.values
        assert lane == pytest.approx([meets] * 2, rel=1e-7)


def test_resting_ball_leaves_table_that_falls_faster():
    """The table's downward acceleration reaches a w² = 1.5 g. The ball leaves where a w² cos(w t) = -g."""
    a, w = 1.5 * 9.81 / (2 * np.pi) ** 2, 2 * np.pi
    motion = vj.simulate(BALL, start=[-a, 0.0], a=a, r=0.0, duration=1.0, sampling=1e-3, error=1e-8, progress=False)
    gap = motion.x.values + a * np.cos(w * motion.time.values)
    leaves = np.arccos(-1 / 1.5) / w
    flying = motion.time.values[gap > 1e-7]
    assert flying[0] == pytest.approx(leaves, abs=2e-2) and flying[0] > leaves
    assert np.abs(gap[motion.time.values < leaves]).max() < 1e-10  # accumulated errors of the steps


@pytest.mark.parametrize("speed", [0.05, 0.2])
def test_period_of_stick_slip_on_belt_from_two_starts(speed):
    ds = vj.run_sweep(
        {"scene": BELT, "grid": {"belt_speed": [speed]}, "starts": [[0.0, 0.0], [1.5, 0.0]], "run": {"error": 1e-6}},
        progress=False,
    )
    assert ds.period.values.ravel() == pytest.approx([belt_period(speed, 0.2)] * 2, rel=1e-8)
    assert ds.regime.attrs["flag_meanings"].split()[int(ds.regime[0, 0])] == "periodic"


def test_mass_on_fast_belt_never_sticks():
    """From rest the mass swings by mu_k N/k = 0.2 m. Its speed of at most 0.2 m/s stays below the belt's."""
    motion = vj.simulate(BELT, belt_speed=0.4, start=[0.0, 0.0], progress=False)
    assert float(motion.period) == pytest.approx(2 * np.pi, rel=1e-6)
    assert float(motion.v.max()) == pytest.approx(0.2, rel=1e-3)


@pytest.mark.parametrize("stiffness", [4.0, 9.0])
def test_natural_period_of_bilinear_oscillator(stiffness):
    motion = vj.simulate(BILINEAR, k2=stiffness, start=[1.0, 0.0], error=1e-8, progress=False)
    assert float(motion.period) == pytest.approx(np.pi * (1 + 1 / np.sqrt(stiffness)), rel=1e-8)


def test_relay_slides_by_filippov_convention():
    motion = vj.simulate(RELAY, start=[1.0, 0.0], duration=8.0, error=1e-8, progress=False)
    late = motion.sel(time=slice(5.0, None))
    decay = np.exp(-(late.time.values - late.time.values[0]))
    assert late.x.values / float(late.x[0]) == pytest.approx(decay, rel=1e-8)
    assert np.abs(late.x + late.y).max() < 1e-14


def test_section_can_lie_at_value_and_regimes_can_be_renamed():
    ticking = vj.System(
        "ticking",
        states={"x": "m", "v": "m s-1"},
        parameters={"mu": 0.5},
        field=lambda t, y, p: {"x": y["v"], "v": p["mu"] * (1 - y["x"] ** 2) * y["v"] - y["x"]},
        section=("x", 0.5),
        regimes={"periodic": "ticking"},
    )
    motion = vj.simulate(ticking, start=[0.1, 0.0], progress=False)
    assert motion.regime.attrs["flag_meanings"].split()[int(motion.regime)] == "ticking"
    assert float(motion.period) == pytest.approx(6.3807, abs=2e-3)  # van der Pol, mu = 0.5
    assert float(motion.x[0]) == pytest.approx(0.1) and float(motion.x.max()) == pytest.approx(2.0, abs=0.02)
    assert "Drawn: the last ten periods, grey: the whole motion" in vj.picture(motion).get_supxlabel()
    crossings = motion.event_time.values[motion.event_kind.values == 5]
    assert motion.x.interp(time=crossings[-3:]).values == pytest.approx([0.5] * 3, abs=1e-4)


def test_other_processes_import_system_from_its_module():
    assert pickle.loads(pickle.dumps(systems.BALL)) is systems.BALL
    alone = vj.System(
        "alone", states={"x": "m"}, parameters={"k": 1.0}, field=lambda t, y, p: {"x": -y["x"]}, section="x"
    )
    with pytest.raises(vj.InputError, match="top level of a file"):
        pickle.dumps(alone)


GOOD = {
    "states": {"x": "m", "v": "m s-1"},
    "parameters": {"k": 1.0},
    "field": lambda t, y, p: {"x": y["v"], "v": -p["k"] * y["x"]},
    "section": "x",
}
MISTAKES = {
    "is not a state": {"section": "z"},
    "are both given; give only one": {"period": 6.0},
    "field gave no rate of v": {"field": lambda t, y, p: {"x": y["v"]}},
    'a rate of "z"': {"field": lambda t, y, p: {"x": y["v"], "v": 0.0, "z": 1.0}},
    "field gave tuple": {"field": lambda t, y, p: (y["v"], 0.0)},
    "field asks for 'c'": {"field": lambda t, y, p: {"x": y["v"], "v": -p["c"]}},
    "shape (2,) for 3 lanes": {"field": lambda t, y, p: {"x": y["v"], "v": np.zeros(2)}},
    "real numbers": {"field": lambda t, y, p: {"x": y["v"], "v": 1j}},
    "not jnp, np or math": {"field": lambda t, y, p: {"x": y["v"], "v": -np.sin(y["x"])}},
    "field depends on t": {"field": lambda t, y, p: {"x": y["v"], "v": cos(t)}},
    "does not repeat after the period": {
        "field": lambda t, y, p: {"x": y["v"], "v": cos(t)},
        "section": None,
        "period": 6.0,
    },
    "it must be above zero": {"section": None, "period": lambda p: -p["k"]},
    "finite number": {"parameters": {"k": np.nan}},
    'parameter k has the unit "blub"': {"parameters": {"k": (1.0, "blub")}},
    "a pair such as (0.5, 'rad s-2')": {"parameters": {"k": (1.0, "s-2", 3)}},
    "at least one parameter": {"parameters": {}},
    "name of two things": {"parameters": {"x": 1.0}},
    "cannot be a name": {"states": {"t": "m", "v": "m s-1"}},
    "cannot see the switch": {"events": [vj.Switch("side", lambda t, y, p: y["x"])]},
    "choose from x, v": {"events": [vj.Impact("stop", gap=lambda t, y, p: y["x"], velocity="w")]},
    "decides by a value": {"field": lambda t, y, p: {"x": y["v"], "v": -max(y["x"], 0.0)}},
    "field, v, is nan at x = ": {"field": lambda t, y, p: {"x": y["v"], "v": vj.elementary.sqrt(-y["x"])}},
    "switches none": {"field": lambda t, y, p, s: {"x": y["v"], "v": -s["side"] * y["x"]}},
    "reset gave an array": {"events": [vj.Impact("a", gap=lambda t, y, p: 1 - y["x"], reset=lambda t, y, p: -y["v"])]},
    "write a function: lambda t, y, p: 0.5": {"events": [vj.Impact("stop", gap=0.5, velocity="v")]},
    'did you mean "coulomb"?': {
        "events": [
            vj.Friction("belt", relative=lambda t, y, p: y["v"], normal=lambda t, y, p: 1.0, law="coulumb", acts_on="v")
        ]
    },
    "write events=[vj.Impact(...)]": {"events": vj.Impact("stop", gap=lambda t, y, p: y["x"], velocity="v")},
    "states is list": {"states": ["x", "v"]},
    'has the unit "blub"': {"states": {"x": "blub", "v": "m s-1"}},
    "pair of a state and a number": {"section": ("x", "y")},
    "is not a regime": {"regimes": {"perodic": "rocking"}},
    "the velocity on which it acts": {
        "events": [
            vj.Friction("belt", relative=lambda t, y, p: y["x"], normal=lambda t, y, p: 1.0, law=0.2, acts_on="v")
        ]
    },
    "gap does not depend": {"events": [vj.Impact("stop", gap=lambda t, y, p: 1.0 - y["x"], velocity="x")]},
    "between 0 and 1": {"events": [vj.Impact("stop", gap=lambda t, y, p: y["x"], velocity="v", restitution=1.2)]},
    "either velocity=": {"events": [vj.Impact("stop", gap=lambda t, y, p: y["x"])]},
    "is not a vj.Impact": {"events": ["stop"]},
    "gap asks for 'd'": {"events": [vj.Impact("stop", gap=lambda t, y, p: p["d"] - y["x"], velocity="v")]},
}


def cos(x):
    return vj.elementary.cos(x)


@pytest.mark.parametrize("message", MISTAKES)
def test_mistake_in_system_gives_one_line(message):
    with pytest.raises(vj.InputError) as caught:
        vj.System("wrong", **(GOOD | MISTAKES[message]))
    text = str(caught.value)
    assert text.startswith("system wrong: ") and message in text and "\n" not in text and len(text) < 220


def test_start_beyond_stop_fails_with_reason():
    """A restitution above 1 fails too. A field may return plain numbers, which hold for all lanes."""
    ds = vj.run_sweep({"scene": IMPACT_OSCILLATOR, "grid": {"a": [0.1, 0.15]}, "starts": [[1.5, 0.0]]}, progress=False)
    assert ds.regime.attrs["flag_meanings"].split()[int(ds.regime[0, 0])] == "failed"
    assert reasons_of(ds) == ["beyond-a-stop"] * 2
    assert "Lanes failed: beyond-a-stop" in vj.picture(ds).get_supxlabel()
    bounces = vj.run_sweep({"scene": BALL, "grid": {"r": [0.5, 1.01]}, "starts": [[1.0, 0.0]]}, progress=False)
    assert (bounces.regime.values.ravel() == 7).tolist() == [False, True]
    assert reasons_of(bounces) == ["none", "restitution-not-0-to-1"]
    falling = vj.System("falling", **(GOOD | {"field": lambda t, y, p: {"x": 1.0, "v": 0.0}}))
    motion = vj.simulate(falling, start=[0.0, 0.0], duration=2.0, progress=False)
    assert float(motion.x[-1]) == pytest.approx(2.0)


def test_page_of_system_shows_motions_without_command(tmp_path):
    ds = vj.run_sweep({"scene": IMPACT_OSCILLATOR, "grid": {"a": [0.1, 0.15]}}, progress=False)
    page = vj.write_page(ds, tmp_path / "page.html").read_text()
    assert '"own_scene": true' in page or '"own_scene":true' in page
    assert "cannot be computed" not in page and 'id="vibrojax-cells"' in page


def reasons_of(ds):
    """Return the names of the reasons of a dataset's lanes."""
    return np.array(ds.reason.attrs["flag_meanings"].split())[ds.reason.values.ravel()].tolist()


def test_invalid_start_gives_one_line():
    with pytest.raises(vj.InputError, match=r"start: \[1.5, 0.0\]: the gap of stop_hit is -0.5; it must not be neg"):
        vj.simulate(IMPACT_OSCILLATOR, start=[1.5, 0.0], progress=False)
    with pytest.raises(vj.InputError, match=r"cannot be run \(beyond a stop\)"):
        vj.follow(IMPACT_OSCILLATOR, along="a", at=0.1, span=(0.05, 0.2), start=[1.5, 0.0], progress=False)
    power = vj.System("power", **(GOOD | {"field": lambda t, y, p: {"x": y["v"], "v": -(y["x"] ** 1.5)}}))
    with pytest.raises(vj.InputError, match="the field, v, is nan at the start; it must be finite"):
        vj.simulate(power, start=[-0.2, 0.0], progress=False)


def test_messages_about_starts_name_states_of_system():
    for wrong, right in (
        ({}, "plane = { x = { start = -0.05, stop = 0.05, num = 50 }, v = [-1.0, 1.0] }"),
        ({"sample": "sobol", "count": 4}, "box = { x = [-0.05, 0.05], v = [-2.0, 2.0] }"),
        (3, "[[0.1, 0.1]]"),
    ):
        with pytest.raises(vj.InputError, match=re.escape(right)):
            vj.run_sweep({"scene": BALL, "grid": {"r": [0.5]}, "starts": wrong}, progress=False)


def test_friction_with_switch():
    """A mass sticks on a belt until a spring, stiffer on one side, exceeds the friction of 0.4, at x = 0.4/4."""
    both = vj.System(
        "both",
        states={"x": "m", "v": "m s-1"},
        parameters={"k": 4.0, "speed": 0.1},
        field=lambda t, y, p, s: {
            "x": y["v"],
            "v": -0.5 * ((p["k"] + 1.0) + (p["k"] - 1.0) * s["side"]) * y["x"],
        },
        section="v",
        events=[
            vj.Switch("side", lambda t, y, p: y["x"]),
            vj.Friction(
                "belt",
                relative=lambda t, y, p: y["v"] - p["speed"],
                normal=lambda t, y, p: 1.0,
                law=0.2,
                static=0.4,
                acts_on="v",
            ),
        ],
    )
    motion = vj.simulate(both, start=[-0.2, 0.1], duration=6.0, sampling=0.01, error=1e-8, progress=False)
    leaves = float(motion.time[np.abs(motion.v.values - 0.1) > 1e-9][0])
    assert leaves == pytest.approx((0.1 + 0.2) / 0.1, abs=0.02)


@pytest.mark.parametrize("a", [0.00249, 0.0026, 0.0045])
def test_ball_thrown_up_slightly_stays_above_table(a):
    """Above the amplitude g/w² = 2.485 mm the ball leaves the table. Slow bounces near the section are included."""
    motion = vj.simulate(BALL, a=a, w=20 * np.pi, start=[0.1, 0.0], duration=3.0, sampling=5e-4, progress=False)
    gap = motion.x.values + a * np.cos(20 * np.pi * motion.time.values)
    assert gap.min() > -1e-9


def test_amplitudes_do_not_depend_on_steps():
    """x' = cos(w t) - x swings by 1/sqrt(1 + w²). No state is the rate of x, so no step ends at its turns."""
    lag = vj.System(
        "lag",
        states={"x": "1"},
        parameters={"w": 3.0},
        field=lambda t, y, p: {"x": vj.elementary.cos(p["w"] * t) - y["x"]},
        period=lambda p: 2 * np.pi / p["w"],
    )
    ds = vj.run_sweep({"scene": lag, "grid": {"w": [1.0, 3.0]}, "run": {"keep_returns": 4}}, progress=False)
    exact = 1 / np.sqrt(1 + ds.w.values**2)
    assert ds.x_amplitude.values.ravel() == pytest.approx(exact, rel=1e-6)
    assert ds.return_x.dims == ("w", "start", "return_index") and np.isfinite(ds.return_x).all()
    assert ds.return_x.values[:, 0, -1] == pytest.approx(exact**2, rel=1e-6)  # at t = 0, exact² cos 0


def test_impact_velocities_have_unit_of_velocity():
    pendulum = vj.System(
        "pendulum",
        states={"angle": "rad", "speed": "rad s-1"},
        parameters={"a": 0.5, "w": 1.5},
        field=lambda t, y, p: {
            "angle": y["speed"],
            "speed": p["a"] * vj.elementary.cos(p["w"] * t) - 0.1 * y["speed"] - vj.elementary.sin(y["angle"]),
        },
        period=lambda p: 2 * np.pi / p["w"],
        events=[vj.Impact("stop", gap=lambda t, y, p: 0.3 - y["angle"], velocity="speed", restitution=0.6)],
    )
    ds = vj.run_sweep({"scene": pendulum, "grid": {"w": [1.5]}, "run": {"orbits": True}}, progress=False)
    motion = vj.simulate(pendulum, start=[0.0, 0.0], progress=False)
    assert motion.impact_velocity.units == "rad s-1" and " rad/s" in feature_lines(motion)[0]
    assert ds.impact_velocity.units == "rad s-1" and ds.regime.attrs["long_name"] == "regime of the motion"


def test_branch_continues_past_graze_where_impact_vanishes():
    """Downwards, orbits with one impact per period end at the closed form.

    The doubled branch loses its slow impact where the motion after the other impact, in closed form, touches the stop.
    From there, orbits with one impact in two periods lead down to the graze of the motion without impacts.
    """
    family = vj.follow(IMPACT_OSCILLATOR, along="a", at=0.61, span=(0.2, 0.65), cycles=2, progress=False)
    [graze] = special_values(family, "grazing")
    assert abs(graze - GRAZE) < 1e-8
    slow, last = special_values(family, "grazing", branch=1)
    assert abs(slow - brentq(distance_at_other_maximum, 0.54, 0.58, xtol=1e-13)) < 1e-8
    assert abs(last - GRAZE) < 1e-8
    assert len(special_values(family, "fold", branch=1)) == 1  # the branch is not retraced


def distance_at_other_maximum(a):
    """Return the distance to the stop at the other maximum of the orbit with one impact in two periods."""
    w, stop = OSCILLATOR["w"], OSCILLATOR["stop"]
    orbit = oscillator_orbits(a, R, **OSCILLATOR, n=2)[-1]
    forced = a / complex(OSCILLATOR["stiffness"] - w**2, OSCILLATOR["damping"] * w)
    decay = complex(-OSCILLATOR["damping"] / 2, np.sqrt(OSCILLATOR["stiffness"] - (OSCILLATOR["damping"] / 2) ** 2))
    u = stop - (forced * np.exp(1j * orbit.phase)).real
    q = -R * orbit.speed - (1j * w * forced * np.exp(1j * orbit.phase)).real
    free = complex(u, (decay.real * u - q) / decay.imag)  # Re(free) = u, Re(decay free) = q

    def x(t, order=0):
        return (
            decay**order * free * np.exp(decay * t) + (1j * w) ** order * forced * np.exp(1j * (w * t + orbit.phase))
        ).real

    t = np.linspace(0.05, 0.95, 400) * 4 * np.pi / w
    rising = x(t, 1) > 0
    tops = [brentq(x, t[k], t[k + 1], (1,), xtol=1e-13) for k in np.flatnonzero(rising[:-1] & ~rising[1:])]
    return stop - max(x(top) for top in tops)


def test_diagram_shows_states_where_some_motions_have_no_impacts():
    """Below the graze all motions are the linear response, with x = a stiffness/D at t = 0, its branch and border."""
    grid = [0.5 * GRAZE, 0.8 * GRAZE, 1.6 * GRAZE]
    run = {"scene": IMPACT_OSCILLATOR, "grid": {"a": grid}, "run": {"keep_returns": 4}}
    ds = vj.run_sweep(run, progress=False)
    family = vj.follow(IMPACT_OSCILLATOR, along="a", at=grid[1], span=(grid[0], 1.2 * GRAZE), cycles=1, progress=False)
    figure = vj.picture(ds, over=family)
    curves = figure.axes[0]
    (dots,) = (x.get_offsets() for x in curves.collections if len(x.get_offsets()))
    real = 1.0 - OSCILLATOR["w"] ** 2
    exact = np.array(grid[:2]) * real / (real**2 + (OSCILLATOR["damping"] * OSCILLATOR["w"]) ** 2)
    factor = 1e3 if "mm" in curves.get_ylabel() else 1.0
    assert np.asarray(dots)[:8, 1] == pytest.approx(factor * np.repeat(exact, 4), rel=1e-5)
    legends = [legend for x in figure.axes if (legend := x.get_legend())] + figure.legends
    assert any("grazing" in text.get_text() for legend in legends for text in legend.get_texts())
    speeds = vj.picture(ds, variable="return_impact_velocity").axes[0]
    assert (
        speeds.get_ylabel().startswith("impact velocity") and "v at" in vj.picture(ds, "return_v").axes[0].get_ylabel()
    )


def test_parameters_have_units_of_pint(tmp_path):
    units = {"states": {"x": "deg", "v": "deg/s"}, "parameters": {"k": (1.0, "N m rad-1")}}
    torsion = vj.System("torsion", **(GOOD | units))
    ds = vj.run_sweep({"scene": torsion, "grid": {"k": [1.0, 2.0]}, "starts": [[1.0, 0.0]]}, progress=False)
    assert ds.k.units == "N m rad-1" and ds.x_amplitude.units == "deg"
    assert "k [N m/rad]" in [axes.get_xlabel() for axes in vj.picture(ds, variable="x_amplitude").axes]


def test_default_times_follow_slowest_oscillation():
    pair = vj.System(
        "pair",
        states={"x": "m", "v": "m s-1", "z": "m", "w": "m s-1"},
        parameters={"slow": 1.0, "fast": 10.0},
        field=lambda t, y, p: {
            "x": y["v"],
            "v": -p["slow"] * p["slow"] * y["x"],
            "z": y["w"],
            "w": -p["fast"] * p["fast"] * y["z"],
        },
        section="x",
    )
    assert pair.usual_times == pytest.approx((200 * np.pi, 80 * np.pi), rel=0.02)


def event_times(motion):
    """Return the times [s] of the events of a motion by kind."""
    names, flags = motion.event_kind.attrs["flag_meanings"].split(), motion.event_kind.values
    return {name: motion.event_time.values[flags == flag] for flag, name in enumerate(names)}


def test_sticking_body_has_exactly_speed_of_surface():
    """A departure moves the surface away by 1e-12 of a typical speed, at which the body must not stick."""
    motion = vj.simulate(BELT, start=[0.0, 0.0], duration=60.0, progress=False)
    sticks, slips = event_times(motion)["stick"], event_times(motion)["slip"]
    time = motion.time.values
    stuck = np.any([(time > a) & (time < b) for a, b in zip(sticks, slips, strict=False)], axis=0)
    assert len(sticks) >= 4 and stuck.sum() > 100
    assert np.abs(motion.v.values[stuck] - 0.2).max() < 1e-15


def test_trajectories_name_events_of_systems():
    bounces = event_times(vj.simulate(BALL, start=[1.0, 0.0], duration=2.0, progress=False))
    assert len(bounces["impact"]) > 10 and len(bounces["stick"]) == 1
    assert bounces["stick"][0] == pytest.approx(3 * np.sqrt(2 / 9.81), abs=1e-6)
    slides = event_times(vj.simulate(RELAY, start=[0.5, 0.2], duration=2.0, progress=False))
    assert len(slides["slide"]) == 1 and not len(slides["impact"])
    sides = event_times(vj.simulate(BILINEAR, start=[1.0, 0.0], duration=np.pi * 4 / 3, error=1e-10, progress=False))
    assert sides["switch"] == pytest.approx(np.array([1 / 6, 1 / 6 + 1]) * np.pi, abs=1e-8)


def test_soft_contacts_are_impacts_with_approach_speed():
    """A ball on elastic ground follows a parabola and an arc of the oscillation about g/k."""
    ball = vj.System(
        "soft-ball",
        states={"x": "m", "v": "m s-1"},
        parameters={"g": 9.81, "k": 1e4},
        field=lambda t, y, p, s: {"x": y["v"], "v": -p["g"] - p["k"] * y["x"] * (1 + s["contact"]) / 2},
        section="v",
        events=[vj.Switch("contact", lambda t, y, p: -y["x"], impact=True)],
    )
    ds = vj.run_sweep({"scene": ball, "starts": [[0.2, 0.0]], "run": {"settle": 2.0, "observe": 10.0}}, progress=False)
    speed, w = np.sqrt(2 * 9.81 * 0.2), 100.0
    assert ds.regime.attrs["flag_meanings"].split()[ds.regime.item()] == "single-impact"
    assert ds.impact_velocity.item() == pytest.approx(speed, rel=1e-6)
    contact = 2 * (np.pi - np.arctan(speed * w / 9.81)) / w
    assert ds.period.item() == pytest.approx(2 * speed / 9.81 + contact, rel=1e-6)


def test_normal_force_can_depend_on_switches():
    """A block slides onto ground where the normal force doubles. The work of friction equals its kinetic energy."""
    block = vj.System(
        "block",
        states={"x": "m", "v": "m s-1"},
        parameters={"N": 1.0, "edge": 0.5},
        field=lambda t, y, p, s: {"x": y["v"], "v": 0.0},
        section="v",
        events=[
            vj.Switch("far", lambda t, y, p: y["x"] - p["edge"]),
            vj.Friction(
                "slip",
                relative=lambda t, y, p: y["v"],
                normal=lambda t, y, p, s: p["N"] * (1.5 + 0.5 * s["far"]),
                law=0.3,
                acts_on="v",
            ),
        ],
    )
    motion = vj.simulate(block, start=[0.0, 1.0], duration=5.0, progress=False)
    assert float(motion.x[-1]) == pytest.approx(0.5 + (0.5 - 0.3 * 0.5) / 0.6, abs=1e-9)


def test_family_continues_where_impact_passes_section():
    """The impact occurs at the maximum of the force, t = 0, where the state at the section jumps."""
    fixed = {"a": 1.0, "stop": 0.5, "stiffness": 1.0, "damping": 0.1}
    family = vj.follow(IMPACT_OSCILLATOR, along="w", at=1.1, span=(0.9, 1.2), cycles=1, progress=False, a=1.0, stop=0.5)
    passed = brentq(lambda w: np.sin(oscillator_orbits(R=R, w=w, **fixed)[-1].phase), 0.9, 1.1)
    assert special_values(family, "section") == pytest.approx([passed], abs=1e-8)
    main = family.branch.values == 0
    assert {0.9, 1.2} <= set(family.w.values[main].tolist())
    for w, x in zip(family.w.values[main][::4], family.orbit_x.values[main][::4], strict=True):
        assert min(abs(x - orbit.section[0]) for orbit in oscillator_orbits(R=R, w=w, **fixed)) < 1e-8


def test_section_during_sliding_has_multipliers_of_sliding_motion():
    """On the surface v + 1.5 x = 0, x' = -1.5 x + b cos w t, so the multipliers are exp(-1.5 T) and 0."""
    relay = vj.System(
        "forced-relay",
        states={"x": "m", "v": "m s-1"},
        parameters={"b": 0.5, "w": 2.0},
        field=lambda t, y, p, s: {"x": y["v"] + p["b"] * cos(p["w"] * t), "v": -4.0 * s["relay"]},
        period=lambda p: 2 * np.pi / p["w"],
        events=[vj.Switch("relay", lambda t, y, p: y["v"] + 1.5 * y["x"])],
    )
    ds = vj.run_sweep({"scene": relay, "starts": [[0.3, 0.1]], "run": {"orbits": True}}, progress=False)
    assert ds.multiplier_abs.values.ravel() == pytest.approx([np.exp(-1.5 * np.pi), 0.0], abs=1e-8)


def test_departures_along_a_tangent_are_not_grazes():
    """Coulomb friction makes the mass stick in each period. The expected multiplier was computed with SciPy."""
    floor = vj.System(
        "floor",
        states={"x": "m", "v": "m s-1"},
        parameters={"w": 0.3},
        field=lambda t, y, p: {
            "x": y["v"],
            "v": 1.5 * vj.elementary.sin(p["w"] * t + 0.3) - y["x"] - 0.1 * y["v"],
        },
        period=lambda p: 2 * np.pi / p["w"],
        events=[
            vj.Friction("floor_friction", lambda t, y, p: y["v"], lambda t, y, p: 0.8, law=1.0, acts_on="v"),
        ],
    )
    ds = vj.run_sweep({"scene": floor, "starts": [[0.0, 0.0]], "run": {"orbits": True}}, progress=False)
    assert ds.orbit_reason.attrs["flag_meanings"].split()[ds.orbit_reason.item()] == "found"
    assert ds.multiplier_abs.values.ravel()[0] == pytest.approx(0.10922531, abs=1e-7)

"""Tests of measures: labels of synthetic features, in the order of rules, hidden motions, engineering quantities."""

import numpy as np
import pytest
import xarray as xr

import vibrojax as vj
from vibrojax.errors import InputError, Place, counted
from vibrojax.maps.read import read_point
from vibrojax.measures.labels import COMPARED, REGIMES, SAME_WITHIN, SINGLE_IMPACT, hides_another, label
from vibrojax.settings.names import read_names
from vibrojax.studies.summary import summarise, summary_facts, summary_lines

RUN = {"end_early": False, "settle": 20.0}  # one program for all sweeps of the scene
DRILL = {"scene": "drilling", "parameters": {"k1": 625000.0}, "run": RUN}


@pytest.fixture(scope="module")
def drilling():
    """Return lanes that repeat after one return, after several, and not at all; some do not penetrate."""
    return vj.run_sweep(DRILL | {"grid": {"gamma": [0.6, 0.75, 1.1, 1.2]}}, progress=False)


def test_power_and_energy_match_their_definitions(drilling):
    ds = drilling
    assert {0, 1} < set(ds.cycles.values.ravel().tolist()) and (ds.rate_of_penetration == 0).any()
    repeats = ds.cycles > 0
    power = (ds.impact_energy * ds.impacts / (ds.cycles * ds.period)).where(repeats)
    xr.testing.assert_allclose(ds.impact_power, power.rename("impact_power"))
    np.testing.assert_allclose(ds.blow_frequency, 60 * ds.impacts / (ds.cycles.clip(min=1) * ds.period))
    rate = ds.rate_of_penetration.where(ds.rate_of_penetration > 0)
    np.testing.assert_allclose(ds.specific_energy, power / (np.pi * 0.036**2 * rate))
    assert ds.specific_energy.bit_radius == 0.036
    names = ("impact_power", "blow_frequency", "stick_slip_index", "specific_energy")
    assert [ds[name].units for name in names] == ["W", "min-1", "1", "J m-3"]
    assert all(ds[name].attrs.get("definition") for name in names if name != "blow_frequency")


def test_wider_hole_takes_less_energy_per_volume():
    """The radius may be given alone, on an axis, or with a rotation. The energy refers to the area of that radius."""
    rotation = {"bit_radius": 0.05, "rpm": 120 / (np.pi * 0.1)}
    for more, grid in (({"v": 2.0}, {"bit_radius": [0.05]}), (rotation, {"gamma": [0.75]})):
        given = {"parameters": {"k1": 625000.0, "delta": 0.0} | more, "grid": grid, "starts": ["stuck"]}
        ds = vj.run_sweep(DRILL | given, progress=False).squeeze()
        volume = np.pi * 0.05**2 * float(ds.rate_of_penetration)
        assert volume > 0 and float(ds.specific_energy) == pytest.approx(float(ds.impact_power) / volume)
    assert ds.specific_energy.bit_radius == 0.05


@pytest.mark.parametrize("radius", [0.036, 0.2])
def test_summary_states_radius_start_and_shape(radius):
    """The radius of the hole is no parameter of the equations, but determines the specific energy."""
    motion = vj.simulate("drilling", start="stuck", bit_radius=radius, duration=0.5, progress=False)
    lines, facts = summary_lines(summarise(motion)), summary_facts(motion, "motion.nc")
    assert facts["parameters"]["bit_radius"] == radius and facts["start"] == "stuck"
    assert "start     stuck" in lines
    given = [line for line in lines if "bit_radius" in line]
    assert len(given) == 1 and ("bit_radius = 0.2 m (default 0.036)" in given[0]) == (radius == 0.2)
    motion.specific_energy.attrs["bit_radius"] = "wide"
    with pytest.raises(InputError, match=r'^specific_energy: attribute bit_radius: "wide" is not a finite number$'):
        summarise(motion)
    pulses = vj.simulate("penetration", pulse_shape="half-sine", duration=0.5, progress=False)
    assert "pulse_shape = half-sine" in "\n".join(summary_lines(summarise(pulses)))


@pytest.mark.parametrize("scene", vj.SCENES)
def test_each_parameter_reaches_the_equations_by_every_way(scene):
    """A point and a sweep of one lane resolve each parameter to the same values."""
    names = read_names(Place("test"), scene, {}, Place("test"))
    for name, parameter in names.writable.items():
        given = {name: 1.03 * parameter.default or 0.01}
        given |= {"bit_radius": 0.11} if name == "rpm" else {"rpm": 100.0} if name == "bit_radius" else {}
        axis = next(other for other in names.parameters if other not in (name, "v", "k1", "gamma"))
        sweep = vj.read_sweep({"scene": scene, "parameters": given, "grid": {axis: [names.parameters[axis].default]}})
        point = read_point(Place("test"), scene, given)
        expected = {key: float(x[0]) for key, x in sweep.lane_values(0, 1)[0].items()}
        assert point.parameters == pytest.approx(expected, rel=1e-15) and point.hole_radius == sweep.hole_radius


def test_stick_slip_index_of_a_harmonic_motion():
    """Without friction and damping, a mode of amplitude a at the angular frequency w moves the bit at v +- a w."""
    m1, beta, gamma, k1, v, a = 250.0, 0.4, 0.75, 156250.0, 1.5, 0.02
    m2, k2 = beta * m1, beta * gamma**2 * k1
    squares, shapes = np.linalg.eig(np.array([[(k1 + k2) / m1, -k2 / m1], [-k2 / m2, k2 / m2]]))
    squares, shapes = squares.real, shapes.real  # some versions of numpy return complex numbers
    upper = int(np.argmax(squares))
    x1, x2 = a * shapes[:, upper] / shapes[0, upper]
    sweep = {"scene": "rotary", "parameters": {"c2": 0.0, "g": 0.0}, "starts": [[x1, 0.0, x2, 0.0]], "grid": {"v": [v]}}
    sweep["run"] = {"end_early": False, "settle": 5.0, "error": 1e-8}
    ds = vj.run_sweep(sweep, progress=False)
    assert float(ds.stick_slip_index.squeeze()) == pytest.approx(a * np.sqrt(squares[upper]) / v, rel=1e-6)
    assert not {"impact_power", "blow_frequency", "specific_energy"} & set(ds.data_vars)


def test_campbell_diagram_over_rotation():
    grid = {"rpm": [60.0, 90.0, 120.0, 150.0]}
    sweep = DRILL | {"starts": ["stuck"], "grid": grid, "parameters": {"bit_radius": 0.12, "delta": 0.005}}
    ds = vj.run_sweep(sweep, progress=False)
    (axes,) = vj.picture(ds, diagram="campbell").axes
    drawn = {line.get_marker(): line for line in axes.lines if line.get_linestyle() == "None"}
    np.testing.assert_allclose(drawn["o"].get_xdata(), grid["rpm"])
    np.testing.assert_allclose(drawn["o"].get_ydata(), 1 / ds.period.squeeze())
    modes = vj.frequencies(ds)
    levels = [float(line.get_ydata()[0]) for line in axes.lines if len(line.get_ydata()) == len(grid["rpm"])]
    for name in ("lower_frequency", "upper_frequency"):
        assert np.isclose(levels, float(modes[name])).any()
    assert "2n" in [text.get_text() for text in axes.texts] and axes.get_xlabel() == "rotation [1/min]"
    (axes,) = vj.picture(ds.assign(period=np.nan * ds.period), diagram="campbell").axes  # no lane has returned
    assert axes.get_ylim()[0] == 0


MU, M1, G, K1 = 0.4, 250.0, 9.81, 156250.0
SWING = 1e-3 * MU * M1 * G / K1  # m, below which the bit is at rest

# A lane that repeats after every return, with one impact.
SINGLE = {"finite": True, "finished": True, "bit_amplitude": 0.05, "returns": 30.0}
SINGLE |= {"trend": 0.0, "cycles": 1.0, "impacts": 1.0}


def regime(**changes):
    features = {name: np.array([value]) for name, value in (SINGLE | changes).items() if value is not None}
    flags = label(features, np.array([MU]), np.array([M1]), np.array([G]), np.array([K1]))
    assert flags.dtype == np.int8
    assert flags.shape == (1,)
    return REGIMES[flags[0]]


def test_flags_keep_their_numbers_and_rest_has_a_least_friction():
    names = "undecided equilibrium impact-free single-impact multi-impact subharmonic irregular failed"
    assert tuple(names.split()) == REGIMES
    # A law with mu(0+) = 0 (2.15) is measured by max(mu(0+), 0.01).
    features = {name: np.array([value, value]) for name, value in SINGLE.items()}
    features["bit_amplitude"] = 1e-3 * 0.01 * M1 * G / K1 * np.array([0.99, 1.01])
    flags = label(features, np.zeros(2), np.full(2, M1), np.full(2, G), np.full(2, K1))
    assert [REGIMES[flag] for flag in flags] == ["equilibrium", "single-impact"]


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({}, "single-impact"),
        ({"impacts": 0.0}, "impact-free"),
        ({"impacts": 2.0}, "multi-impact"),
        ({"cycles": 2.0, "impacts": 3.0}, "subharmonic"),
        ({"cycles": 0.0, "impacts": 0.9}, "irregular"),
        ({"returns": 8.0}, "undecided"),
        ({"trend": 1.0}, "undecided"),
        ({"bit_amplitude": 0.99 * SWING}, "equilibrium"),
        ({"finite": False}, "failed"),
        ({"finished": False}, "failed"),
        # Of several rules, the first in the order 7, 1, 0, 2 to 5, 6 applies.
        ({"finite": False, "bit_amplitude": 0.0, "returns": 0.0}, "failed"),
        ({"bit_amplitude": 0.0, "returns": 0.0, "cycles": 0.0}, "equilibrium"),
        ({"returns": 5.0, "impacts": 0.0}, "undecided"),
        ({"trend": 1.0, "cycles": 0.0}, "undecided"),
    ],
)
def test_rules_in_order(changes, expected):
    assert regime(**changes) == expected


# Hidden motions: starts that end in different motions with one label
def test_hidden_motion_agrees_with_comparison_of_all_pairs():
    random = np.random.default_rng(0)
    for _ in range(40):
        points, starts, motions = random.integers(1, 6), random.integers(2, 40), random.integers(1, 4)
        lanes, noise = points * starts, 10.0 ** random.uniform(-6, -1.5)
        spread, which = 10.0 ** random.uniform(-4, -1), random.integers(0, motions, lanes)
        own, jitter = (random.normal(size=(len(COMPARED), n)) for n in (motions, lanes))
        values = (1 + spread * own)[:, which] * (1 + noise * jitter)
        features = dict(zip(COMPARED, values, strict=True))
        features["impact_velocity"][random.random(lanes) < 0.1] = np.nan
        features["cycles"] = random.integers(0, 3, lanes).astype(float)
        error = 10.0 ** random.uniform(-6, random.uniform(-5.5, -0.5), lanes)
        error[random.random(lanes) < 0.1] = np.inf
        features["error_estimate"] = error
        regime = random.integers(2, 4, lanes).astype(np.int8)
        assert (hides_another(features, regime, int(starts)) == _compare_all_pairs(features, regime, starts)).all()


def _compare_all_pairs(features, regime, starts):
    hidden = np.zeros(len(regime), int)
    for i in range(len(regime)):
        for j in range(i - i % starts, i - i % starts + starts):
            same = regime[i] == regime[j] and features["cycles"][i] > 0 and features["cycles"][j] > 0
            within = SAME_WITHIN + features["error_estimate"][i] + features["error_estimate"][j]
            pairs = [(features[name][i], features[name][j]) for name in COMPARED]
            hidden[i] |= same and any(abs(a - b) > within * max(abs(a), abs(b)) for a, b in pairs)
    return hidden


def test_three_starts_have_one_label():
    """A plain map would hide this case: 0.67, 3.03 and 0.67 m/s, all of them single impacts."""
    grid = {"beta": [0.4, 0.5], "gamma": [0.6, 0.9]}
    tables = {"scene": "vibro-impact", "starts": ["drive", "stuck", "touching"], "parameters": {"delta": 0.0}}
    swept = vj.run_sweep(tables | {"grid": grid}, progress=False)
    point = swept.sel(beta=0.4, gamma=0.6)
    assert (point.regime == SINGLE_IMPACT).all()
    np.testing.assert_allclose(point.impact_velocity, [0.67, 3.03, 0.67], atol=0.01)
    assert (point.hidden_motion == 1).all()
    points = counted(int(swept.hidden_motion.any("start").sum()), "point")
    assert summary_lines(summarise(swept.isel(start=0)))
    text = "\n".join(summary_lines(summarise(swept)))
    assert f"at {points} starts end in different motions under one label" in text

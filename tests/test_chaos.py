"""Test the largest Lyapunov exponent of nonsmooth motions, and the natures of lanes that do not repeat."""

import itertools

import numpy as np
import pytest
from refusals import refusal
from systems import IMPACT_OSCILLATOR, lorenz, oscillator_orbits

import vibrojax as vj
from vibrojax.io.variables import NATURES
from vibrojax.measures.labels import IRREGULAR
from vibrojax.periodic.growth import exponents, grow, zero_one

GAP = {"scene": "vibro-impact", "starts": ["stuck"], "parameters": {"delta": 0.005}}
# One irregular, one quasi-periodic and two periodic lanes (see test_natures).
LANES = GAP | {"points": {"beta": [0.5, 0.5, 0.4, 0.3], "gamma": [0.7, 0.67, 0.59, 0.6]}, "run": {"lyapunov": True}}


def roessler(t, y, p):
    return {"x": -y["y"] - y["z"], "y": y["x"] + 0.2 * y["y"], "z": 0.2 + y["z"] * (y["x"] - 5.7)}


def duffing(t, y, p):
    return {"x": y["v"], "v": -0.3 * y["v"] + y["x"] - y["x"] ** 3 + p["a"] * vj.elementary.cos(1.2 * t)}


FLOWS = {"roessler": (roessler, "xyz", {"section": "x"}), "duffing": (duffing, "xv", {"period": 2 * np.pi / 1.2})}


@pytest.fixture(scope="module")
def lanes_of_each_nature():
    return vj.run_sweep(LANES, progress=False).squeeze("start")


CURVED = lambda t, y, p: y["x"] * y["y"] - 8 / 3 * (y["w"] + p["r"] - 1.0)


@pytest.mark.parametrize("section", ["w", pytest.param(CURVED, marks=pytest.mark.long)], ids=["plane", "curved"])
def test_lorenz(section):
    """Compare the mean of some lanes with 0.9056 (Sprott, Chaos and Time-Series Analysis, 2003), on any section."""
    starts = {"sample": "random", "count": 8, "seed": 0, "box": {"x": [1, 10], "y": [1, 10], "w": [-10, 10]}}
    run = {"settle": 20.0, "observe": 20.0, "lyapunov": True}
    tables = {"scene": lorenz(section), "grid": {"r": [28.0]}, "starts": starts, "run": run}
    lanes = vj.run_sweep(tables, progress=False)
    assert abs(float(lanes.lyapunov.mean()) / 0.9056 - 1) < 0.015
    assert (lanes.nature == NATURES.index("chaotic")).all() and (lanes.zero_one > 0.9).all()
    deviation = (lanes.lyapunov - 0.9056) / lanes.lyapunov_stderr
    assert float(np.abs(deviation).max()) < 4 and 0.3 < float(deviation.std()) < 1.5


def covered(rate, time, exponent):
    """Return in what share of lanes the exponent is within 1.96 standard errors, and the mean standard error."""
    found, error = exponents(rate, time)
    return float((np.abs(found - exponent) < 1.96 * error).mean()), float(error.mean())


def test_error_of_exponents_of_maps():
    """Slopes of a skew tent map are independent, and log|slope| has a known mean; returns take different times."""
    random, share = np.random.default_rng(0), 0.3
    mean = -share * np.log(share) - (1 - share) * np.log(1 - share)
    errors = []
    for count in (2048, 20480):
        low = random.random((count, 400)) < share
        rate, time = -np.log(np.where(low, share, 1 - share)), np.where(low, 0.5, 1.5)
        inside, error = covered(rate, time, mean / (1.5 - share))
        assert 0.9 <= inside <= 0.98
        errors.append(error)
    assert errors[0] / errors[1] == pytest.approx(10**0.5, rel=0.05)


def test_impact_oscillator():
    """Compare with the closed form ln|multiplier|/T, for real and for complex multipliers."""
    grid = {"damping": [0.04, 0.1], "r": [0.3, 0.8], "w": [1.5, 2.0]}
    run = {"settle": 200.0, "observe": 60.0, "lyapunov": True}
    fixed = {"a": 0.5, "stop": 0.0}
    lanes = vj.run_sweep({"scene": IMPACT_OSCILLATOR, "parameters": fixed, "grid": grid, "run": run}, progress=False)
    assert (lanes.cycles == 1).all()
    for damping, r, w in itertools.product(*grid.values()):
        orbit = oscillator_orbits(R=r, w=w, damping=damping, stiffness=1.0, **fixed)[-1]
        expected = np.log(np.abs(orbit.multipliers[0])) * w / (2 * np.pi)
        assert lanes.lyapunov.sel(damping=damping, r=r, w=w).item() == pytest.approx(expected, abs=1e-6)


def test_exponents_of_long_periods():
    """A motion with one impact in 12 periods is longer than labels detect; its multipliers have a closed form."""
    lanes = {"damping": 0.01, "a": 0.5, "stop": 0.0}
    r = 0.5
    for w in (24 * 0.99, 24 * 1.02):
        orbit = oscillator_orbits(R=r, w=w, stiffness=1.0, n=12, **lanes)[-1]
        box = {name: [value - 1e-6, value + 1e-6] for name, value in zip("xv", orbit.section, strict=True)}
        sweep = {"scene": IMPACT_OSCILLATOR, "parameters": lanes | {"r": r}, "grid": {"w": [w]}}
        sweep |= {"starts": {"sample": "random", "count": 1, "seed": 0, "box": box}}
        sweep |= {"run": {"settle": 60.0, "observe": 60.0, "lyapunov": True}}
        lane = vj.run_sweep(sweep, progress=False).squeeze()
        expected = np.log(np.abs(orbit.multipliers).max()) * w / (24 * np.pi)
        assert int(lane.cycles) == 0 and NATURES[int(lane.nature)] == "periodic"
        assert float(lane.lyapunov) == pytest.approx(expected, abs=1e-8) and float(lane.lyapunov_stderr) == 0


def test_natures(lanes_of_each_nature):
    lanes = lanes_of_each_nature
    exponent, error = lanes.lyapunov, lanes.lyapunov_stderr
    assert [NATURES[flag] for flag in lanes.nature.values] == ["chaotic", "quasi-periodic", "periodic", "periodic"]
    assert lanes.regime.values[:2].tolist() == [IRREGULAR] * 2
    assert float(exponent[0]) > 6 * float(error[0]) > 0
    assert abs(float(exponent[1])) < 3 * float(error[1]) < 0.03
    assert (exponent[2:] < 0).all() and (error[2:] == 0).all() and exponent.attrs["units"] == "1/s"
    assert float(lanes.zero_one[0]) > 0.95 and np.isnan(lanes.zero_one.values[2:]).all()


def test_exponents_do_not_require_orbits_or_change_other_variables(lanes_of_each_nature):
    assert "orbit_reason" not in lanes_of_each_nature
    plain = vj.run_sweep(LANES | {"run": {}}, progress=False).squeeze("start")
    for name in plain.data_vars:
        np.testing.assert_array_equal(lanes_of_each_nature[name], plain[name], err_msg=str(name))
    with_orbits = vj.run_sweep(LANES | {"run": {"lyapunov": True, "orbits": True}}, progress=False).squeeze("start")
    np.testing.assert_array_equal(with_orbits.lyapunov, lanes_of_each_nature.lyapunov)


def test_slow_transient_is_labelled_not_settled():
    """During the transient, the lane does not repeat. Its exponent is that of the orbit on which it settles."""
    early = GAP | {"grid": {"beta": [0.5], "gamma": [0.66]}, "run": {"lyapunov": True, "settle": 20.0}}
    late = early | {"run": {"lyapunov": True, "settle": 300.0}}
    early, late = (vj.run_sweep(tables, progress=False).squeeze() for tables in (early, late))
    assert NATURES[int(early.nature)] == "not-settled" and NATURES[int(late.nature)] == "periodic"
    assert abs(float(early.lyapunov - late.lyapunov)) < 0.02 < -float(late.lyapunov)


def test_exponents_of_sticking_and_refused_lanes():
    sticking = {"scene": "rotary", "grid": {"gamma": [0.7]}, "run": {"lyapunov": True, "orbits": True}}
    failing = {"scene": "vibro-impact", "grid": {"k0": [5e7, 1e300]}, "run": {"lyapunov": True, "settle": 5.0}}
    more = {"starts": ["stuck"], "unusual": True}
    stuck, failing = (vj.run_sweep(tables | more, progress=False).squeeze() for tables in (sticking, failing))
    assert float(stuck.stick_fraction) > 0.001 and float(stuck.multiplier_abs[-1]) < 1e-12
    assert np.isfinite(float(stuck.lyapunov))
    assert np.isnan(float(failing.lyapunov[1])) and int(failing.nature[1]) == NATURES.index("unknown")


def test_zero_one_test_separates_regular_from_chaotic_maps():
    """Use Gottwald and Melbourne's logistic map at mu = 3.55 (regular) and 3.97 (chaotic), and a rotation."""
    x = np.full(2, 0.3)
    series = []
    for _ in range(1200):
        x = np.array([3.55, 3.97]) * x * (1 - x)
        series.append(x)
    regular, chaotic = zero_one(np.array(series)[200:])
    assert abs(regular) < 0.1 and chaotic > 0.95
    rotation = np.cos(2 * np.pi * 0.3819660112501051 * np.arange(1000))[:, None]
    assert abs(zero_one(rotation)[0]) < 0.15


def test_no_bit_of_statistics_depends_on_other_lanes():
    series = np.random.default_rng(1).standard_normal((1000, 7))
    whole = np.array([zero_one(series), *exponents(series, 1 + series**2)])
    for lanes in (slice(0, 1), slice(6, 7), slice(2, 4), slice(1, 6)):
        own = series[:, lanes]
        np.testing.assert_array_equal([zero_one(own), *exponents(own, 1 + own**2)], whole[:, lanes])


def test_unsuitable_sweep_is_refused_in_one_line():
    for tables, line in (
        ({"run": {"lyapunov": 1}}, "run.lyapunov: 1 is neither true nor false"),
        ({"run": {"lyapunov": True, "method": "smoothed"}}, 'lyapunov: true has no use with method "smoothed"'),
        ({"scene": "penetration", "grid": {"force": [5e4]}, "run": {"lyapunov": True}}, "no use in penetration"),
    ):
        assert line in refusal(vj.read_sweep, {"scene": "vibro-impact", "grid": {"gamma": [0.7]}} | tables)


@pytest.mark.long
@pytest.mark.parametrize("name", FLOWS)
def test_error_of_exponents_of_flows(name):
    """The mean over all lanes is known ten times better than the exponent of one. (Lorenz: `test_lorenz`.)"""
    field, states, more = FLOWS[name]
    units = dict.fromkeys(states, "1")
    scene = vj.System(f"exponent-{name}", states=units, parameters={"a": 0.5}, field=field, **more)
    starts = {"sample": "random", "count": 100, "seed": 0, "box": {key: [0.1, 0.9] for key in states}}
    run = {"settle": 100.0, "observe": 60.0, "keep_returns": 2}
    lanes = vj.run_sweep({"scene": scene, "starts": starts, "run": run}, progress=False)
    sweep = vj.read_sweep({"scene": scene, "grid": {"a": [0.5]}})
    returns = sweep.system.return_states
    state = np.stack([lanes[f"return_{name}"].values.reshape(100, -1)[:, -1] for name in returns])
    growth = grow(sweep.system, {"a": np.full(100, 0.5)}, state, np.ones_like(state), np.ones_like(state), 2048)
    inside, _ = covered(growth.rate, growth.time, growth.rate.sum() / growth.time.sum())
    assert 0.9 <= inside <= 0.98

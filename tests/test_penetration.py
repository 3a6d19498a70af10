"""Test the bit on rock, under pulses and a drill: reference cases, closed forms, error estimates, orbits, summaries."""

import json
from pathlib import Path

import exact
import jax
import numpy as np
import pytest
from systems import names_of

import vibrojax as vj
from vibrojax.cli import main
from vibrojax.physics.rock import ROCKS, resistance
from vibrojax.studies.summary import summarise

CASES = json.loads((Path(__file__).parent / "data" / "penetration_cases.json").read_text())
NAMES = {"A": "force", "f": "frequency", "w": "pulse_width", "D": "threshold", "k3": "k3", "zeta": "zeta"}
SHAPES = ("rectangular", "half-sine")
SHORT = {"settle": 2.0, "observe": 1.0}
"""Run settings. The slowest cases strike 10 times a second, so 20 pulses settle; the reference takes 60."""


def cases_of(shape):
    return [case for case in CASES if case["point"]["shape"] == shape]


@pytest.fixture(scope="module")
def datasets():
    runs = {}
    for shape in SHAPES:
        points = {name: [case["point"][key] for case in cases_of(shape)] for key, name in NAMES.items()}
        sweep = {"scene": "penetration", "parameters": {"pulse_shape": shape}, "points": points, "run": SHORT}
        runs[shape] = vj.run_sweep(sweep, progress=False)
    return runs


def expected(shape, name):
    return np.array([case["expected"][name] for case in cases_of(shape)])


@pytest.mark.parametrize("shape", SHAPES)
def test_measures(datasets, shape):
    """P = A w f for rectangular pulses, times 2/pi for half-sines, eta = P/D, and ROP = s f (R8, in true units)."""
    ds = datasets[shape]
    bounds = {"mean_force": (1e-10, 0.0), "relief": (1e-10, 0.0), "rate_of_penetration": (1e-8, 1e-11)}
    for name, (relative, absolute) in bounds.items():
        np.testing.assert_allclose(ds[name], expected(shape, name), rtol=relative, atol=absolute, err_msg=name)
    slip, exact = ds.slip_per_impact.values, expected(shape, "slip_per_pulse")
    np.testing.assert_allclose(slip, exact, rtol=1e-8, atol=1e-12)
    assert np.all(slip[exact == 0] == 0)
    np.testing.assert_allclose(ds.rate_of_penetration, slip * ds.frequency, rtol=1e-12)


@pytest.mark.parametrize("shape", SHAPES)
def test_error_estimate_is_upper_bound(datasets, shape):
    """The estimate bounds the error and stays below the accepted 1e-4."""
    exact = expected(shape, "rate_of_penetration")
    rate, estimate = datasets[shape].rate_of_penetration.values, datasets[shape].error_estimate.values
    assert np.all(estimate < 1e-4)
    assert np.all(np.abs(rate - exact) <= estimate * exact + 1e-8 * exact + 1e-11)  # the reference is accurate to 1e-9


# Motions against closed forms of eqs. 6.1 to 6.3
M1, K3, D = 250.0, 300e6, 150e3


def motion(duration, **parameters):
    settings = {"duration": duration, "sampling": 1e-4, "error": 1e-8, "progress": False}
    return vj.simulate("penetration", k3=K3, threshold=D, **settings, **parameters)


def test_steady_response_to_sine_of_constant_frequency():
    """For a swept sine of rate 0 about a bias, x3 = B/k3 + Im(A H e^{i omega t}) after the transient."""
    zeta, bias, force, omega = 0.7, 60e3, 50e3, 2 * np.pi * 45.0
    sine = {"pulse_shape": "sweep", "sweep_start": 45.0, "sweep_rate": 0.0, "bias": bias, "force": force}
    late = motion(0.5, zeta=zeta, **sine).sel(time=slice(0.4, None))
    response = force / (K3 - M1 * omega**2 + 1j * omega * 2 * zeta * np.sqrt(M1 * K3))
    expected = bias / K3 + (response * np.exp(1j * omega * late.time.values)).imag
    np.testing.assert_allclose(late.x3, expected, rtol=1e-9)


# The error estimate covers settling and the mean over a finite observation
BEATING = {"force": 364187.2, "frequency": 32.95242, "pulse_width": 0.002, "pulse_shape": "half-sine"}
BEATING |= {"threshold": 202693.9, "k3": 36945190.0, "zeta": 0.0}
"""Without damping, the bit beats for seconds before a pulse first breaks the rock."""


def dataset(times, **parameters):
    run = {"settle": times, "observe": times}
    grid = {"frequency": [parameters.pop("frequency", 20.0)]}
    tables = {"scene": "penetration", "parameters": parameters, "grid": grid, "run": run, "unusual": True}
    return vj.run_sweep(tables, progress=False)


def test_undamped_lanes_are_not_certified():
    """In the first second, no pulse breaks the rock. Later, the rate is 0.05 m/s."""
    ds = dataset(1.0, **BEATING)
    assert not float(ds.error_estimate.item()) <= 1.0
    assert ds.attrs["certified"].count('"within": 0') == 1
    # The drill has settled after 5 s, but the bit still moves on the rock: the rate of penetration is 20 % too low.
    point = {"beta": 0.1342515580221152, "gamma": 0.48801906227391845, "v": 1.2542774914090655}
    point |= {"c2": 141.5584516830171, "delta": -0.00381931693952789}
    rock = {"zeta": 0.0, "threshold": 54599.84978859603, "k3": 21316867.615476258}
    estimates = {}
    for scene, parameters in (("vibro-impact", point), ("drilling", point | rock)):
        sweep = {"scene": scene, "parameters": parameters, "grid": {"mu": [0.4]}, "starts": ["stuck"]}
        ds = vj.run_sweep(sweep | {"run": {"settle": 5.0, "observe": 3.0}}, progress=False)
        assert ds.cycles.item() == 1
        estimates[scene] = float(ds.error_estimate.item())
    assert estimates["vibro-impact"] < 1e-4 < 0.2 < estimates["drilling"]


def test_damped_lane_is_certified_unless_it_does_not_repeat():
    """A rate of zero is certified as well if the load stays below the yield force. The rate under a swept sine is the
    mean over the observation; there is no settled motion."""
    for force, yields in ((20e3, False), (200e3, True)):
        ds = dataset(1.0, force=force)
        assert (ds.rate_of_penetration.item() > 0) == yields and ds.error_estimate.item() < 1e-6
    sweep = {"scene": "penetration", "parameters": {"pulse_shape": "sweep"}, "grid": {"bias": [60e3]}}
    ds = vj.run_sweep(sweep | {"run": {"settle": 0.5, "observe": 0.5}}, progress=False)
    assert np.isfinite(ds.rate_of_penetration.item()) and np.isnan(ds.error_estimate.item())


# Orbits, stroboscopic at the pulse, against the exact reference and a closed form
FOUND = 0
COLUMNS = ("force", "frequency", "pulse_width", "zeta", "threshold", "k3")
POINTS = {
    "pressed without a pause": (5e3, 200.0, 2e-3, 1.1, 1e7, 300e6),
    "jumps off": (5e3, 100.0, 2e-3, 0.3, 1e7, 300e6),
    "yields, and comes to rest": (200e3, 20.0, 4e-3, 1.1, 150e3, 300e6),
    "yields and jumps off": (300e3, 150.0, 3e-3, 0.2, 150e3, 300e6),
    "never stops to yield": (207e3, 212.0, 3.7e-3, 0.3925, 85e3, 14.2e6),
    "two pulses": (24774.87, 169.046, 2.46e-3, 0.03131, 112879.0, 140.4925e6),
    "two pulses, one of which yields": (98373.2, 54.5255, 8.11e-3, 0.112, 240579.0, 267.12e6),
}


def run_points(**more):
    columns = dict(zip(COLUMNS, map(list, zip(*POINTS.values(), strict=True)), strict=True))
    run = {"orbits": True, "settle": 4.0, "observe": 1.0}
    tables = {"scene": "penetration", "points": columns, "parameters": more, "run": run, "unusual": True}
    return vj.run_sweep(tables, progress=False)


@pytest.fixture(scope="module")
def orbits():
    return run_points()


@pytest.mark.parametrize("name", POINTS)
def test_orbits_agree_with_exact_motion(orbits, name):
    lane, point = orbits.isel(point=list(POINTS).index(name)), dict(zip(COLUMNS, POINTS[name], strict=True))
    assert lane.orbit_reason == FOUND and lane.orbit_residual < 1e-10 and lane.stable == 1
    assert lane.orbit_cycles == (2 if "two" in name else 1)
    begin = np.array([lane.orbit_compression.item(), lane.orbit_v3.item()])
    time = lane.orbit_cycles.item() / point["frequency"]
    end = lambda state: exact.run("penetration", start=state, observe=time, **point).at([time])[0]
    sizes = [max(np.abs(begin).max(), 1e-4) * x for x in (1e-3, 1.0)]  # a bit at rest has none
    np.testing.assert_allclose(end(begin)[:2], begin, rtol=0, atol=1e-9 * sizes[1])
    steps = [1e-5 * size * unit for size, unit in zip(sizes, np.eye(2), strict=True)]
    slopes = [(end(begin + step) - end(begin - step))[:2] / (2 * step.sum()) for step in steps]
    exact_moduli = np.sort(np.abs(np.linalg.eigvals(np.transpose(slopes))))[::-1]
    np.testing.assert_allclose(lane.multiplier_abs, exact_moduli, rtol=0, atol=1e-6)
    np.testing.assert_allclose(lane.rate_of_penetration, end(begin)[2] / time, rtol=1e-8, atol=1e-12)
    if "yield" in name:
        assert lane.rate_of_penetration > 0 and lane.multiplier_abs[1] < 1e-14


def test_multipliers_under_constant_contact_do_not_depend_on_pulses(orbits):
    """The flow is linear throughout, so the multipliers are exp(r/frequency), m1 r² + c3 r + k3 = 0, for any pulse."""
    _, frequency, _, zeta, _, k3 = POINTS["pressed without a pause"]
    expected = np.sort(np.exp(np.roots([M1, 2 * zeta * np.sqrt(M1 * k3), k3]) / frequency))[::-1]
    for dataset in (orbits, run_points(pulse_shape="half-sine")):
        np.testing.assert_allclose(dataset.multiplier_abs[0], expected, rtol=1e-9)


def test_margin_is_the_least_compression_whatever_the_rounding_errors():
    """The next pulse turns the bit before it leaves the rock: its compression is least at the end of a step there."""
    grid = {"threshold": (204.5e3 * (1 + 1e-4 * np.arange(9))).tolist()}
    machine = {"k3": 45e6, "force": 500e3, "frequency": 20.0}
    run = {"orbits": True, "settle": 4.0, "observe": 1.0}
    ds = vj.run_sweep({"scene": "penetration", "parameters": machine, "grid": grid, "run": run}, progress=False)
    np.testing.assert_allclose(ds.grazing_margin, ds.orbit_compression * machine["k3"] / ds.threshold, rtol=2e-5)


# Which pulses are counted and which are refused
def run_pulses(points, **run):
    return vj.run_sweep({"scene": "penetration", "points": points, "run": run}, progress=False)


def test_first_pulse_is_counted():
    """Observed from t = 0 and rest, the first pulses drill as deep as in the trajectory."""
    dataset = run_pulses({"frequency": [20.0, 7.0], "force": [3e5, 2e5]}, settle=0.0, observe=0.52)
    for index, (frequency, force, pulses) in enumerate(((20.0, 3e5, 10), (7.0, 2e5, 3))):
        blows = {"frequency": frequency, "force": force}
        motion = vj.simulate("penetration", duration=0.52, sampling=1e-4, progress=False, **blows)
        depth = np.interp(pulses / frequency, motion.time, motion.x4)
        np.testing.assert_allclose(dataset.slip_per_impact[index], depth / pulses, rtol=1e-6)


def test_rate_is_missing_without_complete_pulse():
    dataset = run_pulses({"frequency": [0.1, 0.2, 20.0]}, settle=1.0, observe=6.0)
    assert np.all(np.isnan(dataset.rate_of_penetration[:2]))
    assert np.isfinite(dataset.rate_of_penetration[2])
    assert np.all(dataset.status == 0)
    dataset = run_pulses({"pulse_width": [0.05, 0.06, 0.0499], "frequency": [20.0] * 3}, settle=0.2, observe=1.0)
    assert names_of(dataset, "reason") == ["pulse-width-not-below-1-over-frequency"] * 2 + ["none"]
    np.testing.assert_array_equal(dataset.status, [2, 2, 0])
    np.testing.assert_array_equal(np.isnan(dataset.rate_of_penetration), [True, True, False])
    with pytest.raises(vj.InputError, match="pulse width not below 1/frequency"):
        vj.simulate("penetration", pulse_width=0.05, frequency=20.0, duration=0.1, progress=False)


# The rate of penetration in the summary of a sweep, or the reason why there is none
BELOW_D = "without a rate, the rock force never reaches the threshold D, at which the rock yields"


def test_summary_lists_range_maximum_and_lanes_without_rate(tmp_path, capsys):
    """Pulses below D do not penetrate. The rate is proportional to the frequency of the pulses."""
    axes = {"force": [30e3, 300e3], "frequency": [10.0, 20.0]}
    run = {"settle": 0.5, "observe": 0.5}
    ds = vj.run_sweep({"scene": "penetration", "run": run, "grid": axes}, progress=False)
    [rates] = [section for section in summarise(ds) if section.name == "rates"]
    least, most = (ds.rate_of_penetration.sel(force=300e3, frequency=f).item() for f in (10.0, 20.0))
    assert most == pytest.approx(2 * least, rel=1e-6)
    assert rates.lines == [
        f"{1e3 * least:.4g} to {1e3 * most:.4g} mm/s ({3600 * least:.4g} to {3600 * most:.4g} m/h) in 2 of 4 lanes",
        "largest at A = 300 kN, f = 20 Hz",
        BELOW_D,
        "the largest force of the pulses there is 30 kN, 0.2 of D; the inertia of the bit takes a part of it",
        "a softer rock (lower threshold) or a larger force can give a rate",
    ]
    facts = {"lanes": 2, "least": least, "greatest": most, "peak_over_threshold": pytest.approx(0.2)}
    assert dict(rates.facts)["rates"] == facts
    vj.write_dataset(ds, tmp_path / "pen.nc")
    assert main(["info", str(tmp_path / "pen.nc"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["rates"]["lanes"] == 2


# Late blows are as exact as the first, also in float32: no state holds the depth
FAST = {"threshold": 150e3, "k3": 20e9, "pulse_width": 3e-4, "zeta": 0.9}
"""A thousand blows per second on a very stiff rock, each a few tens of steps long."""


def fast_blows(name, settle, observe):
    run = {"settle": settle, "observe": observe, "precision": name}
    grid = {"force": [200e3, 300e3], "frequency": [1000.0]}
    return vj.run_sweep({"scene": "penetration", "parameters": FAST, "grid": grid, "run": run}, progress=False)


@pytest.mark.parametrize(("name", "blows", "rtol"), [("float64", 4_000, 1e-12), ("float32", 20_000, 1e-6)])
def test_thousands_of_blows(name, blows, rtol):
    """The slip of forty blows after many blows agrees with that of blows 201 to 240."""
    early, late = fast_blows(name, 0.2, 0.0405), fast_blows(name, blows / 1000, 0.0405)
    assert np.all(early.slip_per_impact > 1e-7)
    np.testing.assert_allclose(late.slip_per_impact, early.slip_per_impact, rtol=rtol)


def test_resistance():
    """N = k3 e, D or 0 (6.2), with its derivatives within each part."""
    for rock, force, gradient in (
        (-1.0, 0.0, (0.0, 0.0, 0.0)),  # off the rock: no tension
        (0.0, 6e4, (K3, 2e-4, 0.0)),  # elastic: k3 e; derivatives by (e, k3, D)
        (1.0, D, (0.0, 0.0, 1.0)),  # yielding: D
    ):
        value, slopes = jax.value_and_grad(resistance, argnums=(0, 1, 2))(2e-4, K3, D, rock)
        assert float(value) == pytest.approx(force, rel=1e-15)
        np.testing.assert_allclose(slopes, gradient, rtol=1e-15)


def test_table_4_5():
    """D [kN], k3 [MN/m], UCS [MPa], E [GPa], density [kg/m³] as printed."""
    printed = {"sandstone": (61.9, 100.68, 84.9, 4.7, 2382), "limestone": (140.3, 175.32, 192.4, 8.2, 2480)}
    printed |= {"granite": (204.5, 224.24, 280.5, 10.5, 2687)}
    read = lambda rock: (rock.threshold / 1e3, rock.k3 / 1e6, rock.ucs / 1e6, rock.modulus / 1e9, rock.density)
    assert {name: pytest.approx(read(rock), rel=1e-12) for name, rock in ROCKS.items()} == printed


def test_rock_as_an_axis():
    """`rock` along the grid gives the same as D and k3 written out, and a harder rock is drilled more slowly."""
    names = ["granite", "sandstone", "limestone"]
    fixed = {"force": 300e3, "zeta": 0.6}
    sweep = {"scene": "penetration", "parameters": fixed, "run": {"settle": 0.3, "observe": 0.2}}
    by_name = vj.run_sweep(sweep | {"grid": {"rock": names}}, progress=False)
    assert by_name.rate_of_penetration.dims == ("rock",)
    assert list(by_name.rock.values) == names
    points = {"threshold": [ROCKS[name].threshold for name in names], "k3": [ROCKS[name].k3 for name in names]}
    by_number = vj.run_sweep(sweep | {"points": points}, progress=False)
    for name in ("rate_of_penetration", "relief", "deepest_gap"):
        np.testing.assert_array_equal(by_name[name].values, by_number[name].values)
    granite, sandstone, limestone = by_name.rate_of_penetration.values
    assert sandstone > limestone > granite > 0
    np.testing.assert_allclose(by_name.relief, by_name.mean_force / points["threshold"], rtol=1e-15)


# The drill on rock: one-way coupling, and feedback

ON_ROCK = {
    "grid": {"gamma": [0.6, 0.7, 0.8], "beta": [0.25, 0.4], "v": [1.0, 2.0]},
    "starts": ["stuck"],
    "run": {"settle": 10.0, "observe": 4.0, "error": 1e-5},
}
DRILL = ("period", "impact_velocity", "impact_phase", "peak_impact_force", "stick_fraction", "bit_amplitude")
DRILL += ("striker_amplitude", "settling_time", "drive_power")


@pytest.fixture(scope="module")
def sweeps():
    scenes = ("vibro-impact", "drilling", "coupled-drilling")
    return {scene: vj.run_sweep(ON_ROCK | {"scene": scene}, progress=False) for scene in scenes}


def test_one_way_coupling_leaves_drill_unchanged(sweeps):
    """The equations for x1 and x2 are the same, so labels and counts are equal. Steps also end on the rock's switches,
    so the other quantities agree to the error of the steps, 1e-8."""
    free, drilling = sweeps["vibro-impact"], sweeps["drilling"]
    assert np.all(free.cycles > 0)
    for name in ("regime", "cycles", "impacts", "returns", "striker_turns", "status", "reason"):
        if name in free:
            np.testing.assert_array_equal(drilling[name], free[name])
    for name in DRILL:
        scale = 1.0 if name in ("stick_fraction", "reverse_fraction", "impact_phase") else free[name].values
        difference = (drilling[name].values - free[name].values) / scale
        assert np.nanmax(np.abs(difference)) < 1e-8, name
    np.testing.assert_allclose(drilling.phase_lag, free.phase_lag, atol=1e-4)
    assert set(drilling.data_vars) > set(free.data_vars)

"""Test calibrations: recovery of known parameters, coverage of standard errors, undetermined parameters, bad input."""

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from drawn import sheet_of
from refusals import refusal
from systems import system

import vibrojax as vj
from vibrojax.cli import main
from vibrojax.compile.xla import precision
from vibrojax.errors import InputError, Place
from vibrojax.maps.read import read_point
from vibrojax.studies import calibrate as run
from vibrojax.studies.analysis import analysis_of
from vibrojax.studies.calibration_estimate import REASONS
from vibrojax.studies.calibration_file import read_calibration
from vibrojax.studies.calibration_history import History
from vibrojax.studies.calibration_model import Model, Prediction

SPEEDS = np.linspace(1.1, 2.0, 6)
TRUE_VALUES = {"mu": 0.4, "v_cr": 3.0}
OBSERVED = ("period", "impact_velocity", "drive_power")
FIXED = {"scene": "vibro-impact", "start": "stuck", "parameters": {"delta": 0.005}}
UNKNOWN = {"mu": [0.25, 0.6], "v_cr": [1.5, 6.0]}


@pytest.fixture(scope="module")
def motion():
    points = {"points": {"v": SPEEDS.tolist()}, "parameters": {"delta": 0.005, **TRUE_VALUES}}
    sweep = {"scene": "vibro-impact", "starts": ["stuck"], "run": {"orbits": True}, **points}
    return vj.run_sweep(sweep, progress=False)


def _runs(motion, noise=0.0):
    factors = 1 + noise * np.random.default_rng(0).standard_normal((len(OBSERVED), len(SPEEDS)))
    return {"v": SPEEDS} | {name: motion[name].values[:, 0] * x for name, x in zip(OBSERVED, factors, strict=True)}


def _calibrated(data, **settings):
    return vj.calibrate({**FIXED, "data": data, "unknown": UNKNOWN, "searches": 1, **settings}, progress=False)


def test_true_parameters_are_recovered_without_noise(motion):
    fit = _calibrated(_runs(motion))
    assert fit.estimate.values == pytest.approx([*TRUE_VALUES.values()], rel=1e-7)
    assert not fit.reason.any() and fit.freedom == 3 * len(SPEEDS) - 2
    assert fit.attrs["kind"] == "calibration"
    ends = [line.split("95 %: ")[1].split(" to ") for line in analysis_of(fit).summary(fit)[0].lines[:2]]
    assert all(low != high for low, high in ends)


def test_period_determines_only_ratio_of_stiffness_and_mass(motion):
    """With friction proportional to m1 g, x1 scales with m1 g/k1 and time with sqrt(m1/k1)."""
    data = {name: _runs(motion, 5e-3)[name] for name in ("v", "period")}
    unknown = {"m1": [150.0, 400.0], "k1": [1e5, 2.5e5]}
    fit = _calibrated(data, unknown=unknown)
    known = fit.direction.values[0]
    assert abs(known[0] + known[1]) < 0.2 and fit.direction_error[0] < 0.02
    assert REASONS[int(fit.reason[0])] == REASONS[int(fit.reason[1])] == "confounded"
    lines = "\n".join(analysis_of(fit).summary(fit)[0].lines)
    assert "the data determine" in lines and "and not the parameters by themselves" in lines
    prior = _calibrated(data, unknown=unknown, prior={"m1": [250.0, 5.0]}, error={"period": 1e-3})
    assert not prior.reason.any() and float(prior.estimate[0]) == pytest.approx(250, abs=15)


def test_estimate_at_a_bound_is_flagged(motion):
    fit = _calibrated(_runs(motion), unknown={"mu": [0.5, 0.6]})
    assert REASONS[int(fit.reason[0])] == "at-bound" and float(fit.estimate[0]) == pytest.approx(0.5, abs=2e-3)
    assert np.isnan([fit.estimate_stderr, fit.estimate_low, fit.estimate_high]).all()
    lines = analysis_of(fit).summary(fit)[0].lines
    assert lines[0] == "μ = 0.5, at its lower bound: no interval follows (at-bound)"
    assert "the data suggest values beyond a bound" in "\n".join(lines)


def test_two_estimates_at_bounds_are_flagged(use_model):
    """With mu held at its bound, the other unknown leaves its own."""
    use_model(np.inf)
    speeds = np.array([0.5, 1.0, 1.5, 2.0])
    fit = _calibrated({"v": speeds, "period": 0.6 * speeds**5.5}, unknown=UNKNOWN | {"mu": [0.25, 0.35]})
    assert fit.reason.values.tolist() == [REASONS.index("at-bound")] * 2


def test_units_of_observations(motion):
    runs = _runs(motion)
    with pytest.raises(InputError, match=r'column period: values such as 229.* in ms, write "period \(ms\)"'):
        _calibrated(runs | {"period": 1e3 * runs["period"]})
    # Columns of a dataset or of a table of arrays may be in any unit.
    read = lambda data: read_calibration({**FIXED, "data": data, "unknown": UNKNOWN})
    table = {name: xr.DataArray(x, dims="row") for name, x in runs.items()}
    table["period"] = (1e3 * table["period"]).assign_attrs(units="ms")
    expected, *values = (read(data).problem.values for data in (runs, table, xr.Dataset(table)))
    np.testing.assert_allclose(values, [expected] * 2, rtol=1e-15)
    with pytest.raises(InputError, match=r"column period: is in mm, not a unit of period \[s\]$"):
        read(table | {"period": table["period"].assign_attrs(units="mm")})


def test_rotation_speed_and_radius_are_conditions(motion):
    """A radius for all rows completes their rotation speeds; a column of either gives the drive speed 2 pi n r/60."""
    data = _runs(motion)
    rpm = {"rpm": data.pop("v") / (2 * np.pi * 0.1) * 60}
    for columns, fixed in ((rpm, {"bit_radius": 0.1}), (rpm | {"bit_radius (mm)": np.full(len(SPEEDS), 100.0)}, {})):
        fit = _calibrated(columns | data, parameters=FIXED["parameters"] | fixed)
        assert fit.estimate.values == pytest.approx([*TRUE_VALUES.values()], rel=1e-7)
    assert "rpm: bit_radius [m] is missing; only both together give v" in refusal(_calibrated, rpm | data)
    in_metres = rpm | {"bit_radius": np.full(len(SPEEDS), 120.0)} | data
    with pytest.warns(vj.UnusualValue) as warned:
        read_calibration({**FIXED, "data": in_metres, "unknown": {"k1": [100.0, 300.0]}})
    lines = [str(each.message).partition(", are far outside")[0] for each in warned]
    assert "calibration: unknown.k1: 2 of 2 values, such as 100 N/m" in lines
    assert lines[-1].endswith("column bit_radius: 6 of 6 values, such as 120 m")


class PowerLaw(Model):
    """Stand-in for the model: the period is mu v**v_cr, with orbits at speeds up to `most`."""

    def __init__(self, spec, theta, row):
        self.v = spec.conditions["v"]

    def predict_all(self, thetas):
        predictions = []
        for mu, exponent in thetas:
            values = mu * self.v**exponent
            slopes = np.stack([values / mu, values * np.log(self.v)], axis=1)[:, None]
            predictions.append(Prediction(values[:, None], slopes, self.v < self.most))
        return predictions


@pytest.fixture
def use_model(monkeypatch):
    """Return a function that replaces the drill by a stand-in: hundreds of fits of the drill would take hours."""
    monkeypatch.setattr(run, "starts", lambda spec: [((spec.low + spec.high) / 2, 0)])
    return lambda most: monkeypatch.setattr(run, "Model", type("Limited", (PowerLaw,), {"most": most}))


def test_intervals_cover_true_parameters_under_proportional_noise(use_model):
    """Of 100 intervals of 95 %, 95 cover the true value, with a standard deviation of 2.2."""
    use_model(np.inf)
    speeds, rng, trials = np.geomspace(0.5, 3.0, 5), np.random.default_rng(3), 100
    truth = np.array([*TRUE_VALUES.values()])
    covered = np.zeros(2)
    for _ in range(trials):
        observed = 0.4 * speeds**3.0 * (1 + 0.05 * rng.standard_normal(len(speeds)))
        fit = _calibrated({"v": speeds, "period": observed}, draws=40)
        covered += (fit.estimate_low.values < truth) & (truth < fit.estimate_high.values)
    assert (np.abs(covered / trials - 0.95) < 0.06).all()
    assert "proportional" in fit.attrs["error_model"] and "3 degrees of freedom" in fit.attrs["error_model"]


def test_rows_without_orbit_are_left_out_and_named_so(use_model):
    use_model(2.5)
    speeds = np.array([0.5, 1.0, 1.5, 2.0, 3.0])
    observed = 0.4 * speeds**3.0 * [1, 1, 1, 1, 5]
    fit = _calibrated({"v": speeds, "period": observed})
    assert fit.used.values.tolist() == [1, 1, 1, 1, 0]
    assert fit.estimate.values == pytest.approx([*TRUE_VALUES.values()], rel=1e-7)
    assert "4 of 5 observations used; the others have no" in "\n".join(analysis_of(fit).summary(fit)[0].lines)
    use_model(0.6)
    with pytest.raises(InputError, match="1 of 5 observations has an orbit of one kind inside the bounds: 1 value for"):
        _calibrated({"v": speeds, "period": observed})


@pytest.mark.long
def test_search_finds_orbits_in_wide_bounds(motion):
    """At most points of these bounds, the drill has no periodic motion with an impact."""
    rows = {name: x[:5] for name, x in _runs(motion).items() if name in ("v", "period")}
    fit = _calibrated(rows, unknown={"mu": [0.05, 2.0], "v_cr": [0.2, 20.0]}, searches=2)
    assert fit.used.all() and fit.estimate.values == pytest.approx([*TRUE_VALUES.values()], rel=1e-6)


def test_command_writes_dataset_and_picture(motion, tmp_path, capsys):
    rows = _runs(motion, 1e-3)
    table = np.column_stack([*rows.values()])
    np.savetxt(tmp_path / "runs.csv", table, delimiter=",", header=",".join(rows), comments="", fmt="%.10g")
    lines = ['scene = "vibro-impact"', 'start = "stuck"', 'data = "runs.csv"', "searches = 1"]
    lines += ["[parameters]", "delta = 0.005", "[unknown]", "mu = [0.25, 0.6]", "v_cr = [1.5, 6.0]"]
    (tmp_path / "drill.toml").write_text("\n".join(lines) + "\n")
    out = tmp_path / "fit.nc"
    assert main(["calibrate", str(tmp_path / "drill.toml"), "-o", str(out), "--json"]) == 0
    printed = capsys.readouterr()
    assert '"combinations"' in printed.out and "1/1 searches, " in printed.err and "searches/s" not in printed.err
    assert out.exists() and out.with_suffix(".png").exists()
    assert main(["explore", str(out), "-o", str(tmp_path / "page.html")]) == 0 and (tmp_path / "page.html").exists()
    again = vj.open_dataset(out)
    rows = sheet_of(again).plots[1].x
    assert rows.label == "line of the file" and [text for _, text in rows.ticks] == ["2", "3", "4", "5", "6", "7"]
    assert again.estimate.values == pytest.approx(_calibrated(_runs(motion, 1e-3)).estimate.values, rel=1e-6)


FRICTION = {"mu": 0.35, "v_cr": 2.5}
WIDE = {"mu": [0.1, 0.8], "v_cr": [1.0, 6.0]}
SAMPLING = 4e-3


def recorded(scene="rotary", duration=0.5, **parameters):
    settings = {"start": "stuck", "duration": duration, "sampling": SAMPLING, "error": 1e-6, "progress": False}
    return vj.simulate(scene, **settings, **FRICTION | parameters)


def from_history(history, **settings):
    about = {"scene": "rotary", "unknown": WIDE, "history": history}
    return vj.calibrate(about | settings, progress=False)


def is_true(fit):
    return fit.estimate.values == pytest.approx([*FRICTION.values()], rel=1e-8) and not fit.reason.any()


@pytest.fixture(scope="module")
def history():
    return recorded(duration=1.0)


def test_derivatives_along_a_history_agree_with_central_differences():
    """The history has several impacts; `start` depends on the unknown speed of the drive."""
    values = {"mu": 0.35, "v_cr": 2.5, "v": 1.5}
    times = np.arange(0.0, 0.8, SAMPLING)
    point = read_point(Place("x"), "vibro-impact", {"delta": 0.005}, "stuck")
    history = History(point, 0.0, times, times, (), np.zeros(0), np.zeros(0))
    theta, step = np.array([[*values.values()]]), 1e-6
    with precision("float64"):
        velocity, slopes = history.predict([*values], theta)
        about = {"start": "stuck", "duration": times[-1], "sampling": SAMPLING, "error": 1e-9, "progress": False}
        motion = vj.simulate("vibro-impact", delta=0.005, **about, **values)
        np.testing.assert_allclose(velocity[0], motion.v1.values[: len(times)], atol=1e-9)
        assert (motion.event_kind == 3).sum() > 1
        for k in range(len(values)):
            up, down = (history.predict([*values], theta + sign * step * np.eye(3)[k])[0][0] for sign in (1, -1))
            np.testing.assert_allclose(slopes[0, :, k], (up - down) / (2 * step), atol=1e-7)


def test_derivatives_along_a_history_resolve_changes_that_move_faster_than_the_motion():
    """Two equal masses move side by side as cos t, and a change of one stiffness by dk makes them swing apart. The
    acceleration of the difference is then -dk cos t - (1 + 2 kc) times the difference, and that of the mean is -dk/2
    cos t minus the mean."""
    fast, times = np.sqrt(201.0), np.linspace(0.0, 3.0, 31)
    pull = lambda y: 100 * (y["x1"] - y["x2"])
    field = lambda t, y, p: {"x1": y["v1"], "v1": -p["k"] * y["x1"] - pull(y), "x2": y["v2"], "v2": pull(y) - y["x2"]}
    pair = system(("x1", "v1", "x2", "v2"), field, parameters={"k": 1.0}, section="x1")
    point = read_point(Place("x"), pair, {}, [1.0, 0.0, 1.0, 0.0])
    with precision("float64"):
        _, slopes = History(point, 0.0, times, times, (), np.zeros(0), np.zeros(0)).predict(["k"], np.array([[1.0]]))
    apart = (np.sin(times) - fast * np.sin(fast * times)) / (fast**2 - 1)
    together = -(np.sin(times) + times * np.cos(times)) / 4
    assert slopes[0, :, 0] == pytest.approx(together + apart / 2, abs=1e-8)


@pytest.mark.parametrize("window", [{"window": [0.0, 0.5], "start": "stuck"}, {"window": [0.5, 1.0]}], ids=len)
def test_friction_is_recovered_from_a_velocity(history, window):
    """The start is known, or fitted."""
    fit = from_history({"data": history[["v1"]], **window})
    assert is_true(fit) and float(fit.nonlinearity) < 0.1
    if "start" not in window:
        first = [history[str(name)].sel(time=0.5).item() for name in fit.state.values]
        assert fit.first_state.values == pytest.approx(first, abs=1e-6)
    assert fit.time.values[[0, -1]] == pytest.approx(window["window"]) and fit.used.all()


def test_friction_is_recovered_through_impacts_beside_rows(motion):
    """The history has impacts, which hide nothing: the motion is that of the whole scene."""
    impacts = recorded("vibro-impact", delta=0.005)
    assert (impacts.impact_force > 0).any()
    drill = {"scene": "vibro-impact", "parameters": {"delta": 0.005}}
    assert is_true(from_history(impacts, **drill))
    rows = {"v": SPEEDS, "period": motion.period.values[:, 0]}
    true = recorded("vibro-impact", delta=0.005, **TRUE_VALUES)
    settings = {"data": rows, "start": "stuck", "searches": 1, "error": {"period": 1e-4, "v1": 1e-2}}
    fit = from_history({"data": true, "v": 1.5}, unknown=UNKNOWN, **drill, **settings)
    assert fit.estimate.values == pytest.approx([*TRUE_VALUES.values()], rel=1e-6)
    assert fit.sizes["observation"] == len(SPEEDS) + len(true.time) and np.isnan(fit.time.values[: len(SPEEDS)]).all()
    period, velocity = fit.predicted.values.T
    assert np.isnan(velocity[: len(SPEEDS)]).all() and np.isnan(period[len(SPEEDS) :]).all()


def test_histories_of_all_forms_are_read(history, tmp_path):
    time, v1 = history.time.values[:100], history.v1.values[:100]
    lines = ["t (ms);note;speed (mm/s)"]
    lines += [f"{1e3 * t:.9f};x;{1e3 * v:.9f}".replace(".", ",") for t, v in zip(time, v1, strict=True)]
    (tmp_path / "a.csv").write_text("\n".join(lines))
    history.isel(time=slice(100)).to_netcdf(tmp_path / "b.nc")
    named = {"data": tmp_path / "a.csv", "columns": {"time": "t (ms)", "v1": "speed (mm/s)"}}
    table, frame = {"time": time, "v1": v1, "note": ["a"] * 100}, pd.DataFrame({"time": time, "v1 (mm/s)": 1e3 * v1})
    for form in (table, frame, named, str(tmp_path / "b.nc")):
        spec = read_calibration({"scene": "rotary", "unknown": WIDE, "history": form})
        np.testing.assert_allclose(spec.problem.history.times, time, rtol=1e-8, atol=1e-12)
        np.testing.assert_allclose(spec.problem.history.velocity, v1, rtol=1e-8, atol=1e-9)


ROWS = {"v": [1.0, 1.5], "period": [0.23, 0.23]}
PRIOR = {"unknown": {"k1": [1e5, 3e5]}, "error": {"period": 1e-3}, "prior": {"k1": [170.0, 10.0]}}
IN_MS = {"history": {"time": np.arange(0.0, 1000.0, 2.0), "v1": np.zeros(500)}}
REFUSED = {
    "unknown: missing": {"unknown": {}},
    "column perid: is neither a parameter": {"data": {"v": [1.0], "perid": [0.2]}},
    "column period: has 1 negative value, first in row 0": {"data": {"v": [1.0, 1.5], "period": [-999.25, 0.2]}},
    "prior.k1: the mean 170 N/m is outside the bounds, 100000 to 300000 N/m; correct its unit, or widen": PRIOR,
    "2 values for 2 unknown parameters and the size of the noise; add rows": {},
    "v1: missing; columns time [s] and v1 [m/s] are needed": {"history": {"data": {"time": [0.0, 1.0]}}},
    "time: does not rise from sample to sample": {"history": {"data": {"time": [0.0, 2.0, 1.0], "v1": [0.0] * 3}}},
    'more than half a period of the bit (0.251 s); if it is in ms, write "time (ms)"': IN_MS,
}


@pytest.mark.parametrize("line", REFUSED)
def test_bad_input_is_refused_in_one_line(line):
    of_rows = {**FIXED, "data": ROWS, "unknown": UNKNOWN}
    settings = {"scene": "rotary", "unknown": WIDE} if "history" in REFUSED[line] else of_rows
    assert line in refusal(read_calibration, settings | REFUSED[line])


def test_observed_impact_velocities_are_converted_to_the_unit_of_the_system():
    wall = vj.Impact("wall", gap=lambda t, y, p: p["d"] - y["x"], velocity="v", restitution=0.7)
    field = lambda t, y, p: {"x": y["v"], "v": p["a"] * vj.elementary.cos(t) - 0.1 * y["v"]}
    about = {"states": {"x": "mm", "v": "mm s-1"}, "parameters": {"a": 1.0, "d": 1.0}, "period": 2 * np.pi}
    known = {"scene": vj.System("small", field=field, events=[wall], **about), "unknown": {"d": [0.5, 1.5]}}
    for name, value in (("impact_velocity (m/s)", 7e-4), ("impact_velocity (mm/s)", 0.7), ("impact_velocity", 0.7)):
        read = read_calibration(known | {"data": {"a": [0.5], name: [value]}, "error": {"impact_velocity": 0.01}})
        assert read.problem.values.item() == pytest.approx(0.7, rel=1e-15)


def squared_distance(fit, truth):
    """Return the squared distance from the truth in standard errors, chi-squared with two degrees of freedom."""
    stderr, deviation = fit.estimate_stderr.values, fit.estimate.values - [*truth.values()]
    return deviation @ np.linalg.solve(fit.correlation.values * np.outer(stderr, stderr), deviation)


@pytest.mark.long
def test_standard_errors_cover_true_parameters(motion):
    rng, exact = np.random.default_rng(1), _runs(motion)
    errors = {name: 2e-3 * float(np.abs(motion[name]).mean()) for name in OBSERVED}
    distances = []
    for _ in range(10):
        noisy = {name: exact[name] + error * rng.standard_normal(len(SPEEDS)) for name, error in errors.items()}
        distances.append(squared_distance(_calibrated({"v": SPEEDS} | noisy, error=errors, draws=2), TRUE_VALUES))
    # The mean is 2 and its standard error is sqrt(4/10). The test allows four standard errors.
    assert abs(np.mean(distances) - 2) < 4 * np.sqrt(4 / 10)


@pytest.mark.long
def test_standard_errors_of_a_noisy_velocity_cover_the_truth(history):
    rng, noise, distances = np.random.default_rng(20260102), 0.005, []
    for _ in range(20):
        noisy = history[["v1"]].assign(v1=history.v1 + noise * rng.standard_normal(history.sizes["time"]))
        fit = from_history({"data": noisy, "window": [0.0, 0.5], "start": "stuck"}, searches=1, draws=2)
        assert float(fit.noise) * np.sqrt(np.mean(fit.observed.values**2)) == pytest.approx(noise, rel=0.3)
        distances.append(squared_distance(fit, FRICTION))
    # The mean is 2 and its standard error is sqrt(4/20). The test allows four standard errors.
    assert abs(np.mean(distances) - 2) < 4 * np.sqrt(4 / 20)


@pytest.mark.long
def test_law_without_a_rate_at_any_observation_is_refused():
    """Blows whose mean force stays below the threshold penetrate, but C ln(P/D) is negative there."""
    data = {"v (m/s)": [1.3, 1.7], "beta": [0.5, 0.5], "rate_of_penetration (mm/s)": [0.4, 1.6]}
    about = {"scene": "drilling", "start": "stuck", "searches": 1, "parameters": {"rock": "sandstone"}, "data": data}
    with pytest.raises(vj.InputError, match=r"the law C ln\(P/D\) gives no rate up to P/D = 1"):
        vj.calibrate(about | {"unknown": {"C": [1e-4, 0.1]}, "error": {"rate_of_penetration": 1e-4}}, progress=False)

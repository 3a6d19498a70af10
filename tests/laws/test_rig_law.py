"""Test the law that a rig log supports: trials of known laws in correlated noise, segments, and unknown thresholds."""

import json
import sys
import warnings
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from unchecked import unchecked

import vibrojax as vj
from vibrojax.cli import main
from vibrojax.errors import InputError
from vibrojax.studies.rop_blocks import (
    LEAST_ROWS,
    STANDINGS,
    Standing,
    block_covariance,
    prediction_errors,
    segments,
)
from vibrojax.studies.rop_forms import FORMS
from vibrojax.studies.rop_law import fit_rop
from vibrojax.studies.rop_least_squares import LinearRates
from vibrojax.studies.rop_results import recommended, verdict

sys.path.insert(0, str(Path(__file__).parents[2] / "notebooks"))
import rig_logs

pytestmark = pytest.mark.filterwarnings("ignore:.*semicolons separate the columns:UserWarning")
fit_quietly = partial(fit_rop, progress=False)
TRIALS, ROWS, CORRELATION = 200, 400, 0.7
C, ETA0, EXPONENT, D = (rig_logs.PLANTED[name] for name in ("C", "eta0", "exponent", "threshold"))
TRUTH = {"C": C, "eta0": ETA0, "exponent": EXPONENT}
COEFFICIENTS = {"onset": ("C", "eta0"), "line": ("C", "eta0"), "power": ("C", "exponent")}
NAMES = [form.name for form in FORMS]


def trial_data(law, noise, low=60e3, high=180e3, count=TRIALS, seed=20261124):
    """Return `count` logs of 400 rows that follow `law`; noise is relative to the mean rate."""
    rng = np.random.default_rng(seed)
    eta = rig_logs.weights((count, ROWS), rng, low, high) / D + (law == "literal")
    rate = rig_logs.LAWS[law](eta, C, ETA0, EXPONENT)
    rate = rate + noise * rate.mean() * rig_logs.correlated(rate.shape, CORRELATION, rng)
    variables = {"relief": eta, "rate_of_penetration": np.maximum(rate, 0.0)}
    dims = ("trial", "point")
    return xr.Dataset({name: (dims, values) for name, values in variables.items()}, attrs={"dialect": "generic"})


def trials(*planted, **more):
    """Return the fits of `trial_data`."""
    data = trial_data(*planted, **more)
    with unchecked():
        return fit_quietly(data)


@pytest.mark.parametrize("law", NAMES)
def test_known_laws_are_recovered_and_chosen(law):
    """Use 200 logs of 400 rows, with 3 % noise whose neighbours have a correlation of 0.7."""
    fit = trials(law, 0.03)
    form = fit.sel(form=law)
    for name in COEFFICIENTS.get(law, ("C",)):
        covered = abs(form[name] - TRUTH[name]) <= 2 * form[f"{name}_stderr"]
        assert covered.mean() >= 0.95, (name, float(covered.mean()))
        spread = form[name].std(ddof=1)  # the errors match the spread of the trials, they are not merely wide
        assert 0.8 <= np.sqrt((form[f"{name}_stderr"] ** 2).mean()) / spread <= 1.3
    chosen = (fit.standing == Standing.CHOSEN).sel(form=law)
    assert chosen.mean() >= 0.9, float(chosen.mean())
    wrong = ~chosen & ~(fit.standing == Standing.UNDECIDED).any("form")
    assert wrong.mean() <= 0.05
    assert ((fit.standing == Standing.CHOSEN).sum("form") == 1).all()


@pytest.mark.parametrize("law", ["onset", "line", "power"])
def test_forms_that_differ_by_less_than_noise_are_undecided(law):
    """Between 110 and 130 kN, the three forms agree within 0.5 %; the noise is 5 %."""
    fit = trials(law, 0.05, 110e3, 130e3, count=60)
    eta = np.linspace(110e3, 130e3, 50) / D
    line = np.polyval(np.polyfit(eta, rig_logs.LAWS[law](eta, C, ETA0, EXPONENT), 1), eta)
    assert abs(line / rig_logs.LAWS[law](eta, C, ETA0, EXPONENT) - 1).max() < 0.005
    standing = fit.standing.sel(form=["onset", "line", "power"])
    undecided = (standing >= Standing.UNDECIDED).all("form")
    assert undecided.mean() >= 0.9, float(undecided.mean())
    verdicts = verdict(fit.isel(trial=slice(10)))
    assert sum("these data cannot tell" in text for text in verdicts) >= 9


def test_errors_without_blocks_are_too_small():
    """Errors that treat rows as independent cover the truth far too rarely, which is why blocks are used."""
    fit = trials("onset", 0.03, count=40)
    plain = fit_quietly(trial_data("onset", 0.03, count=40).drop_attrs())
    form = plain.sel(form="onset")
    assert (abs(form.C - C) <= 2 * form.C_stderr).mean() < 0.8
    np.testing.assert_allclose(form.C, fit.sel(form="onset").C, rtol=1e-12)
    assert (plain.standing == Standing.NOT_COMPARED).all() and plain.cv_error.isnull().all()


def test_one_newton_step_is_exact_for_linear_forms():
    """Check the omission of each block, and the bootstrap covariance for blocks of one row."""
    rng = np.random.default_rng(5)
    x = np.column_stack([np.ones(120), rng.standard_normal(120)])
    y = x @ [1.0, 0.5] + 0.1 * rng.standard_normal(120)
    theta, *_ = np.linalg.lstsq(x, y)
    block = np.arange(120) // 20
    errors = prediction_errors(LinearRates(x), theta, y, np.zeros(120, bool), block)
    for index in range(6):
        kept = block != index
        without, *_ = np.linalg.lstsq(x[kept], y[kept])
        assert errors[index] == pytest.approx(np.mean((y - x @ without)[~kept] ** 2), rel=1e-9)
    residual = x @ theta - y
    usual = np.linalg.inv(x.T @ x) * (residual @ residual) / 118
    np.testing.assert_allclose(np.diag(block_covariance(x, residual)), np.diag(usual), rtol=0.35)


# files


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    return rig_logs.write_all(tmp_path_factory.mktemp("logs"))


def test_all_dialects_give_the_same_fit(logs):
    columns = {"rock": "granite"}
    fits = {name: fit_quietly(path, columns=columns) for name, path in logs.items()}
    first = fits.pop("pason")
    assert len(fits) >= 5 and first.used.values[0] == 400
    for fit in fits.values():
        for name in ("C", "C_stderr", "eta0", "eta0_stderr", "exponent", "r_squared", "aic", "cv_error"):
            np.testing.assert_allclose(fit[name], first[name], rtol=1e-9, atol=1e-14, err_msg=name)
        assert (fit.standing == first.standing).all()


def test_log_of_7310_rows(tmp_path):
    """`tests/benchmarks/rig_log.py` measures its time."""
    path = rig_logs.write(tmp_path / "long.csv", "pason-processed", rig_logs.with_traps(rig_logs.drilling(7304))[0])
    fit = fit_quietly(path)
    assert fit.rows_read == 7310
    assert float(fit.standing.sel(form="onset")) == Standing.CHOSEN


def test_recommended_constant_is_in_unit_of_log(logs):
    fit = fit_quietly(logs["pason"], columns={"rock": "granite"})
    [choice] = recommended(fit)
    assert choice["form"] == "onset" and choice["low"] < C < choice["high"] and choice["unit"] == "ft_per_hr"
    assert choice["in_unit"]["C"] == pytest.approx(choice["C"] * 3600 / 0.3048)
    error = float(fit.C_stderr.sel(form="onset"))
    assert choice["high"] - choice["low"] == pytest.approx(2 * 1.966 * error, rel=1e-3)


def test_unknown_threshold_keeps_determined_quantities(logs):
    known = fit_quietly(logs["rigcloud"], columns={"threshold": f"{D} N"})
    for columns in ({}, {"threshold": "unknown"}):
        fit = fit_quietly(logs["rigcloud"], columns=columns)
        for name in ("literal", "percent"):
            assert fit.reason.attrs["flag_meanings"].split()[int(fit.reason.sel(form=name))] == "unknown-threshold"
        onset = fit.sel(form="onset")
        assert float(onset.C) == pytest.approx(float(known.C.sel(form="onset")), rel=1e-9)
        assert float(onset.onset_force) == pytest.approx(float(known.eta0.sel(form="onset")) * D, rel=1e-9)
        error = float(onset.onset_force_stderr)
        assert error == pytest.approx(float(known.eta0_stderr.sel(form="onset")) * D, rel=1e-6)
        assert abs(float(onset.onset_force) - ETA0 * D) < 3 * error
        slope = float(fit.C.sel(form="line")) / fit.reference_force
        assert slope == pytest.approx(float(known.C.sel(form="line")) / D, rel=1e-9)
        text = "\n".join(verdict(fit))
        assert "the threshold D is unknown" in text and f"line C/D = {1e3 * slope:.4g} m/s per kN" in text
    with pytest.raises(InputError, match=r"threshold: is unknown, but .* has a threshold or relief; give one"):
        path = logs["rigcloud"].with_name("relief.csv")
        path.write_text("relief,rate_of_penetration\n1,1e-3\n")
        fit_quietly(path, columns={"threshold": "unknown"})


def layers(path, planted=(6e-3, 3.5e-3, 7e-3), noise=0.05):
    """Write a log through three formations of 200 rows, each with its own C, and return its path."""
    rows = rig_logs.drilling(600, noise=0.0)
    rows["formation"] = np.repeat(["a", "b", "c"], 200)
    noisy = noise * correlated_noise(600) * rows["rate"].mean()
    rows["rate"] = np.maximum(rows["rate"] * np.repeat(planted, 200) / C + noisy, 0)
    return rig_logs.write(path, "usrop", rows)


def correlated_noise(count):
    return rig_logs.correlated((count,), CORRELATION, np.random.default_rng(9))


def test_formations_are_separated_by_column_or_by_segmentation(tmp_path):
    path, columns = layers(tmp_path / "layers.csv"), {"rock": "granite"}
    named = fit_quietly(path, by="Formation", columns=columns).sel(form="onset")
    segmented = fit_quietly(path, segments=True, columns=columns).sel(form="onset")
    assert list(named.Formation.values) == ["a", "b", "c"] and list(segmented.segment.values) == [0, 1, 2]
    np.testing.assert_allclose(segmented.depth_from, named.depth_from, atol=3.0)  # of 10 rows of 0.3 m
    for fit in (named, segmented):
        assert (abs(fit.C - [6e-3, 3.5e-3, 7e-3]) < 3 * fit.C_stderr).all()
        assert (fit.depth_to[:-1].values < fit.depth_from[1:].values).all()
    with pytest.raises(InputError, match="segments: makes the groups; leave out along and by"):
        fit_quietly(path, segments=True, by="Formation")
    with pytest.raises(InputError, match="segments: is for the rows of a log; leave out segments"):
        fit_quietly(trial_data("onset", 0.03, count=2).drop_attrs(), segments=True)


def test_segments_change_only_with_the_law():
    rng = np.random.default_rng(3)
    correct_single, correct_three = 0, 0
    for _ in range(20):
        eta = rig_logs.weights((600,), rng) / D
        law = rig_logs.LAWS["onset"](eta, C, ETA0, 0)
        noise = 0.05 * law.mean() * rig_logs.correlated((600,), CORRELATION, rng)
        correct_single += segments(eta, np.maximum(law + noise, 0)).max() == 0
        changes = np.flatnonzero(np.diff(segments(eta, np.maximum(law * np.repeat([1, 0.6, 1.2], 200) + noise, 0)))) + 1
        correct_three += changes.size == 2 and bool((abs(changes - [200, 400]) <= 10).all())
    assert correct_single >= 19 and correct_three >= 19
    assert segments(np.ones(20), np.ones(20)).max() == 0 and segments(np.ones(200), np.zeros(200)).max() == 0


def test_few_rows_are_compared_only_by_aic(tmp_path):
    few = rig_logs.write(tmp_path / "few.csv", "witsml", rig_logs.drilling(LEAST_ROWS - 1))
    fit = fit_quietly(few, columns={"rock": "granite"})
    assert (fit.standing == Standing.NOT_COMPARED).all() and fit.cv_error.isnull().all()
    assert any("lowest AIC" in line for line in verdict(fit))


def test_picture_shows_only_forms_that_are_not_rejected(tmp_path):
    rows = rig_logs.drilling(noise=0.01, law="line")
    fit = fit_quietly(rig_logs.write(tmp_path / "line.csv", "usrop", rows), columns={"rock": "granite"})
    figure = vj.picture(fit)
    data, coefficient, _ = figure.axes
    assert [text.get_text() for text in coefficient.get_xticklabels()] == ["line"]
    assert len(data.collections) == 1  # the band of the line only
    assert "not percussive data" in " ".join(text.get_text().replace("\n", " ") for text in figure.texts)


# the command


def test_command_reports_rows_and_chosen_form(logs, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["fit", str(logs["las"]), "--columns", "rock=granite"]) == 0
    out = capsys.readouterr().out
    assert out.startswith("dialect las: it begins with a section of LAS\n")
    assert "dropped 6 of 406 rows:\n" in out and "  no rotation: 1 (line " in out
    assert "CV [m/s]" in out and ("these data cannot tell onset from" in out or "the data support onset" in out)
    assert "recommended C (95 % interval, by a bootstrap of blocks)" in out and "M/HR" in out
    assert "Rotary rig data are not percussive data" in out and "las-fit.nc; picture las-fit.png" in out
    stored = vj.open_dataset("las-fit.nc")
    assert stored.standing.attrs["flag_meanings"].split() == list(STANDINGS) and stored.dialect == "las"
    assert main(["info", "las-fit.nc"]) == 0 and "dialect las" in capsys.readouterr().out
    words = ["fit", str(logs["semicolon"]), "--dialect", "generic", "--segments", "--json", "-o", "s.nc"]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert main(words) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["dialect"] == "generic" and facts["detected"] == "as the user says" and facts["rows_read"] == 406
    assert facts["dropped"]["missing weight"]["rows"] == 2 and facts["groups"][0]["coordinates"]["segment"] == 0
    assert main(["fit", str(logs["pason"]), "--fastest", "3000 ft/h", "-o", "p.nc"]) == 0
    assert "dropped 5 of 406 rows" in capsys.readouterr().out
    assert main(["fit", str(logs["pason"]), "--dialect", "pasn"]) == 2
    assert 'dialect: "pasn" is unknown; did you mean "pason"?' in capsys.readouterr().err

"""Test the law that a rig log supports: trials of known laws in correlated noise, founder weights, and wrong rows."""

import json

import numpy as np
import pandas as pd
import pytest
from drawn import sheet_of
from trials import CASES, FORMATIONS, FOUNDER, rig_logs, rows, trials, unchecked

from vibrojax.cli import main
from vibrojax.errors import InputError
from vibrojax.studies.rop_forms import BLOCK_LIMIT, FORMS, Standing, search, standings, supported, whiten
from vibrojax.studies.rop_group import FAR_RATE, NAMES, clean, find_founder, fit_lanes, predictions_without
from vibrojax.studies.rop_law import fit_rop
from vibrojax.studies.rop_results import verdict

C, ETA0, D = (rig_logs.PLANTED[name] for name in ("C", "eta0", "threshold"))


def fit_quietly(data, **more):
    return fit_rop(data, progress=False, **more)


@pytest.mark.parametrize("case", ["D unknown, falls", "literal, no founder"])
def test_planted_laws_are_recovered(case):
    right, wrong, of_c, _, of_founder = trials(8, **CASES[case])
    assert right >= 0.75 and wrong == 0 and of_c >= 0.8 and of_founder >= 0.9


@pytest.mark.long
@pytest.mark.parametrize("case", CASES)
def test_many_planted_laws_are_recovered(case):
    """Form and C within two standard errors are right in 92 % of formations; 200 trials scatter by 1 %."""
    right, wrong, of_c, both, of_founder = trials(200, **CASES[case])
    assert wrong <= 0.01 and of_c >= 0.93 and of_founder >= 0.93 and both >= 0.92 and right >= 0.92


def test_errors_of_short_logs_allow_for_correlated_noise():
    """Without it, two standard errors hold the truth in 70 % of logs with 40 rows."""
    rng, held = np.random.default_rng(1), 0
    with unchecked():
        for _ in range(30):
            rate = 1 + 0.05 * rig_logs.correlated((40,), 0.7, rng)
            form = fit_lanes(weight := rng.uniform(0.5, 2, 40), weight, rate).forms.loc["constant"]
            held += abs(form["C"] - 1) <= 2 * form["C_stderr"]
    assert held >= 26


def test_true_law_of_a_table_sorted_by_weight_is_not_rejected():
    """By contiguous blocks, 6 to 12 of 100 such tables rejected the law of their rates."""
    weight, rejected = np.linspace(70.0, 180.0, 60), 0
    with unchecked():
        for seed in range(5000, 5100):
            rate = 6 * (weight / 150 - 0.2) + 0.5 * np.random.default_rng(seed).standard_normal(60)
            rejected += fit_lanes(weight / 150, weight, rate).forms.loc["line", "standing"] == Standing.REJECTED
    assert rejected <= 5


def test_few_weights_determine_a_law():
    """All rows below a founder weight may then have the same weight."""
    for few in ([50.0, 80.0], [20.0, 40.0, 60.0]):
        weight = np.random.default_rng(15).permutation(np.repeat(few, 120 // len(few)))
        form = fit_lanes(weight, weight, np.log(weight / 10)).forms.loc["onset"]
        assert (form["C"], form["eta0"]) == pytest.approx((1.0, 10.0), rel=1e-6)


def test_founder_leaves_rows_below_it_whatever_its_error():
    """The rows below the founder weight are within its error."""
    rng = np.random.default_rng(0)
    weight = rng.permutation([*rng.uniform(101, 105, 17), *rng.uniform(142, 146, 22)])
    rate = np.log(np.minimum(weight, 108) / 34) * (1 - 0.9 * np.maximum(weight / 108 - 1, 0))
    fit = fit_lanes(weight / 105, weight, rate * (1 + 0.02 * rig_logs.correlated((39,), 0.3, rng)))
    assert fit.founder.end < weight.min() and fit.forms["used"].iloc[0] >= 8


def test_founder_of_a_long_log_is_that_of_a_part_of_its_rows():
    rng = np.random.default_rng(3)
    weight, row = rng.uniform(60e3, 180e3, 21_000), np.arange(21_000)
    rate = np.log(np.minimum(weight, 150e3) / 30e3) + 0.05 * rng.standard_normal(21_000)
    founder, residual = find_founder(weight / 1e5, weight, rate, row)
    assert abs(founder.weight - 150e3) <= 3 * founder.weight_stderr < 3e3
    assert residual.shape == weight.shape and residual.std() == pytest.approx(0.05 / rate.max(), rel=0.02)


def test_noise_below_the_onset_bends_no_fit():
    """The rate sensor's noise is positive where nothing penetrates; C = 0.006 m/s and eta0 = 0.3 are planted."""
    for seed in range(2):
        rng = np.random.default_rng(seed)
        weight = rng.uniform(35.0, 150.0, 220)
        rate = np.maximum(np.maximum(0.006 * np.log(weight / 45.0), 0.0) + 3e-4 * rng.standard_normal(220), 0.0)
        fit = fit_quietly(log(1e3 * weight, rate), columns={"threshold": "150 kN"}).sel(form="onset")
        assert fit.attrs["verdict"] == "onset" and np.isnan(fit.founder_weight)
        assert abs(float(fit.C) - 0.006) < 3 * float(fit.C_stderr) and abs(float(fit.eta0) - 0.3) < 0.01


def test_leaving_out_a_block_is_exact_for_linear_forms():
    """The rates of a block, predicted from the other rows, are those of a fit without it, with correlated noise too."""
    rng = np.random.default_rng(5)
    relief, rate = np.exp(rng.uniform(0, 1, 120)), 1 + 0.2 * rng.standard_normal(120)
    block, decay = np.arange(120) // 20, np.array([0.0, *[0.6] * 119])
    minimum = search(FORMS[2], relief, rate, False, decay)
    residual, x = predictions_without(minimum, rate / rate.max(), block), FORMS[2].columns(relief)
    for index in range(6):
        kept = block != index
        without, *_ = np.linalg.lstsq(whiten(x, decay)[kept], whiten(rate / rate.max(), decay)[kept])
        np.testing.assert_allclose(residual[~kept], (x @ without - rate / rate.max())[~kept], rtol=1e-6)


def log(weight, rate):
    """Return a table in the units of drillers."""
    depth = 1000 + 0.5 * np.arange(weight.size)
    return pd.DataFrame({"Depth (m)": depth, "ROP (m/h)": 3600 * rate, "WOB (kN)": weight / 1e3})


def test_founder_is_told_by_formation():
    """Coefficients are of the rows below the founder weight, whose rates alone follow the law."""
    rng = np.random.default_rng(8)
    weight, rate = np.hstack([rows(rng, *formation, count=500) for formation in FORMATIONS])
    fit = fit_quietly(log(weight, rate).assign(Formation=["a"] * 500 + ["b"] * 500), by="Formation")
    onset = fit.sel(form="onset")
    assert fit.attrs["verdict"] in ("onset", "none")
    for values, errors, planted in (
        (fit.founder_weight, fit.founder_weight_stderr, FOUNDER),
        (onset.C, onset.C_stderr, [C for C, _ in FORMATIONS]),
        (onset.onset_force, onset.onset_force_stderr, [D for _, D in FORMATIONS]),
    ):
        assert (abs(values - planted) < 3 * errors).all()
    assert (fit.used + fit.left_out == 500).all() and (fit.data_use == 4).any("lane").all()
    greatest = fit.data_relief.where(fit.data_use.isin([1, 2])).max("lane") * fit.data_threshold
    assert not (greatest > fit.founder_weight).any()
    text = "\n".join(verdict(fit))
    assert text.count("above it the rate falls by") == 2 and "left out, rate far from the law" in text
    panel = sheet_of(fit).plots[0]
    assert [layer.x[0] for layer in panel.layers if layer.label == "founder weight"] == pytest.approx([160], rel=0.05)
    # With thresholds that differ within a group, the axis is the relief, on which a weight [N] has no place.
    varying = fit.assign(data_threshold=np.nan * fit.data_threshold, founder_weight=0 * fit.founder_weight + 1e3)
    assert not any(layer.label == "founder weight" for layer in sheet_of(varying).plots[0].layers)


def test_error_of_a_founder_with_few_rows_above_it_holds_the_truth():
    """Of 12 founder weights with 12 of 400 rows above, all but one or two are within two standard errors."""
    rng, held = np.random.default_rng(4), 0
    for _ in range(12):
        weight = rng.permutation([*rng.uniform(60e3, 150e3, 388), *rng.uniform(150e3, 175e3, 12)])
        rate = np.log(np.minimum(weight, 150e3) / 30e3)
        noisy = rate + 0.03 * rate.mean() * rig_logs.correlated((400,), 0.9, rng)
        founder, _ = find_founder(weight / 1e5, weight, noisy, np.arange(400))
        held += abs(founder.weight - 150e3) <= 2 * founder.weight_stderr
    assert held >= 10


@pytest.mark.parametrize("exponent", [None, 0.5, 1.0])
def test_concave_law_has_no_founder(exponent):
    """A logarithm and a root bend as well, but no form with a founder describes them better; a line has none."""
    weight = np.random.default_rng(1).uniform(50e3, 150e3, 400)
    rate = np.log(weight / 30e3) if exponent is None else weight**exponent
    for noise in (0.0, 0.02):
        noisy = rate * (1 + noise * np.random.default_rng(2).standard_normal(400))
        assert not find_founder(weight / 1e5, weight, noisy, np.arange(400))[0].is_known
    bent = np.minimum(rate, rate[np.argmin(abs(weight - 12e4))])
    founder, _ = find_founder(weight / 1e5, weight, bent, np.arange(400))
    assert founder.weight == pytest.approx(12e4, rel=0.01) and not founder.falls


def test_wrong_rates_are_found_about_the_law_that_ends_at_the_founder():
    """Both are hidden from a law without a founder: a row of the greatest weight, and small outliers."""
    weight, rate = rows(np.random.default_rng(3), *FORMATIONS[0], fall=0.0, outliers=0.0)
    planted = sorted([int(np.argmax(weight)), *np.argsort(weight)[[5, 60, 100]].tolist()])
    rate[planted] *= [0.1 if weight[row] == weight.max() else 1.4 for row in planted]
    founder, wrong = clean(weight / 40e3, weight, rate)
    assert np.flatnonzero(wrong[FAR_RATE]).tolist() == planted
    assert founder.weight == pytest.approx(FOUNDER, abs=3 * founder.weight_stderr) and founder.weight_stderr < 8e3


@pytest.mark.parametrize("spike", [400.0, 0.4])
def test_one_wrong_weight_does_not_decide(spike):
    n, rng = 60, np.random.default_rng(7)
    weight = 40 + 90 * ((np.arange(n) * 7) % n) / n
    rate = (6 + 22 * np.log(weight / 30)) * (1 + 0.01 * rng.standard_normal(n))
    weight[9] = spike
    fit = fit_quietly(log(1e3 * weight, rate / 3600))
    onset = fit.sel(form="onset")
    assert fit.attrs["verdict"] == "onset" and float(onset.C) == pytest.approx(22 / 3600, rel=0.02)
    assert np.isnan(fit.founder_weight)
    dropped = fit.attrs["dropped"] + fit.attrs.get("left_out_rows", "")
    assert '"lines": "11"' in dropped  # of the file: the tenth row below the names


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    return rig_logs.write_all(tmp_path_factory.mktemp("logs"))


def test_unknown_threshold_keeps_determined_quantities(logs):
    known = fit_quietly(logs["rigcloud"], columns={"threshold": f"{D} N"})
    assert known.attrs["verdict"] == "onset" and np.isnan(known.founder_weight)  # as the page on rig logs says
    fit = fit_quietly(logs["rigcloud"], columns={"threshold": "unknown"})
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


def test_command_reports_rows_and_chosen_form(logs, here, capsys):
    assert main(["fit", str(logs["las"]), "--columns", "rock=granite"]) == 0
    out = capsys.readouterr().out
    assert "dropped 6 of 406 rows:\n" in out and "  no rotation: 1 (line " in out
    assert "recommended C (95 % interval, by blocks of rows)" in out
    assert "Rotary rig data are not percussive data" in out and "las-fit.nc; picture las-fit.png" in out
    assert "a lane: a row of las.las" in out
    (here / "las.csv").write_text(logs["pason"].read_text())  # another file, whose result has a name of its own
    assert main(["fit", "las.csv"]) == 0 and "las-csv-fit.nc; picture las-csv-fit.png" in capsys.readouterr().out
    (here / "las.csv").write_text(logs["semicolon"].read_text())
    assert main(["fit", "las.csv"]) == 2
    assert "another result: that of another las.csv, or before its change; --fresh" in capsys.readouterr().err
    assert main(["info", "las-fit.nc"]) == 0 and "dropped 6 of 406 rows" in capsys.readouterr().out
    assert main(["fit", str(logs["semicolon"]), "--by", "Formation", "--json", "-o", "s.nc"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["dropped"]["missing weight"]["rows"] == 2 and facts["groups"][0]["coordinates"]["Formation"] == "upper"
    assert facts["supported"] in ("onset", "none") and facts["groups"][0]["founder_weight"] is None


def test_forms_that_differ_by_less_than_noise_are_undecided():
    """Between 110 and 130 kN, onset, line and power agree within 0.5 %; the noise is 5 %."""
    rng = np.random.default_rng(2)
    weight = rig_logs.weights((400,), rng, 110e3, 130e3)
    rate = rig_logs.LAWS["onset"](weight / D, C, ETA0, 0)
    rate = rate * (1 + 0.05 * rig_logs.correlated((400,), 0.7, rng))
    fit = fit_quietly(log(weight, rate))
    assert (fit.standing.sel(form=["onset", "line", "power"]) >= Standing.UNDECIDED).all()
    assert fit.attrs["verdict"] == "none" and any("these data cannot tell" in line for line in verdict(fit))


def test_verdict_claims_no_support_where_no_form_is_rejected():
    """With a threshold that is unknown, every other form contains the constant."""
    weight, noise = np.tile([50e3, 60e3, 70e3, 80e3, 90e3], 8), np.tile([1.0, -1.0, -1.0, 1.0], 10)
    text = "\n".join(verdict(fit_quietly(log(weight, 5e-3 * (1 + 0.02 * noise)))))
    assert "these data reject no form, of which constant has the fewest coefficients" in text


@pytest.mark.parametrize(("groups", "expected"), [(1, "onset"), (2, "none"), (8, "none")])
def test_special_case_needs_more_evidence_against_it_in_one_of_several_groups(groups, expected):
    """An evidence of 9 against `literal` is beyond chance in one group, but not in one of two."""
    evidence = np.full((groups, 6), 100.0)
    evidence[:, NAMES.index("literal")], evidence[:, NAMES.index("onset")] = 0.1, 0.0
    evidence[0, NAMES.index("literal")] = 9.0
    standing = np.array([standings(row, NAMES, BLOCK_LIMIT) for row in evidence])
    assert supported(standing, evidence, NAMES, BLOCK_LIMIT) == expected
    assert standings(np.array([8.0, 100, 0, 100, 100, 100]), NAMES, BLOCK_LIMIT).tolist() == [2, 1, 4, 1, 1, 1]

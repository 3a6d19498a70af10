"""Test the study of speed against error: errors shrink with the tolerance, failures are kept, the front is correct."""

import numpy as np
import pytest
from refusals import command_refusal, refusal

from vibrojax.studies.accuracy import STATUSES, pareto, run_accuracy, table


@pytest.fixture(scope="module")
def study():
    return run_accuracy(["penetration"], quick=True, progress=False)


def settings_for(study, scene, method, varied):
    where = (study["scene"] == scene) & (study["method"] == method) & (study["varied"] == varied)
    return study.isel(setting=where.values).sortby("value")


def test_errors_shrink_with_tolerance(study):
    located = settings_for(study, "penetration", "located", "tolerance")
    assert np.all(np.diff(located["error_worst"].values) > 0)
    assert np.all(located["error_worst"] < 10 * located["value"])
    assert np.all(located["agreeing"] == located["lanes"]) and np.all(located["lanes"] >= 2)


def test_unsupported_settings_are_kept(study):
    failed = settings_for(study, "penetration", "diffrax Tsit5", "width")
    assert failed.sizes["setting"] == 1 and [*STATUSES][int(failed["status"][0])] == "unsupported"
    assert "rock" in str(failed["remark"].values[0])
    assert np.isnan(failed["error_worst"]).all() and not failed["on_front"].any()
    assert str(failed["remark"].values[0]) in table(study)


def test_wrong_input_is_refused_in_one_line(tmp_path, capsys):
    line = refusal(run_accuracy, ["rotary", "rotary"], quick=True, progress=False)
    assert 'scenes[1]: "rotary" is there already, at [0]; give each scene once' in line
    assert '"rotory" is unknown; did you mean "rotary"' in refusal(run_accuracy, ["rotory"], progress=False)
    (tmp_path / "file").write_text("")
    assert "-o" in command_refusal(capsys, "accuracy", "-o", tmp_path / "file")


def test_pareto_front():
    time = [1.0, 2.0, 3.0, 2.0, 0.5, 4.0, np.nan, 5.0]
    error = [1e-2, 1e-4, 1e-4, 1e-3, np.nan, 1e-6, 1e-9, 1e-6]
    assert pareto(time, error).tolist() == [True, True, False, False, False, True, False, False]
    assert pareto([1.0, 1.0], [1.0, 1.0]).tolist() == [True, True]  # neither beats the other
    assert pareto([], []).size == 0

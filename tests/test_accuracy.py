"""Test the study of speed against error: errors shrink with the tolerance, failures are kept, the front is correct."""

import json

import numpy as np
import pytest

from vibrojax.cli import main
from vibrojax.compile.native import kernels
from vibrojax.errors import InputError
from vibrojax.io.dataset import open_dataset
from vibrojax.studies import accuracy
from vibrojax.studies.accuracy import STATUSES, compared, pareto, run_accuracy, table
from vibrojax.studies.accuracy_programs import SCENES, Program, Setting, settings_of


@pytest.fixture(scope="module")
def study():
    return run_accuracy(quick=True, progress=False)


def settings_for(study, scene, method, varied):
    where = (study["scene"] == scene) & (study["method"] == method) & (study["varied"] == varied)
    return study.isel(setting=where.values).sortby("value")


@pytest.mark.parametrize("scene", ["vibro-impact", "penetration"])
def test_errors_shrink_with_tolerance(study, scene):
    located = settings_for(study, scene, "located", "tolerance")
    assert np.all(np.diff(located["error_worst"].values) > 0)
    assert np.all(located["error_worst"] < 10 * located["value"])
    assert np.all(located["agreeing"] == located["lanes"]) and np.all(located["lanes"] >= 2)


@pytest.mark.parametrize("method", ["smoothed", "diffrax Tsit5"])
def test_errors_shrink_with_smoothing_width(study, method):
    smoothed = settings_for(study, "vibro-impact", method, "width")
    for name in ("period", "impact_velocity", "peak_impact_force", "stick_fraction"):
        assert np.all(np.diff(smoothed[f"{name}_error_worst"].values) > 0), name
    assert np.all(smoothed["error_median"] <= smoothed["error_worst"])


def test_smoothing_error_does_not_depend_on_integrator(study):
    """Both integrators follow the same smoothed motion."""
    own, other = (settings_for(study, "vibro-impact", method, "width") for method in ("smoothed", "diffrax Tsit5"))
    np.testing.assert_allclose(own["error_worst"], other["error_worst"], rtol=0.3)


def test_unsupported_settings_are_kept(study):
    failed = settings_for(study, "penetration", "diffrax Tsit5", "width")
    assert failed.sizes["setting"] == 1 and [*STATUSES][int(failed["status"][0])] == "unsupported"
    assert "rock" in str(failed["remark"].values[0])
    assert np.isnan(failed["error_worst"]).all() and not failed["on_front"].any()
    assert str(failed["remark"].values[0]) in table(study)


def test_times_and_front_of_each_scene(study):
    done = study.isel(setting=study["status"].values == 0)
    assert np.all(done["time_per_lane_second_min"] <= done["time_per_lane_second"])
    assert np.all(done["time_per_lane_second"] <= done["time_per_lane_second_max"])
    assert np.all(done["repeats"] >= 2) and np.all(done["compile_time"] > 0)
    assert {"processor", "cores", "python", "jax", "diffrax"} <= set(json.loads(study.attrs["machine"]))
    assert "tolerance of 1e-14" in study.attrs["reference"]
    assert np.all(done["reference_spread"] < 1e-12)
    for scene in np.unique(study["scene"]):
        here = study.isel(setting=study["scene"].values == scene)
        np.testing.assert_array_equal(here["on_front"], pareto(here["time_per_lane_second"], here["error_worst"]))


def test_timed_runs_compile_nothing():
    accuracy = settings_of("penetration", quick=True)[0].accuracy
    program = Program("penetration", "located", "float64", quick=True)
    kernels.clear()
    program.compile(accuracy)
    compiled = [*kernels]
    program.run(accuracy)
    assert [*kernels] == compiled


def test_setting_with_failed_lanes_keeps_reasons(monkeypatch):
    """Steps that miss the contact change the motion."""
    coarse = Setting("vibro-impact", "smoothed", "float64", "stride", 3.0)
    monkeypatch.setattr(accuracy, "settings_of", lambda scene, quick: [coarse])
    failed = run_accuracy(["vibro-impact"], quick=True, progress=False)
    lanes = int(failed["lanes"][0])
    assert failed["agreeing"] < lanes and failed["status"] != 0 and not failed["on_front"].any()
    assert f" of {lanes} lanes " in str(failed["remark"].values[0]) and str(failed["remark"].values[0]) in table(failed)


def test_command_writes_dataset_table_and_picture(study, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(accuracy, "run_accuracy", lambda quick, progress: study)
    out = tmp_path / "new" / "folder"
    assert main(["accuracy", "--quick", "-o", str(out)]) == 0
    assert {path.name for path in out.iterdir()} == {"accuracy.nc", "accuracy.md", "accuracy.png"}
    assert str(out / "accuracy.md") in capsys.readouterr().out
    assert (out / "accuracy.png").stat().st_size > 20_000
    rows = [line for line in (out / "accuracy.md").read_text().splitlines() if line.startswith("| ")]
    assert len(rows) == study.sizes["setting"] + 2  # a header for each scene
    assert len({row.count("|") for row in rows if "vibro" not in row}) <= 2
    stored = open_dataset(out / "accuracy.nc")
    assert stored["scene"].dtype.kind in "UO" and stored["status"].attrs["flag_meanings"] == " ".join(STATUSES)
    assert table(stored) == table(study)
    assert main(["plot", str(out / "accuracy.nc")]) == 0
    assert main(["info", str(out / "accuracy.nc")]) == 0


def test_wrong_input_is_refused_in_one_line(tmp_path, capsys):
    with pytest.raises(
        InputError, match=r"accuracy: scenes\[1\]: .rotary. is there already, at \[0\]; give each scene once"
    ):
        run_accuracy(["rotary", "rotary"], quick=True, progress=False)
    with pytest.raises(InputError, match='"rotory" is not a scene; did you mean "rotary"'):
        run_accuracy(["rotory"], progress=False)
    (tmp_path / "file").write_text("")
    assert main(["accuracy", "-o", str(tmp_path / "file")]) == 2
    captured = capsys.readouterr()
    assert captured.err.count("\n") == 1 and "-o" in captured.err


def test_interrupt_prints_command_to_start_again(tmp_path, monkeypatch, capsys):
    def interrupted(**_):
        raise KeyboardInterrupt

    monkeypatch.setattr(accuracy, "run_accuracy", interrupted)
    assert main(["accuracy", "-o", str(tmp_path)]) == 130
    line = f"vibrojax: interrupted; nothing is kept; to start again: vibrojax accuracy -o {tmp_path}\n"
    assert capsys.readouterr().err == line


def test_pareto_front():
    time = [1.0, 2.0, 3.0, 2.0, 0.5, 4.0, np.nan, 5.0]
    error = [1e-2, 1e-4, 1e-4, 1e-3, np.nan, 1e-6, 1e-9, 1e-6]
    assert pareto(time, error).tolist() == [True, True, False, False, False, True, False, False]
    assert pareto([1.0, 1.0], [1.0, 1.0]).tolist() == [True, True]  # neither beats the other
    assert pareto([], []).size == 0


def test_status_of_each_lane():
    """Check lanes that match the reference, impact twice as often, have another period, diverge, or do not finish."""
    reference = {"period": np.ones(5), "impact_velocity": np.ones(5), "impacts": np.ones(5), "cycles": np.ones(5)}
    features = {name: x.copy() for name, x in reference.items()}
    features["period"][0], features["period"][2], features["period"][3] = 1 + 1e-6, 2.0, np.nan
    features["impacts"][1] = 2
    features |= {"finite": np.arange(5) != 3, "finished": np.arange(5) != 4}
    status, errors = compared(features, reference)
    np.testing.assert_allclose(errors[""][0], 1e-6, rtol=1e-6)
    expected = ["done", "other-regime", "other-regime", "not-finite", "out-of-steps"]
    assert [[*STATUSES][number] for number in status] == expected


@pytest.mark.parametrize("scene", SCENES)
def test_each_scene_has_lanes_and_settings(scene):
    sweep = Program(scene, "located", "float64", quick=False).sweep
    assert sweep.lanes % 16 == 0 and not sweep.run.end_early
    settings = settings_of(scene, quick=False)
    assert {setting.precision for setting in settings} == {"float64", "float32"}
    assert {setting.varied for setting in settings} >= {"tolerance", "stride"}
    assert any(setting.method.startswith("diffrax") for setting in settings)

"""Test that analyses are looked up by the kind of a dataset, including those that other packages register."""

import io
import json
from contextlib import redirect_stdout
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import vibrojax as vj
from vibrojax.cli import main
from vibrojax.io.kinds import kind_of
from vibrojax.studies.analysis import analysis_of, offered_analyses

OUTSIDE = Path(__file__).parent / "outside"
SWEEP = """scene = "rotary"
[grid]
v = [0.5, 1.0, 1.5]
[run]
settle = 10.0
observe = 8.0
"""


@pytest.fixture(scope="module")
def campbell(tmp_path_factory):
    """Return a folder with an installed package that registers a Campbell diagram, and the dataset of its command."""
    folder = tmp_path_factory.mktemp("outside")
    (folder / "campbell-1.0.dist-info").mkdir()
    (folder / "campbell-1.0.dist-info" / "METADATA").write_text("Metadata-Version: 2.1\nName: campbell\nVersion: 1.0\n")
    entry_points = "campbell = campbell:Campbell\nbroken = campbell:SAMPLES\nfaulty = faulty:Campbell\n"
    (folder / "campbell-1.0.dist-info" / "entry_points.txt").write_text(f"[vibrojax.analyses]\n{entry_points}")
    text = (OUTSIDE / "campbell.py").read_text()
    (folder / "campbell.py").write_text(text)
    faults = {'kind = "campbell"': 'kind = "faulty"', "np.hanning": "np.haning", ".4g": ".4q"}
    for right, wrong in faults.items():
        assert right in text
        text = text.replace(right, wrong)
    (folder / "faulty.py").write_text(text)
    (folder / "speeds.toml").write_text(SWEEP)
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(io.StringIO()) as printed:
        patch.chdir(folder)
        patch.syspath_prepend(folder)
        offered_analyses.cache_clear()
        assert main(["campbell", "speeds.toml", "--orders", "3"]) == 0
    assert "picture" in printed.getvalue()
    return folder


@pytest.fixture
def command(campbell, monkeypatch, capsys):
    """Return a function that runs a command with the package installed and returns its stdout, or stderr on failure."""
    monkeypatch.chdir(campbell)
    monkeypatch.syspath_prepend(campbell)
    offered_analyses.cache_clear()

    def run(*words, status=0):
        assert main(words) == status
        printed = capsys.readouterr()
        return printed.err if status else printed.out

    yield run
    offered_analyses.cache_clear()


def test_command_of_another_package_writes_dataset_and_picture(campbell, monkeypatch):
    monkeypatch.chdir(campbell)
    assert (campbell / "speeds-campbell.png").stat().st_size > 10_000
    with xr.open_dataset(campbell / "speeds-campbell.nc") as ds:
        assert ds.attrs["kind"] == "campbell" and ds.attrs["Conventions"] == "CF-1.11"
        # Friction feeds the upper linear mode; a window of 8 s resolves 1/8 Hz.
        upper = vj.modes.natural_frequencies(vj.read_sweep("speeds.toml").parameters)[1] / (2 * np.pi)
        assert np.abs(ds["fundamental"] - float(upper)).max() < 1 / 8


def test_help_info_and_plot_include_analysis_of_another_package(command):
    assert "campbell" in command("--help")
    own = command("campbell", "--help")
    assert "Draw the spectrum of the bit over the axis of a sweep" in " ".join(own.split())
    assert own.index("--highest") < own.index("--orders")
    assert "highest frequency, Hz" in command("campbell", "--help")
    assert "spectrum  fundamental frequency from" in command("info", "speeds-campbell.nc")
    assert "strongest frequency of the bit" in command("scenes", "rotary")
    facts = json.loads(command("info", "speeds-campbell.nc", "--json"))
    assert facts["kind"] == "campbell" and len(facts["fundamental"]) == 2
    assert command("plot", "speeds-campbell.nc", "-o", "again.png") == "again.png\n" and Path("again.png").exists()


def test_broken_entry_point_is_refused_in_one_line(command):
    refused = command("broken", "speeds.toml", status=2)
    assert refused.count("\n") == 1 and "entry point vibrojax.analyses: broken" in refused
    command("scenes")  # does not import analyses that it does not need


def test_fault_of_an_analysis_is_not_that_of_the_file(command):
    vj.write_dataset(vj.open_dataset("speeds-campbell.nc").assign_attrs(kind="faulty"), "faulty.nc")
    for words, error in ((("info", "faulty.nc"), "ValueError"), (("faulty", "speeds.toml"), "AttributeError")):
        refused = command(*words, status=2)
        assert refused.count("\n") == 1 and f"{words[0]}: the code of faulty fails ({error}" in refused


class Medians(vj.Analysis):
    """The median of each variable over the axes of a sweep."""

    kind = "medians"

    def run(self, source, progress=True):
        return vj.run_sweep(source, progress=progress)[["period", "bit_amplitude"]].median()

    def summary(self, ds):
        return [vj.SummaryPart("medians", [f"period {ds.period:.3g} s"])]


def test_unregistered_analysis_object_runs():
    ds = vj.analyse({"scene": "rotary", "grid": {"v": [1.0, 1.5]}}, Medians(), progress=False)
    assert ds.attrs["kind"] == kind_of(ds) == "medians" and ds.attrs["source"].startswith("vibrojax")
    assert isinstance(analysis_of(ds), Medians)


@pytest.mark.parametrize("wrong", [Medians, 3, None])
def test_object_that_is_not_an_analysis_is_refused(wrong):
    with pytest.raises(vj.InputError, match="is not an Analysis"):
        vj.analyse("regime-map", wrong)
    with pytest.raises(vj.InputError, match="Bare has no method run"):
        vj.analyse("regime-map", type("Bare", (vj.Analysis,), {"kind": "bare"})())

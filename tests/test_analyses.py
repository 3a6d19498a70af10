"""Test that analyses are looked up by the kind of a dataset, including those that other packages register."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import vibrojax as vj
from vibrojax import cli
from vibrojax.cli import main
from vibrojax.cli.analyses import study_command
from vibrojax.io.kinds import STRUCTURES, kind_of
from vibrojax.studies.analysis import _USED, analysis_named, analysis_of, offered_analyses

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
    entry_points = "[vibrojax.analyses]\ncampbell = campbell:Campbell\nbroken = campbell:SAMPLES\n"
    (folder / "campbell-1.0.dist-info" / "entry_points.txt").write_text(entry_points)
    (folder / "campbell.py").write_text((OUTSIDE / "campbell.py").read_text())
    (folder / "speeds.toml").write_text(SWEEP)
    code = (
        f"import sys; sys.path.insert(0, {str(folder)!r}); from vibrojax.cli import main; sys.exit(main(sys.argv[1:]))"
    )
    words = ["campbell", "speeds.toml", "--orders", "3"]
    completed = subprocess.run([sys.executable, "-c", code, *words], cwd=folder, capture_output=True, text=True)
    assert completed.returncode == 0 and "picture" in completed.stdout, completed.stderr
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


def test_command_of_another_package_writes_dataset_and_picture(campbell):
    assert (campbell / "speeds-campbell.png").stat().st_size > 10_000
    with xr.open_dataset(campbell / "speeds-campbell.nc") as ds:
        assert ds.attrs["kind"] == "campbell" and ds.attrs["Conventions"] == "CF-1.11"
        # Friction feeds the upper linear mode; a window of 8 s resolves 1/8 Hz.
        assert np.abs(ds["fundamental"] - ds["mode"][:, 1]).max() < 1 / 8


def test_help_info_and_plot_include_analysis_of_another_package(command):
    assert "campbell" in command("--help")
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


def test_wrong_input_is_refused_in_one_line(command):
    Path("plane.toml").write_text(SWEEP.replace("v =", "k1 = [1e5, 2e5]\nv ="))
    refused = command("campbell", "plane.toml", status=2)
    assert refused == "vibrojax: campbell: the sweep has 2 axes; give one with a single axis\n"
    refused = command("campbell", "speeds.toml", "--orders", "few", status=2)
    assert refused == 'vibrojax: --orders: "few" is not a number\n'


def test_dataset_of_unknown_kind_opens_but_has_no_picture(campbell, capsys, monkeypatch):
    monkeypatch.chdir(campbell)
    assert main(["info", "speeds-campbell.nc"]) == 0
    assert "variables amplitude, mode, fundamental" in capsys.readouterr().out
    assert main(["plot", "speeds-campbell.nc", "-o", "no.png"]) == 2
    assert 'kind "campbell"' in capsys.readouterr().err


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


def test_dataset_without_kind_does_not_suggest_a_package():
    with pytest.raises(vj.InputError, match="a picture needs regime"):
        vj.picture(xr.Dataset({"x": 1.0}))


class StableLanes(vj.SweepAnalysis):
    """The number of stable lanes of a sweep."""

    kind = "stable-lanes"

    def of_lanes(self, sweep, lanes, progress=True):
        return xr.Dataset({"lanes": int((lanes.stable == 1).sum())})


def test_command_records_kind_that_analysis_omits(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(_USED, StableLanes.kind, StableLanes())
    monkeypatch.setitem(cli._COMMANDS, StableLanes.kind, study_command(StableLanes.kind, "count"))
    point = 'scene = "vibro-impact"\nstarts = ["stuck"]\n[grid]\ngamma = [0.75]\n[parameters]\ndelta = 0.005\n'
    Path("one.toml").write_text(point)
    assert main([StableLanes.kind, "one.toml", "-o", "one.nc"]) == 0
    assert vj.open_dataset("one.nc").attrs["kind"] == StableLanes.kind
    assert capsys.readouterr().out == "one.nc\n"


@pytest.mark.parametrize("wrong", [Medians, 3, None])
def test_object_that_is_not_an_analysis_is_refused(wrong):
    with pytest.raises(vj.InputError, match="is not an Analysis"):
        vj.analyse("regime-map", wrong)


def test_each_kind_of_package_has_an_analysis():
    for kind in ("sweep", "fit", *STRUCTURES):
        analysis = analysis_named(kind)
        assert analysis.kind == kind and analysis.__doc__


def test_summaries_of_commands_are_those_of_their_analyses():
    """`--help` imports no analysis, so the table of commands repeats the first line of each docstring."""
    commands = {analysis.command or kind: analysis for kind in STRUCTURES if (analysis := analysis_named(kind))}
    summaries = {name: cli._COMMANDS[name].summary for name in commands if name in cli._COMMANDS}
    assert len(summaries) > 8
    for name in summaries.keys() - {"borders", "attractors", "curves", "rig", "accuracy"}:
        assert str(commands[name].__doc__).startswith(summaries[name]), name


@pytest.mark.parametrize("kind", STRUCTURES)
def test_kind_without_its_structure_is_refused(kind, tmp_path):
    xr.Dataset({"x": 1.0}, attrs={"source": "vibrojax 0", "kind": kind}).to_netcdf(tmp_path / "wrong.nc")
    with pytest.raises(vj.InputError, match=f'kind: is "{kind}", but'):
        vj.open_dataset(tmp_path / "wrong.nc")


def test_kind_that_is_not_text_is_refused(tmp_path):
    xr.Dataset({"x": 1.0}, attrs={"source": "vibrojax 0", "kind": 3}).to_netcdf(tmp_path / "wrong.nc")
    with pytest.raises(vj.InputError, match="attribute kind: 3"):
        vj.open_dataset(tmp_path / "wrong.nc")


def test_datasets_of_earlier_versions_receive_their_kind():
    folder = Path(__file__).parent / "data" / "versions"
    kinds = {"regimes": "sweep", "points": "sweep", "rates": "sweep", "law": "fit"}
    for path in sorted(folder.glob("*/*.nc")):
        if path.stem in kinds:
            assert vj.open_dataset(path).attrs["kind"] == kinds[path.stem], path

"""Analyses are found by the kind of a dataset, also those that other packages offer."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import vibrojax as vj
from vibrojax import cli
from vibrojax.analyses.analysis import _USED, analysis_named, analysis_of, offered_analyses
from vibrojax.cli import main
from vibrojax.cli.analyses import analysis_command
from vibrojax.io.kinds import STRUCTURES, kind_of

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
    """A folder with an installed package that offers a Campbell diagram, and the dataset that its command writes."""
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
    done = subprocess.run([sys.executable, "-c", code, *words], cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0 and "picture" in done.stdout, done.stderr
    return folder


@pytest.fixture
def command(campbell, monkeypatch, capsys):
    """Return what a command prints where the package is installed, on stdout or, if it is refused, on stderr."""
    monkeypatch.chdir(campbell)
    monkeypatch.syspath_prepend(campbell)
    offered_analyses.cache_clear()

    def run(*words, status=0):
        assert main(words) == status
        printed = capsys.readouterr()
        return printed.err if status else printed.out

    yield run
    offered_analyses.cache_clear()


def test_the_command_of_another_package_writes_and_draws(campbell):
    assert (campbell / "speeds-campbell.png").stat().st_size > 10_000
    with xr.open_dataset(campbell / "speeds-campbell.nc") as ds:
        assert ds.attrs["kind"] == "campbell" and ds.attrs["Conventions"] == "CF-1.11"
        # Friction feeds the upper linear mode; a window of 8 s resolves 1/8 Hz.
        assert np.abs(ds["fundamental"] - ds["mode"][:, 1]).max() < 1 / 8


def test_help_info_and_plot_know_it(command):
    assert "campbell" in command("--help")
    assert "highest frequency, Hz" in command("campbell", "--help")
    assert "spectrum  fundamental frequency from" in command("info", "speeds-campbell.nc")
    assert "strongest frequency of the bit" in command("scenes", "rotary")
    facts = json.loads(command("info", "speeds-campbell.nc", "--json"))
    assert facts["kind"] == "campbell" and len(facts["fundamental"]) == 2
    assert command("plot", "speeds-campbell.nc", "-o", "again.png") == "again.png\n" and Path("again.png").exists()


def test_a_broken_offer_is_one_line(command):
    refused = command("broken", "speeds.toml", status=2)
    assert refused.count("\n") == 1 and "entry point vibrojax.analyses: broken" in refused
    command("scenes")  # which does not import what it does not need


def test_its_mistakes_are_one_line(command):
    Path("plane.toml").write_text(SWEEP.replace("v =", "k1 = [1e5, 2e5]\nv ="))
    refused = command("campbell", "plane.toml", status=2)
    assert refused == "vibrojax: campbell: the sweep has 2 axes; give one with a single axis\n"
    refused = command("campbell", "speeds.toml", "--orders", "few", status=2)
    assert refused == 'vibrojax: --orders: "few" is not a number\n'


def test_an_unknown_kind_still_opens(campbell, capsys, monkeypatch):
    monkeypatch.chdir(campbell)
    assert main(["info", "speeds-campbell.nc"]) == 0
    assert "variables amplitude, mode, fundamental" in capsys.readouterr().out
    assert main(["plot", "speeds-campbell.nc", "-o", "no.png"]) == 2
    assert 'kind "campbell"' in capsys.readouterr().err


class Medians(vj.Analysis):
    """Return the median of each variable over the axes of a sweep."""

    kind = "medians"

    def run(self, source, progress=True):
        return vj.run_sweep(source, progress=progress)[["period", "bit_amplitude"]].median()

    def summary(self, ds):
        return [vj.SummaryPart("medians", [f"period {ds.period:.3g} s"])]


def test_an_object_is_an_analysis_at_once():
    ds = vj.analyse({"scene": "rotary", "grid": {"v": [1.0, 1.5]}}, Medians(), progress=False)
    assert ds.attrs["kind"] == kind_of(ds) == "medians" and ds.attrs["source"].startswith("vibrojax")
    assert isinstance(analysis_of(ds), Medians)


def test_a_known_kind_without_a_picture_does_not_ask_for_a_package():
    for ds in (xr.Dataset({"x": 1.0}), xr.Dataset({"x": 1.0}, attrs={"kind": "derivatives"})):
        with pytest.raises(vj.InputError, match="a picture needs regime"):
            vj.picture(ds)


class Orbits(vj.SweepAnalysis):
    """Count the stable lanes of a sweep."""

    kind = "stable-lanes"

    def of_lanes(self, sweep, lanes, progress=True):
        return xr.Dataset({"lanes": int((lanes.stable == 1).sum())})


def test_a_command_states_the_kind_of_an_analysis_that_does_not(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(_USED, Orbits.kind, Orbits())
    monkeypatch.setitem(cli._COMMANDS, Orbits.kind, analysis_command(Orbits.kind, "count"))
    point = 'scene = "vibro-impact"\nstarts = ["stuck"]\n[grid]\ngamma = [0.75]\n[parameters]\ndelta = 0.005\n'
    Path("one.toml").write_text(point)
    assert main([Orbits.kind, "one.toml", "-o", "one.nc"]) == 0
    assert vj.open_dataset("one.nc").attrs["kind"] == Orbits.kind
    assert capsys.readouterr().out == "one.nc\n"


@pytest.mark.parametrize("wrong", [Medians, 3, None])
def test_what_is_no_analysis_is_refused(wrong):
    with pytest.raises(vj.InputError, match="is not an Analysis"):
        vj.analyse("regime-map", wrong)


def test_every_kind_of_the_package_has_an_analysis():
    for kind in ("sweep", "fit", "derivatives", *STRUCTURES):
        analysis = analysis_named(kind)
        assert analysis.kind == kind and analysis.__doc__


@pytest.mark.parametrize("kind", STRUCTURES)
def test_a_kind_without_its_structure_is_refused(kind, tmp_path):
    xr.Dataset({"x": 1.0}, attrs={"source": "vibrojax 0", "kind": kind}).to_netcdf(tmp_path / "wrong.nc")
    with pytest.raises(vj.InputError, match=f'kind: is "{kind}", but'):
        vj.open_dataset(tmp_path / "wrong.nc")


def test_a_kind_that_is_no_text_is_refused(tmp_path):
    xr.Dataset({"x": 1.0}, attrs={"source": "vibrojax 0", "kind": 3}).to_netcdf(tmp_path / "wrong.nc")
    with pytest.raises(vj.InputError, match="attribute kind: 3"):
        vj.open_dataset(tmp_path / "wrong.nc")


def test_datasets_of_earlier_versions_get_their_kind():
    folder = Path(__file__).parent / "data" / "versions"
    kinds = {"regimes": "sweep", "points": "sweep", "rates": "sweep", "law": "fit"}
    for path in sorted(folder.glob("*/*.nc")):
        if path.stem in kinds:
            assert vj.open_dataset(path).attrs["kind"] == kinds[path.stem], path

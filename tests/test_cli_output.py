"""Test the output options of commands: --json, --quiet and --verbose."""

import json

import pytest

import vibrojax as vj
from vibrojax.cli import main

SWEEP = """scene = "penetration"
[grid]
force = [10e3, 300e3]
frequency = { start = 10, stop = 40, num = 6 }
[run]
settle = 0.2
observe = 0.3
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a folder with a sweep file and its dataset."""
    path = tmp_path_factory.mktemp("outputs")
    (path / "map.toml").write_text(SWEEP)
    vj.write_dataset(vj.run_sweep(path / "map.toml", progress=False), path / "map.nc")
    return path


@pytest.fixture
def here(folder, monkeypatch):
    monkeypatch.chdir(folder)
    return folder


def printed(capsys, *argv):
    """Return the only JSON object on stdout."""
    assert main(argv) == 0
    return json.loads(capsys.readouterr().out, parse_constant=pytest.fail)


def test_simulate_prints_facts_as_json(here, capsys):
    facts = printed(capsys, "simulate", "vibro-impact", "duration=1", "beta=0.4", "--json", "-o", "a.nc")
    assert set(facts) == {
        *("scene", "friction", "start", "parameters", "duration", "run"),
        *("found", "frequencies", "solver", "dataset", "picture"),
    }
    assert facts["parameters"]["beta"] == 0.4 and facts["duration"] == 1.0 and facts["start"] == "drive"
    assert facts["found"]["regime"] == "undecided" and facts["found"]["returns"] == 2
    assert facts["found"]["settling_time"] is None  # NaN
    assert facts["run"] == {"settle": 0.5, "observe": 0.5}
    assert (facts["dataset"], facts["picture"]) == ("a.nc", "a.png")
    motion = printed(capsys, "info", "a.nc", "--json")
    assert motion["found"] == facts["found"] and motion["run"] == facts["run"]
    assert motion["dimensions"]["time"]["last"] == 1.0 and motion["regimes"] == {}


def test_info_prints_sweep_as_json(here, capsys):
    facts = printed(capsys, "info", "map.nc", "--json")
    assert facts["scene"] == "penetration" and facts["lanes"] == 12 and facts["file"] == "map.nc"
    assert facts["dimensions"]["force"] == {"size": 2, "units": "N", "first": 10e3, "last": 300e3}
    assert facts["run"]["settle"] == 0.2 and facts["solver"]["method"] == "located"
    assert (
        facts["accuracy"]["accepted"] == 1e-4 and facts["accuracy"]["estimated"] == 10
    )  # two lanes have too few pulses
    assert facts["failures"] == {} and facts["found"] == {} and facts["friction"] is None
    assert facts["variables"]["relief"] == {
        "dims": ["force", "frequency"],
        "units": "1",
        "long_name": "mean force divided by the threshold, P/D",
    }


def test_fit_prints_groups_as_json(here, capsys):
    facts = printed(capsys, "fit", "map.nc", "--json")
    weak, strong = facts["groups"]
    assert weak["coordinates"]["force"] == 10e3 and weak["forms"]["line"]["C"] is None  # nothing penetrates
    assert weak["forms"]["line"]["reason"] != "identified"
    assert strong["forms"]["onset"]["C"] > 0 and strong["forms"]["onset"]["used"] == 6
    assert facts["along"] == "frequency" and facts["dataset"] == "map-fit.nc" and facts["columns"] is None
    assert any("log law" in line for line in facts["verdict"])


def test_orbits_of_a_sweep_are_printed_as_json(here, capsys):
    table = "[grid]\nbeta = [0.4]\n[run]\nsettle = 8.0\nobserve = 4.0\n"
    (here / "strong.toml").write_text(f'scene = "vibro-impact"\nstarts = ["stuck"]\n{table}')
    facts = printed(capsys, "orbits", "strong.toml", "--json")
    assert (facts["dataset"], facts["picture"]) == ("strong-orbits.nc", "strong-orbits.png")
    assert facts["orbits"]["reason"] == {"found": 1}
    assert printed(capsys, "orbits", "strong.toml", "--json") == facts  # from the file
    assert main(["orbits", "strong.toml"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert main(["orbits", "strong.toml", "--quiet"]) == 0
    assert capsys.readouterr().out.splitlines() == lines[:-1] != []

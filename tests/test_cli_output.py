"""Test the output options of commands: --json, --quiet and --verbose."""

import json
from pathlib import Path

import pytest

import vibrojax as vj
from vibrojax.cli import main
from vibrojax.studies import WORDS

ROOT = Path(__file__).parents[1]
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
        "long_name": "mean force over threshold, P/D",
    }


def test_fit_prints_groups_as_json(here, capsys):
    facts = printed(capsys, "fit", "map.nc", "--json")
    weak, strong = facts["groups"]
    assert weak["coordinates"]["force"] == 10e3 and weak["forms"]["line"]["C"] is None  # nothing penetrates
    assert weak["forms"]["line"]["reason"] != "identified"
    assert strong["forms"]["onset"]["C"] > 0 and strong["forms"]["onset"]["used"] == 6
    assert facts["along"] == "frequency" and facts["dataset"] == "map-fit.nc" and facts["columns"] is None
    assert any("log law" in line for line in facts["verdict"])


def test_json_keeps_one_line_refusals(here, capsys):
    assert main(["info", "no.nc", "--json"]) == 2
    captured = capsys.readouterr()
    assert captured.out == "" and captured.err == "vibrojax: no.nc: there is no such file\n"


def test_quiet_prints_only_the_result(here, capsys):
    for argv in (
        ["simulate", "penetration", "duration=0.1", "--fresh"],
        ["sweep", "map.toml", "--fresh"],
        ["plot", "map.nc"],
    ):
        assert main([*argv, "--quiet"]) == 0
        assert capsys.readouterr() == ("", "")
    assert main(["info", "map.nc", "--quiet"]) == 0
    assert "penetration" in capsys.readouterr().out
    (here / "rig.csv").write_text("P/D,ROP (m/h)\n" + "\n".join(f"{0.1 * n},{n}" for n in range(1, 9)) + "\n")
    columns = ["--columns", "relief=P/D", "rate_of_penetration=ROP"]
    assert main(["fit", "rig.csv", *columns, "--quiet"]) == 0
    text = capsys.readouterr().out
    assert text.startswith("all lanes: 8 lanes") and "log law" in text and "rig-fit.nc" not in text


def test_verbose_prints_choices_and_times(here, capsys):
    for argv, parts in (
        (["simulate", "penetration", "duration=0.1", "--fresh"], ("step", "measure", "write", "draw")),
        (["sweep", "map.toml", "--fresh"], ("compile", "compile and step", "write", "draw")),
        (["fit", "map.nc"], ("fit", "write", "draw")),
        (["info", "map.nc"], ("read",)),
        (["plot", "map.nc"], ("read", "draw")),
        (["scenes"], ()),
    ):
        assert main([*argv, "--verbose"]) == 0
        lines = capsys.readouterr().err.splitlines()
        for part in (*parts, "all together"):
            assert any(line.startswith(f"vibrojax: {part}: ") and line.endswith(" s") for line in lines), part
        assert argv[0] not in ("simulate", "sweep", "fit") or any("vibrojax: chosen: " in line for line in lines)
    assert main(["info", "map.nc"]) == 0
    assert capsys.readouterr().err == ""  # not verbose on the next call


def test_help_explains_quiet_and_verbose(capsys):
    for command in ("sweep", "simulate", "plot", "info", "fit", "accuracy", "scenes"):
        assert main([command, "--help"]) == 0
        text = " ".join(capsys.readouterr().out.split())
        assert "print only errors, warnings and the result" in text and "how long each part took" in text
    assert main(["info", "map.nc", "--quiet", "--verbose"]) == 2


def test_output_explains_its_words(here, capsys):
    assert main(["--help"]) == 0
    text = capsys.readouterr().out
    assert all(f"  {word}: {meaning}\n" in text + "\n" for word, meaning in WORDS.items())
    assert main(["sweep", "map.toml", "--fresh"]) == 0
    assert "12 lanes (a point each)" in capsys.readouterr().out
    assert main(["info", "map.nc"]) == 0
    assert f"(a lane: {WORDS['lane']})" in capsys.readouterr().out
    assert main(["fit", "map.nc"]) == 0
    text = capsys.readouterr().out
    assert f"eta: the relief P/D, {WORDS['relief P/D']}" in text and "literal: C ln(eta)" in text

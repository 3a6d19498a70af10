"""Test the command: exit statuses, one-line messages, output options, and no heavy imports before they are needed."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from refusals import command_refusal

import vibrojax as vj
from vibrojax.cli import _COMMANDS, main
from vibrojax.studies.summary import summarise, summary_lines

ROOT = Path(__file__).parents[1]
MAP = 'scene = "vibro-impact"\n[grid]\nbeta = [0.3, 0.4]\n[run]\nsettle = 1.0\nobserve = 1.0\n'


@pytest.fixture
def here(here):
    """Go to a folder with a sweep file."""
    (here / "map.toml").write_text(MAP)
    return here


def test_help_imports_nothing_heavy():
    """The help of all commands together imports no library; that of a study names its settings."""
    code = "import sys; from vibrojax.cli import _COMMANDS, main; "
    code += "print([main([word]) for word in ('--version', '--help')], "
    code += "{'jax', 'numpy', 'xarray', 'matplotlib'} & set(sys.modules)); "
    code += "print([main([name, '--help']) for name in _COMMANDS])"
    completed = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    out = completed.stdout
    assert {"[0, 0] set()", f"{[0] * len(_COMMANDS)}"} <= set(out.splitlines()), out + completed.stderr
    for words in ("scan (number of pushes per scan and direction; default: 256)", "--axes X,Y", "settle (simulated"):
        assert words in " ".join(out.split()), out


def test_processes_of_the_command(tmp_path):
    words = [sys.executable, "-m", "vibrojax", "sweep", "no.toml"]
    completed = subprocess.run(words, capture_output=True, text=True, cwd=tmp_path)
    line = "vibrojax: no.toml: no such file; give the path of one that is there\n"
    assert (completed.returncode, completed.stdout, completed.stderr) == (2, "", line)
    code = "import sys; from vibrojax.cli import main; sys.exit(main(['--version']))"
    reader, writer = os.pipe()
    os.close(reader)
    completed = subprocess.run([sys.executable, "-c", code], stdout=writer, stderr=subprocess.PIPE, text=True, cwd=ROOT)
    os.close(writer)
    assert completed.stderr == "" and completed.returncode == 141


def test_sweep_runs_and_draws(here, capsys):
    assert main(["sweep", "map.toml"]) == 0
    assert capsys.readouterr().out == "map.nc: 4 lanes (a point from one start each); picture map.png\n"
    assert main(["sweep", "map.toml", "-o", "a b.nc", "--fresh", "--quiet"]) == 0
    assert capsys.readouterr().out == ""
    assert {path.name for path in here.iterdir()} == {"map.toml", "map.nc", "map.png", "a b.nc", "a b.png"}


BAD = {
    "": "no command; choose from sweep, simulate, orbits, follow, curves, borders, attractors, push, tolerance, ",
    "swep": "argument COMMAND: invalid choice: 'swep'; did you mean \"sweep\"?; see vibrojax --help",
    "sweep map.toml --fresh --resume": "not allowed with argument",
    "sweep map.toml -o map.txt": '-o: "map.txt" does not end in .nc',
    "sweep map.toml -o no/map.nc": '-o: "no/map.nc": "no" does not exist; give a file in a folder',
    "sweep map.toml -o taken.nc": '-o: "taken.png" is a folder',
    "simulate rotary beta=1 beta=2": 'simulate: beta: "2" is a second value',
    "simulate rotary beta=0,4": 'simulate: beta: "0,4" is text; write 0.4, with a point',
    "push beta=0.4": "push: the scene is missing; write vibrojax push SCENE beta=0.4",
    "scenes rotary x=1": "scenes: unrecognized arguments: x=1; see vibrojax scenes --help",
    "simulate rotary start=[0,0": 'simulate: start: "[0,0" is not a vector',
}


@pytest.mark.parametrize("words", BAD)
def test_bad_input_is_refused_before_any_work(here, capsys, words):
    (here / "taken.png").mkdir()
    assert BAD[words] in command_refusal(capsys, *words.split())
    assert {path.name for path in here.iterdir()} == {"map.toml", "taken.png"}


FLAGS = {"flag_values": np.arange(4, dtype=np.int8), "flag_meanings": "undecided equilibrium single-impact failed"}


def labelled() -> xr.Dataset:
    dims, reasons = ("beta", "start"), {"flag_values": [0, 1], "flag_meanings": "none not-finite"}
    lanes = {"regime": (dims, np.array([[2, 2], [3, 0], [2, 3]], np.int8), FLAGS)}
    lanes |= {"reason": (dims, np.array([[0, 0], [1, 0], [0, 1]], np.int8), reasons)}
    lanes |= {"error_estimate": (dims, np.array([[1e-6, 1e-5], [np.nan, np.nan], [5e-3, np.nan]]))}
    attrs = {"scene": "rotary", "title": "t", "sweep": "[run]\nerror = 1e-3\n", "lanes": 6, "wall_time_s": 2.0}
    attrs |= {"run": '{"settle": 40.0, "observe": 8.0, "error": 1e-3}', "friction": "coulomb"}
    attrs |= {"parameters": '{"m1": 250.0, "k1": 3e5, "v": 1.5}'}
    attrs |= {"differing": '[{"name": "k1", "symbol": "k", "units": "N m-1", "value": 3e5, "default": 156250.0}]'}
    return xr.Dataset(lanes, {"beta": ("beta", [0.1, 0.2, 0.4], {"units": "1"}), "start": ["drive", "stuck"]}, attrs)


def test_info_summarises_dataset():
    text = "\n".join(summary_lines(summarise(labelled())))
    uncertain = labelled()
    uncertain["error_estimate"][2, 0] = np.inf
    uncertain["check_regime"] = uncertain["regime"].copy(data=np.array([[2, 2], [3, 2], [2, 3]], np.int8))
    text += "\n".join(summary_lines(summarise(uncertain)))
    for line in (
        "largest inf",
        "1 of 6 regimes differ at the check run's coarser resolution",
        "scene     rotary",
        "grid      beta: 0.1 to 0.4 (3)\n          start: drive, stuck (2)",
        "regimes   undecided             1   16.7 %\n          single-impact         3   50.0 %",
        "failures  2\n          2 not-finite\n          at beta=0.2 start=drive: not-finite\n",
        "          at beta=0.4 start=stuck: not-finite",
        "accuracy  error_estimate median 1e-05, largest 0.005",
        "          66.67 % of 3 periodic lanes within the accepted 0.001",
        "wall time 2 s",
        "run       settled for 40 s, observed for 8 s\n          error = 0.001",
        "friction  coulomb\nfixed     k1 = 300000 N m-1 (default 156250)\n          by default: m1 = 250, v = 1.5",
    ):
        assert line in text, text


def test_decimal_comma_in_a_file_is_explained(here, capsys):
    """A message names the line and both ways to write it."""
    (here / "map.toml").write_text(MAP.replace("[grid]", "[parameters]\nv = 1,2\n[grid]"))
    line = command_refusal(capsys, "sweep", "map.toml")
    assert "v = 1,2: write a decimal point, v = 1.2, or a list, v = [1, 2]" in line


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
def in_folder(folder, monkeypatch):
    monkeypatch.chdir(folder)
    return folder


def printed(capsys, *argv):
    """Return the only JSON object on stdout."""
    assert main(argv) == 0
    return json.loads(capsys.readouterr().out, parse_constant=pytest.fail)


def test_simulate_prints_facts_as_json(in_folder, capsys):
    facts = printed(capsys, "simulate", "vibro-impact", "duration=1", "beta=0.4", "--json", "-o", "a.nc")
    names = "scene friction start parameters duration run found frequencies solver dataset picture"
    assert " ".join(sorted(facts)) == " ".join(sorted(names.split()))
    assert facts["parameters"]["beta"] == 0.4 and facts["duration"] == 1.0 and facts["start"] == "drive"
    assert facts["found"]["regime"] == "undecided" and facts["found"]["returns"] == 2
    assert facts["found"]["settling_time"] is None  # NaN
    assert facts["run"] == {"settle": 0.5, "observe": 0.5}
    assert (facts["dataset"], facts["picture"]) == ("a.nc", "a.png")
    motion = printed(capsys, "info", "a.nc", "--json")
    assert motion["found"] == facts["found"] and motion["run"] == facts["run"]
    assert motion["dimensions"]["time"]["last"] == 1.0 and motion["regimes"] == {}


def test_info_and_fit_print_json(in_folder, capsys):
    facts = printed(capsys, "info", "map.nc", "--json")
    assert facts["scene"] == "penetration" and facts["lanes"] == 12 and facts["file"] == "map.nc"
    assert facts["dimensions"]["force"] == {"size": 2, "units": "N", "first": 10e3, "last": 300e3}
    assert facts["run"]["settle"] == 0.2 and facts["solver"]["method"] == "located"
    assert facts["accuracy"]["accepted"] == 1e-4 and facts["accuracy"]["estimated"] == 10  # two have too few pulses
    assert facts["failures"] == {} and facts["found"] == {} and facts["friction"] is None
    named = {"units": "1", "long_name": "mean force divided by the threshold, P/D"}
    assert facts["variables"]["relief"] == {"dims": ["force", "frequency"], **named}
    facts = printed(capsys, "fit", "map.nc", "--json")
    weak, strong = facts["groups"]
    assert weak["coordinates"]["force"] == 10e3 and weak["forms"]["line"]["C"] is None  # nothing penetrates
    assert weak["forms"]["line"]["reason"] != "identified"
    assert strong["forms"]["onset"]["C"] > 0 and strong["forms"]["onset"]["used"] == 6
    assert facts["along"] == "frequency" and facts["dataset"] == "map-fit.nc" and facts["columns"] is None
    assert any("log law" in line for line in facts["verdict"])


def test_orbits_of_a_sweep_are_printed_as_json(in_folder, capsys):
    table = "[grid]\nbeta = [0.4]\n[run]\nsettle = 8.0\nobserve = 4.0\n"
    (in_folder / "strong.toml").write_text(f'scene = "vibro-impact"\nstarts = ["stuck"]\n{table}')
    facts = printed(capsys, "orbits", "strong.toml", "--json")
    assert (facts["dataset"], facts["picture"]) == ("strong-orbits.nc", "strong-orbits.png")
    assert facts["orbits"]["reason"] == {"found": 1}
    assert printed(capsys, "orbits", "strong.toml", "--json") == facts  # from the file
    assert main(["orbits", "strong.toml"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert main(["orbits", "strong.toml", "--quiet"]) == 0
    assert capsys.readouterr().out.splitlines() == lines[:-1] != []

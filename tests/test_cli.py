"""Test the command: exit statuses, one-line messages, and no heavy imports before they are needed."""

import os
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr

from vibrojax.cli import main
from vibrojax.errors import InputError
from vibrojax.io.files import size_text, time_text
from vibrojax.studies.summary import summarise, summary_lines

ROOT = Path(__file__).parents[1]
MAP = 'scene = "vibro-impact"\n[grid]\nbeta = [0.3, 0.4]\n'


class Calls(list):
    """Calls from the commands to the rest of the package: tuples (name, arguments)."""

    def names(self):
        return [name for name, *_ in self]

    def of(self, name):
        return next(arguments for called, *arguments in self if called == name)


@pytest.fixture
def calls(monkeypatch, tmp_path):
    """Replace the working modules by stand-ins, in an empty current folder, and return their calls."""
    made = Calls()

    def module(name, **functions):
        for function, result in functions.items():
            monkeypatch.setattr(import_module(name), function, stand_in_for(function, result))

    def stand_in_for(name, result):
        def call(*arguments, **named):
            made.append((name, arguments, named))
            return result

        return call

    dataset = xr.Dataset()
    cost = SimpleNamespace(memory=2.5e6, disk=1234, file=512, seconds=190.0)
    module("vibrojax.maps.run", run_to_file=dataset)
    module("vibrojax.maps.cost", check_size=None, tried=cost)
    simulated = stand_in_for("simulate", dataset)
    monkeypatch.setattr("vibrojax.studies.trajectory.Trajectories.compute", simulated)
    module("vibrojax.io.dataset", write_dataset=None, open_dataset=dataset)
    module("vibrojax.studies.choose", save_picture=None, picture=None)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "map.toml").write_text(MAP)
    return made


def failing(name, function, error, monkeypatch):
    def call(*_, **__):
        raise error

    monkeypatch.setattr(sys.modules[name], function, call)


def refused(capsys, *argv) -> str:
    """Return the only line with which the command refuses its input."""
    assert main(argv) == 2
    captured = capsys.readouterr()
    assert captured.out == "" and captured.err.count("\n") == 1 and captured.err.startswith("vibrojax: ")
    return captured.err


def test_help_imports_nothing_heavy():
    """Only the help of a study imports: that of its own settings."""
    code = "import sys; from vibrojax.cli import main; status = main(sys.argv[1:]); "
    code += "print(status, sorted({'jax', 'numpy', 'xarray', 'matplotlib'} & set(sys.modules)))"
    for argv in (["--help"], ["sweep", "--help"], ["plot", "--help"], ["sweep"], ["--version"]):
        completed = subprocess.run([sys.executable, "-c", code, *argv], capture_output=True, text=True, cwd=ROOT)
        assert completed.stdout.splitlines()[-1] == f"{2 if argv == ['sweep'] else 0} []", (
            completed.stdout + completed.stderr
        )


@pytest.mark.parametrize(
    ("argv", "line"),
    [
        (["sweep", "no.toml"], "vibrojax: no.toml: no such file; give the path of one that is there\n"),
        (["simulate", "rotery"], 'vibrojax: simulate: scene: "rotery" is unknown; did you mean "rotary"?\n'),
    ],
)
def test_python_m_matches_command(argv, line, tmp_path):
    completed = subprocess.run([sys.executable, "-m", "vibrojax", *argv], capture_output=True, text=True, cwd=tmp_path)
    assert (completed.returncode, completed.stdout, completed.stderr) == (2, "", line)


def test_sweep_runs_and_draws(calls, capsys):
    assert main(["sweep", "map.toml"]) == 0
    assert calls.names() == ["run_to_file", "save_picture"]
    (sweep, out), named = calls.of("run_to_file")
    assert sweep.lanes == 4 and out == Path("map.nc") and named == {"resume": True, "progress": True, "executor": None}
    assert calls.of("save_picture")[0][1] == Path("map.png")
    assert capsys.readouterr().out == "map.nc: 4 lanes (a point from one start each); picture map.png\n"


def test_sweep_options(calls, capsys, tmp_path):
    out = tmp_path / "a b.nc"
    assert main(["sweep", "map.toml", "-o", str(out), "--fresh", "--quiet"]) == 0
    arguments, named = calls.of("run_to_file")
    assert arguments[1] == out and named == {"resume": False, "progress": False, "executor": None}
    assert capsys.readouterr().out == ""


def test_dry_run_only_prints_estimate(calls, capsys):
    assert main(["sweep", "map.toml", "--dry-run"]) == 0
    assert calls.names() == ["check_size", "tried", "check_size"]
    expected = [
        "lanes   4 (2 beta x 2 start) in 1 chunk",
        "memory  2.5 MB",
        "disk    1.23 kB while it runs, 512 B then",
    ]
    expected.append("time    about 3.17 min on the cores of this machine")
    assert capsys.readouterr().out.splitlines() == expected


def test_interrupted_sweep_prints_command_to_resume(calls, capsys, monkeypatch):
    failing("vibrojax.maps.run", "run_to_file", KeyboardInterrupt(), monkeypatch)
    assert main(["sweep", "map.toml", "-o", "my map.nc"]) == 130
    line = "vibrojax: interrupted; finished chunks are kept; to go on: vibrojax sweep map.toml -o 'my map.nc'\n"
    assert capsys.readouterr().err == line


@pytest.mark.parametrize("argv", [["sweep", "map.toml", "-o", "a b.nc"], ["simulate", "rotary", "-o", "a b.nc"]])
def test_interrupted_picture_keeps_dataset(calls, capsys, monkeypatch, argv):
    """The dataset is complete by then, and all chunks are removed."""
    failing("vibrojax.studies.choose", "save_picture", KeyboardInterrupt(), monkeypatch)
    assert main(argv) == 130
    line = "vibrojax: interrupted; a b.nc is whole; for its picture: vibrojax plot 'a b.nc'\n"
    assert capsys.readouterr().err == line


def test_full_disk_is_reported_in_one_line(calls, capsys, monkeypatch):
    failing("vibrojax.maps.run", "run_to_file", OSError(28, "No space left on device", "map.nc"), monkeypatch)
    assert main(["sweep", "map.toml"]) == 1
    line = "vibrojax: map.nc: No space left on device; finished chunks are kept; to go on: vibrojax sweep map.toml"
    assert capsys.readouterr().err == f"{line} -o map.nc\n"


def test_bad_input_detected_late_is_refused_in_one_line(calls, capsys, monkeypatch):
    failing("vibrojax.io.dataset", "open_dataset", InputError("a.nc: not\nours"), monkeypatch)
    assert refused(capsys, "plot", "a.nc") == "vibrojax: a.nc: not ours\n"
    assert refused(capsys, "info", "a.nc") == "vibrojax: a.nc: not ours\n"


@pytest.mark.parametrize(
    ("argv", "line"),
    [
        (
            [],
            "no command; choose from sweep, simulate, orbits, follow, curves, borders, attractors, push, tolerance, "
            "design, study, calibrate, plot, explore, info",
        ),
        (["swep"], "argument COMMAND: invalid choice: 'swep'; did you mean \"sweep\"?; see vibrojax --help"),
        (["explore"], "explore: the following arguments are required: OUT.nc; see vibrojax explore --help"),
        (["push", "rotary", "scan=1"], "vibrojax: push: scan: 1 does not fit"),
        (["simulate", "drilling", "start=moving"], 'did you mean "touching"? (starts: drive, stuck, touching)'),
        (["sweep"], "sweep: the following arguments are required: SWEEP; see vibrojax sweep --help"),
        (["sweep", "map.toml", "--fesh"], "unrecognized arguments: --fesh"),
        (["sweep", "map.toml", "--fresh", "--resume"], "not allowed with argument"),
        (["sweep", "mpa.toml"], "mpa.toml: no such file"),
        (["sweep", "map.toml", "-o", "map.txt"], '-o: "map.txt" does not end in .nc'),
        (["sweep", "map.toml", "-o", "no/map.nc"], '-o: "no/map.nc": "no" does not exist; give a file in a folder'),
        (["sweep", "map.toml", "-o", "map.toml/map.nc"], '"map.toml" is not a folder'),
        (["sweep", "map.toml", "-o", "folder.nc"], '-o: "folder.nc" is a folder'),
        (["sweep", "map.toml", "-o", "taken.nc"], '-o: "taken.png" is a folder'),
        (["plot", "map.nc", "-o", "map.bmp"], '-o: "map.bmp" does not end in .png or .pdf or .svg'),
        (["simulate", "rotery"], 'simulate: scene: "rotery" is unknown; did you mean "rotary"?'),
        (["simulate", "rotary", "delta=1"], 'simulate: delta: scene "rotary" has no delta; it has m1'),
        (["simulate", "rotary", "bta=1"], 'simulate: bta: scene "rotary" has no such parameter; did you mean "beta"?'),
        (["simulate", "rotary", "beta"], 'simulate: "beta" is not NAME=VALUE'),
        (["simulate", "rotary", "beta=1", "beta=2"], 'simulate: beta: "2" is a second value'),
        (["simulate", "rotary", "beta=0"], "simulate: beta: is 0; it must be above 0"),
        (["simulate", "rotary", "beta=nan"], "simulate: beta: is nan; a finite number is needed"),
        (["simulate", "rotary", "beta=x"], 'simulate: beta: "x" is text; write a number'),
        (["simulate", "rotary", "beta=0,4"], 'simulate: beta: "0,4" is text; write 0.4, with a point'),
        (["simulate", "rotary", "k1=156kN/m"], 'k1: "156kN/m" is text; write the number alone, in N m-1'),
        (["simulate", "rotary", "duration=20 s"], '"20 s" is text; write the number alone, in s'),
        (["simulate"], "simulate: the following arguments are required: SCENE; see vibrojax simulate --help"),
        (["simulate", "rotary", "start=touching"], 'simulate: start: "touching" is not a start of scene "rotary"'),
        (["simulate", "rotary", "start=[0,0"], 'simulate: start: "[0,0" is not a vector'),
        (["simulate", "rotary", "start=[0,0]"], "simulate: start: [0, 0] has 2 numbers; 4 are needed"),
        (["simulate", "rotary", "duration=0"], "simulate: duration: is 0; it must be above 0 s"),
        (["simulate", "rotary", "solver=3"], "simulate: solver: 3.0 is not a name"),
        (["simulate", "rotary", "-o", "a.png"], '-o: "a.png" does not end in .nc'),
    ],
)
def test_bad_input_is_refused_before_any_work(calls, capsys, tmp_path, argv, line):
    (tmp_path / "folder.nc").mkdir()
    (tmp_path / "taken.png").mkdir()
    assert line in refused(capsys, *argv)
    assert set(calls.names()) <= {"open_dataset"}


def test_folder_without_write_permission_is_refused(calls, capsys, monkeypatch):
    def refuse(**_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("tempfile.TemporaryFile", refuse)
    assert '-o: "map.nc": folder "." cannot be written (Permission denied)' in refused(capsys, "sweep", "map.toml")
    assert calls == []


def test_simulate_passes_checked_point(calls, capsys):
    words = [
        "beta=0.3",
        "rpm=60",
        "bit_radius=0.1",
        "friction=coulomb",
        "start=[0,0,0.01,0]",
        "duration=5",
        "solver=Tsit5",
    ]
    assert main(["simulate", "vibro-impact", *words]) == 0
    (analysis, point, _), _ = calls.of("simulate")
    assert point.scene == "vibro-impact" and point.options["friction"] == "coulomb"
    assert point.parameters["beta"] == 0.3 and point.parameters["v"] == pytest.approx(0.2 * np.pi)
    assert not {"rpm", "v_cr"} & set(point.parameters) and point.start == (0.0, 0.0, 0.01, 0.0)
    assert analysis.duration == 5.0 and analysis.solver == "Tsit5"
    assert calls.names() == ["simulate", "write_dataset", "save_picture"]
    assert calls.of("write_dataset")[0][1] == Path("vibro-impact.nc")
    assert capsys.readouterr().out == "vibro-impact.nc; picture vibro-impact.png\n"


def test_plot_writes_next_to_dataset(calls, capsys, tmp_path):
    assert main(["plot", "map.nc"]) == 0
    assert calls.of("save_picture")[0][1] == Path("map.png")
    assert main(["plot", "map.nc", "-o", "other.svg"]) == 0
    assert capsys.readouterr().out.split() == ["map.png", "other.svg"]


def test_closed_pipe_prints_no_error():
    code = "import sys; from vibrojax.cli import main; sys.exit(main(['--version']))"
    reader, writer = os.pipe()
    os.close(reader)
    completed = subprocess.run([sys.executable, "-c", code], stdout=writer, stderr=subprocess.PIPE, text=True, cwd=ROOT)
    os.close(writer)
    assert completed.stderr == "" and completed.returncode == 141


FLAGS = {"flag_values": np.arange(4, dtype=np.int8), "flag_meanings": "undecided equilibrium single-impact failed"}


def labelled() -> xr.Dataset:
    regime = np.array([[2, 2], [3, 0], [2, 3]], np.int8)
    reason = np.array([[0, 0], [1, 0], [0, 1]], np.int8)
    errors = np.array([[1e-6, 1e-5], [np.nan, np.nan], [5e-3, np.nan]])
    dims = ("beta", "start")
    return xr.Dataset(
        {
            "regime": (dims, regime, FLAGS),
            "reason": (dims, reason, {"flag_values": [0, 1], "flag_meanings": "none not-finite"}),
            "error_estimate": (dims, errors),
        },
        coords={"beta": ("beta", [0.1, 0.2, 0.4], {"units": "1"}), "start": ["drive", "stuck"]},
        attrs={"scene": "rotary", "title": "t", "sweep": "[run]\nerror = 1e-3\n", "lanes": 6, "wall_time_s": 2.0}
        | {"run": '{"settle": 40.0, "observe": 8.0, "error": 1e-3}', "friction": "coulomb"}
        | {"parameters": '{"m1": 250.0, "k1": 3e5, "v": 1.5}'}
        | {"differing": '[{"name": "k1", "symbol": "k", "units": "N m-1", "value": 3e5, "default": 156250.0}]'},
    )


def test_info_summarises_dataset():
    text = "\n".join(summary_lines(summarise(labelled())))
    for line in (
        "scene     rotary",
        "grid      beta: 0.1 to 0.4 (3)\n          start: drive, stuck (2)",
        "regimes   undecided             1   16.7 %\n          single-impact         3   50.0 %",
        "failures  2\n          2 not-finite\n          at beta=0.2 start=drive: not-finite\n",
        "          at beta=0.4 start=stuck: not-finite",
        "accuracy  error_estimate median 1e-05, largest 0.005",
        "          66.67 % of 3 periodic lanes within the accepted 0.001",
        "wall time 2 s",
        "run       settled for 40 s, observed for 8 s",
        "friction  coulomb\nfixed     k1 = 300000 N m-1 (default 156250)\n          by default: m1 = 250, v = 1.5",
    ):
        assert line in text, text


def test_info_reports_uncertain_lanes():
    """Lanes without an error bound count as outside the accepted error.

    Regimes that differ in the check run are counted.
    """
    dataset = labelled()
    dataset["error_estimate"][2, 0] = np.inf
    dataset["check_regime"] = dataset["regime"].copy(data=np.array([[2, 2], [3, 2], [2, 3]], np.int8))
    text = "\n".join(summary_lines(summarise(dataset)))
    assert "largest inf" in text and "66.67 % of 3 periodic lanes within the accepted 0.001" in text
    assert "1 of 6 regimes differ at the check run's coarser resolution" in text


@pytest.mark.parametrize("dropped", ["regime", "reason", "error_estimate", "beta"])
def test_info_accepts_missing_variables(dropped):
    dataset = labelled().drop_vars(dropped)
    dataset.attrs = {}
    assert summary_lines(summarise(dataset))
    assert summary_lines(summarise(xr.Dataset({"x1": ("time", [0.0, 1.0])}, coords={"time": [0.0, 1.0]})))


def test_sizes_and_times_are_readable():
    assert [size_text(size) for size in (0, 999, 1e6, 2.345e12, 1e19)] == [
        "0 B",
        "999 B",
        "1 MB",
        "2.35 TB",
        "10,000,000 TB",
    ]
    assert [time_text(time) for time in (0.5, 100, 600, 1e4, 1e6, 1e9)] == [
        "0.5 s", "100 s", "10 min", "2.78 h", "11.6 days", "11,574 days",
    ]  # fmt: skip
    assert size_text(1e30) == "1e+18 TB" and time_text(1e300) == "1.16e+295 days"

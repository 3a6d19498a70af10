"""Test progress reports: a bar on a terminal, plain lines elsewhere, and a pace counted from the first amount."""

import io
import os
import pty
import subprocess
import sys
from pathlib import Path

import pytest

from vibrojax import progress as module
from vibrojax.progress import Portions, Progress, end_lines

ROOT = Path(__file__).parents[1]


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


class Clock:
    """A clock [s] that only the tests advance."""

    now = 100.0

    def monotonic(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch):
    fake = Clock()
    monkeypatch.setattr(module, "time", fake)
    return fake


@pytest.fixture
def replace_stderr(monkeypatch):
    """Return a function that replaces stderr by a stream."""

    def stand_in(stream):
        monkeypatch.setattr(sys, "stderr", stream)
        return stream

    return stand_in


LINES = {
    # Compilation takes the first 60 s. It does not count for the pace, only for the total time.
    "plain lines come now and then": (
        {"total": 1000, "unit": "lanes"},
        [60, ("add", 100), *[1, ("add", 50)] * 18],
        ["100/1000 lanes", "600/1000 lanes, 50 lanes/s, 8 s left", "1000/1000 lanes, 13 lanes/s, 78.0 s"],
    ),
    "an earlier run is no part of the pace": (
        {"total": 1000, "unit": "lanes"},
        [("resume", 600), 20, ("add", 100), 10, ("add", 100), 10, ("add", 200)],
        [
            "600 of 1000 lanes are there from an earlier run",
            "700/1000 lanes",
            "800/1000 lanes, 10 lanes/s, 20 s left",
            "1000/1000 lanes, 10 lanes/s, 40.0 s",
        ],
    ),
    "nothing is resumed from nothing": ({"total": 1000, "unit": "lanes"}, [("resume", 0)], []),
    # The last step may pass the total.
    "measures have no pace but a time left": (
        {"total": 20.0, "unit": "s simulated", "pace": False},
        [10, ("reach", 2.0), 10, ("reach", 4.52), 1, ("reach", 20.3)],
        ["2/20 s simulated", "4.5/20 s simulated, 61 s left", "20/20 s simulated, 21.0 s"],
    ),
    "each outcome has its line": (
        {"total": 2, "unit": "settings", "pace": False},
        [("add", 1, "error 1e-06"), 3, ("add", 1, "error 2e-06")],
        ["1/2 settings: error 1e-06", "2/2 settings, 3.0 s: error 2e-06"],
    ),
    "lines of its own tell the time": (
        {"total": 2, "unit": "needs"},
        [12, ("say", "rotary: 40 points")],
        ["   12 s  rotary: 40 points"],
    ),
}


@pytest.mark.parametrize("name", LINES)
def test_plain_lines(name, clock, replace_stderr):
    """A number is a time [s] that passes. A tuple is a method and its arguments."""
    settings, steps, expected = LINES[name]
    stream = replace_stderr(io.StringIO())
    progress = Progress(**settings)
    for step in steps:
        if isinstance(step, int):
            clock.now += step
        else:
            getattr(progress, step[0])(*step[1:])
    assert stream.getvalue().splitlines() == expected


def test_bar_is_overwritten_on_terminal(clock, replace_stderr):
    stream = replace_stderr(Terminal())
    with Progress(4, "lanes") as progress:
        for _ in range(4):
            clock.now += 1.0
            progress.add(1)
    assert stream.getvalue().count("\n") == 1 and stream.getvalue().endswith("\n")
    assert stream.getvalue().rstrip().split("\r")[-1] == f"[{'#' * 30}] 4/4 lanes, 1 lanes/s, 4.0 s"


def test_messages_are_printed_above_bar(clock, replace_stderr):
    stream = replace_stderr(Terminal())
    with Progress(4, "lanes") as progress:
        progress.add(1)
        progress.say("on the way")
    shown = [line.split("\r")[-1].rstrip() for line in stream.getvalue().split("\n")]
    assert shown == ["    0 s  on the way", f"[{'#' * 7}{'.' * 23}] 1/4 lanes", ""]


def test_unfinished_bar_gets_line_end_once(replace_stderr):
    stream = replace_stderr(Terminal())
    Progress(4, "lanes").add(1)
    assert "\n" not in stream.getvalue()
    end_lines()
    end_lines()
    assert stream.getvalue().endswith("\n") and stream.getvalue().count("\n") == 1


def test_terminal_without_size_has_bar():
    ours, theirs = pty.openpty()  # without columns and lines
    code = "from vibrojax.progress import Progress; [Progress(4, 'lanes').add(4)]"
    subprocess.run([sys.executable, "-c", code], stderr=theirs, cwd=ROOT, check=True)
    os.close(theirs)
    with open(ours, "rb", buffering=0) as terminal:
        assert f"[{'#' * 30}] 4/4 lanes, " in terminal.read(4096).decode()


def test_nothing_is_shown_if_disabled(replace_stderr):
    for stream in (io.StringIO(), Terminal()):
        replace_stderr(stream)
        with Progress(2, "lanes", shown=False) as progress:
            progress.resume(1)
            progress.say("something")
            progress.add(1, "something")
        assert stream.getvalue() == ""


def test_portions_of_work_are_reported_as_whole_items():
    reported = []
    portions = Portions(4, reported.append)
    for _ in range(9):
        portions.add(0.5)  # 4.5 in total, more than the four items
    assert reported == [1, 1, 1]
    portions.finish()
    portions.finish()
    assert reported == [1, 1, 1, 1]


def test_plain_lines_do_not_import_tqdm():
    code = (
        "import sys; from vibrojax.progress import Progress; Progress(1, 'lanes').add(); print('tqdm' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert done.stdout == "False\n" and done.stderr.startswith("1/1 lanes, ")

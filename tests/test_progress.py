"""How far work is: a bar on a terminal, plain lines elsewhere, with a pace that is counted from the first amount."""

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
    """The time [s], which only the tests move on."""

    now = 100.0

    def monotonic(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch):
    made = Clock()
    monkeypatch.setattr(module, "time", made)
    return made


@pytest.fixture
def shown_on(monkeypatch):
    """Has a stream stand for stderr."""

    def stand_in(stream):
        monkeypatch.setattr(sys, "stderr", stream)
        return stream

    return stand_in


LINES = {
    # programs compile for 60 s: they do not count, except in the time of all of it
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
    # the last step may go beyond
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
def test_lines(name, clock, shown_on):
    """Steps are seconds that pass, or methods with their arguments."""
    settings, steps, expected = LINES[name]
    stream = shown_on(io.StringIO())
    progress = Progress(**settings)
    for step in steps:
        if isinstance(step, int):
            clock.now += step
        else:
            getattr(progress, step[0])(*step[1:])
    assert stream.getvalue().splitlines() == expected


def test_a_bar_is_drawn_over_on_a_terminal(clock, shown_on):
    stream = shown_on(Terminal())
    with Progress(4, "lanes") as progress:
        for _ in range(4):
            clock.now += 1.0
            progress.add(1)
    assert stream.getvalue().count("\n") == 1 and stream.getvalue().endswith("\n")
    assert stream.getvalue().rstrip().split("\r")[-1] == f"[{'#' * 30}] 4/4 lanes, 1 lanes/s, 4.0 s"


def test_lines_stand_above_the_bar(clock, shown_on):
    stream = shown_on(Terminal())
    with Progress(4, "lanes") as progress:
        progress.add(1)
        progress.say("on the way")
    shown = [line.split("\r")[-1].rstrip() for line in stream.getvalue().split("\n")]
    assert shown == ["    0 s  on the way", f"[{'#' * 7}{'.' * 23}] 1/4 lanes", ""]


def test_a_bar_that_is_left_ends_its_line(shown_on):
    stream = shown_on(Terminal())
    Progress(4, "lanes").add(1)
    assert "\n" not in stream.getvalue()
    end_lines()
    end_lines()
    assert stream.getvalue().endswith("\n") and stream.getvalue().count("\n") == 1


def test_a_terminal_without_a_size_has_a_bar_too():
    ours, theirs = pty.openpty()  # no columns and no lines
    code = "from vibrojax.progress import Progress; [Progress(4, 'lanes').add(4)]"
    subprocess.run([sys.executable, "-c", code], stderr=theirs, cwd=ROOT, check=True)
    os.close(theirs)
    with open(ours, "rb", buffering=0) as terminal:
        assert f"[{'#' * 30}] 4/4 lanes, " in terminal.read(4096).decode()


def test_nothing_is_shown_where_nobody_wants_to_know(shown_on):
    for stream in (io.StringIO(), Terminal()):
        shown_on(stream)
        with Progress(2, "lanes", shown=False) as progress:
            progress.resume(1)
            progress.say("something")
            progress.add(1, "something")
        assert stream.getvalue() == ""


def test_portions_of_work_are_reported_as_whole_things():
    reported = []
    portions = Portions(4, reported.append)
    for _ in range(9):
        portions.add(0.5)  # of all four together: 4.5, more than there is
    assert reported == [1, 1, 1]
    portions.finish()
    portions.finish()
    assert reported == [1, 1, 1, 1]


def test_logs_do_without_the_library_of_bars():
    code = (
        "import sys; from vibrojax.progress import Progress; Progress(1, 'lanes').add(); print('tqdm' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert done.stdout == "False\n" and done.stderr.startswith("1/1 lanes, ")

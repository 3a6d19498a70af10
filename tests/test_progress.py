"""Tests of progress on stderr: lines in files, a bar on terminals."""

import io
from contextlib import redirect_stderr

import pytest

from vibrojax import progress as module
from vibrojax.progress import Progress


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


class Clock:
    now = 100.0

    def monotonic(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch):
    """Return a clock that the test turns, so that no test waits."""
    fake = Clock()
    monkeypatch.setattr(module, "time", fake)
    return fake


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
}


@pytest.mark.parametrize("name", LINES)
def test_plain_lines(name, clock):
    """A number is a time [s] that passes. A tuple is a method and its arguments."""
    settings, steps, expected = LINES[name]
    with redirect_stderr(io.StringIO()) as stream:
        progress = Progress(**settings)
        for step in steps:
            if isinstance(step, int):
                clock.now += step
            else:
                getattr(progress, step[0])(*step[1:])
    assert stream.getvalue().splitlines() == expected


def test_bar_is_overwritten_on_terminal(clock):
    with redirect_stderr(Terminal()) as stream, Progress(4, "lanes") as progress:
        for _ in range(4):
            clock.now += 1.0
            progress.add(1)
    assert stream.getvalue().count("\n") == 1 and stream.getvalue().endswith("\n")
    assert stream.getvalue().rstrip().split("\r")[-1] == f"[{'#' * 30}] 4/4 lanes, 1 lanes/s, 4.0 s"


def test_nothing_is_shown_if_disabled():
    for terminal in (io.StringIO(), Terminal()):
        with redirect_stderr(terminal) as stream, Progress(2, "lanes", shown=False) as progress:
            progress.resume(1)
            progress.say("something")
        assert stream.getvalue() == ""

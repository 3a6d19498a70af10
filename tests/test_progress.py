"""Tests of progress on stderr, of the threads that share work, and of the estimated cost."""

import io
import time
from contextlib import redirect_stderr
from contextvars import ContextVar

import pytest

from vibrojax import progress as module
from vibrojax.lanes.run import LaneRun
from vibrojax.maps.cost import estimated_steps, tried
from vibrojax.maps.read import read_sweep
from vibrojax.maps.run import run_to_file
from vibrojax.progress import Progress
from vibrojax.threads import by_drivers, in_parallel


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


PLAIN = {
    "100/1000 lanes|600/1000 lanes, 50 lanes/s, 8 s left|1000/1000 lanes, 13 lanes/s, 78.0 s": [60, 100, *[1, 50] * 18],
    "600 of 1000 lanes are there from an earlier run|800/1000 lanes|1000/1000 lanes, 10 lanes/s, 40.0 s": [20, 200] * 2,
}


@pytest.mark.parametrize("lines", PLAIN)
def test_plain_lines(lines, clock):
    """Compilation takes the first 60 s, which count for the total time only; neither it nor an earlier run is part of
    the pace. Steps are the time that passes [s] and the lanes that it takes, in turn."""
    steps = PLAIN[lines]
    with redirect_stderr(io.StringIO()) as stream:
        progress = Progress(1000, "lanes")
        if sum(steps[1::2]) < 1000:
            progress.resume(1000 - sum(steps[1::2]))
        for seconds, count in zip(steps[::2], steps[1::2], strict=True):
            clock.now += seconds
            progress.add(count)
    assert stream.getvalue().splitlines() == lines.split("|")


def test_bar_is_overwritten_on_terminal_unless_disabled(clock):
    with redirect_stderr(Terminal()) as stream, Progress(4, "lanes") as progress:
        for _ in range(4):
            clock.now += 1.0
            progress.add(1)
    assert stream.getvalue().count("\n") == 1 and stream.getvalue().endswith("\n")
    assert stream.getvalue().rstrip().split("\r")[-1] == f"[{'#' * 30}] 4/4 lanes, 1 lanes/s, 4.0 s"
    for terminal in (io.StringIO(), Terminal()):
        with redirect_stderr(terminal) as stream, Progress(2, "lanes", shown=False) as progress:
            progress.resume(1)
            progress.say("something")
        assert stream.getvalue() == ""


SETTING: ContextVar[int] = ContextVar("SETTING", default=0)


def test_each_item_is_computed_once_and_none_after_an_error():
    """Drivers may use the pool, and a thread of the pool computes its own items itself."""
    pool = ["first", "second"]
    nested = lambda worker, item: sum(result for _, result in in_parallel(lambda _, x: x, range(item), pool))
    drive = lambda item: sum(result for _, result in in_parallel(nested, range(item), pool)) + SETTING.get()
    SETTING.set(100)
    expected = {index: sum(k * (k - 1) // 2 for k in range(item)) + 100 for index, item in enumerate(range(9))}
    assert dict(by_drivers(drive, range(9), 3)) == expected
    calls = []

    def work(item: int) -> None:
        calls.append(item)
        time.sleep(0.01)
        if item == 2:
            raise ValueError("wrong")

    with pytest.raises(ValueError, match="wrong"):
        list(by_drivers(work, range(100), 1))
    assert 3 <= len(calls) < 100


# The cost that `--dry-run` prints and that limits a sweep before it runs
MAP = {"scene": "vibro-impact", "grid": {"beta": {"start": 0.2, "stop": 0.6, "num": 512}}, "starts": ["stuck"]}


def test_estimated_steps_match_computed_steps():
    """All lanes are stepped to their end."""
    sweep = read_sweep(MAP, ["run.end_early=false"])
    inputs = sweep.inputs()
    taken = LaneRun(inputs, sweep.plan).chunk(inputs).features["steps"].sum()
    assert 2 / 3 < estimated_steps(sweep).sum() / taken < 3 / 2
    # A stiff damper needs c2/m2 steps per second, divided by the stride 2; 1e6 and 1000 per second are the limit.
    usual, stiff, most = (estimated_steps(read_sweep(MAP | {"grid": {"c2": [c2]}})).sum() for c2 in (200, 1e6, 1e13))
    assert stiff / usual == pytest.approx((1e4 / 2 + 45.0) / (45.0 + 18.0), rel=0.1)
    assert most == pytest.approx(1e6 + 48 * 1000, rel=0.1)


def test_cost_is_extrapolated_from_few_lanes(tmp_path):
    grid = {"beta": {"start": 0.2, "stop": 0.6, "num": 10}, "gamma": {"start": 0.6, "stop": 0.9, "num": 60}}
    sweep = read_sweep(MAP | {"grid": grid, "run": {"settle": 2.0, "observe": 1.0, "carry": "beta"}})
    cost = tried(sweep)
    run_to_file(sweep, tmp_path / "out.nc", progress=False)
    assert 0.3 < (tmp_path / "out.nc").stat().st_size / cost.file < 1.5

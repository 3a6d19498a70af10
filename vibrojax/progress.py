"""Progress of long work on stderr: a bar on a terminal, plain lines elsewhere.

with Progress(sweep.lanes, "lanes") as progress:  # ends the line of the bar if the work stops early
    progress.resume(512)                          # done by an earlier run: reported, and left out of the pace
    progress.add(64)                              # 576/1000 lanes, 2100 lanes/s, 0.2 s left
    progress.say("rotary: 40 points")             # a separate line, with the seconds since the start
"""

import logging
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from shutil import get_terminal_size
from threading import RLock
from typing import TYPE_CHECKING, ClassVar

if TYPE_CHECKING:
    import tqdm

LOG = logging.getLogger("vibrojax")

Amount = int | float
"""A count, or a measure such as a time."""

QUIET_SECONDS = 10.0
"""Least time [s] between two plain lines, so that logs stay short."""


class Progress:
    """The progress of one work: the amount done, the pace, and the remaining time.

    On a terminal it is a bar that is redrawn. Elsewhere it is a plain line now and then, one for each outcome, and one
    at the end. The pace counts from the first finished amount: the time before, in which programs are compiled, says
    nothing about the rest.

    **Arguments:**

    - `total`: the whole amount.
    - `unit`: text after a number: "lanes", "settings", "s simulated".
    - `shown`: whether to show anything at all.
    - `pace`: whether to show the amount per second.
    """

    _on_terminal: ClassVar["set[Progress]"] = set()

    def __init__(self, total: Amount, unit: str, shown: bool = True, *, pace: bool = True) -> None:
        self._total, self._unit, self._shown, self._pace = total, unit, shown, pace
        self._stream = sys.stderr
        self._start = self._last_line = time.monotonic()
        self._done: Amount = 0
        self._resumed: Amount = 0
        self._first: tuple[float, Amount] | None = None
        self._bar: tqdm.tqdm | None = None
        self._lock = RLock()  # amounts may come from several threads

    def resume(self, done: Amount) -> None:
        """Report the amount that an earlier run has done; it does not count towards the pace."""
        with self._lock:
            self._done = self._resumed = done
            if done:
                self._print(f"{_number(done)} of {_number(self._total)} {self._unit} are there from an earlier run")

    def add(self, amount: Amount = 1, outcome: str = "") -> None:
        """Report an amount that is newly done, with a text on its outcome if that deserves a line."""
        with self._lock:
            self._reach(self._done + amount, outcome)

    def reach(self, done: Amount) -> None:
        """Report the total amount that is done."""
        with self._lock:
            self._reach(done, "")

    def say(self, text: str) -> None:
        """Print a separate line, after the seconds since the start."""
        with self._lock:
            self._print(f"{time.monotonic() - self._start:5.0f} s  {text}")

    def close(self) -> None:
        """End the line of the bar, if there is one."""
        with self._lock:
            if self._bar is not None:
                self._bar.close()
                self._bar = None
            self._on_terminal.discard(self)

    def __enter__(self) -> "Progress":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _reach(self, done: Amount, outcome: str) -> None:
        self._done = min(done, self._total)
        if not self._shown:
            return
        now = time.monotonic()
        self._first = self._first or (now, self._done)
        complete = self._done >= self._total
        line = self._line(now) + (f": {outcome}" if outcome else "")
        if not self._stream.isatty():
            if complete or outcome or now - self._last_line >= QUIET_SECONDS:
                self._last_line = now
                print(line, file=self._stream, flush=True)
            return
        if self._bar is None:
            self._bar = _bar(self._total, line)
            self._on_terminal.add(self)
        self._bar.n = self._done
        self._bar.set_description_str(line, refresh=complete)
        if complete:
            self.close()
        else:
            self._bar.update(0)

    def _print(self, line: str) -> None:
        if not self._shown:
            return
        if self._bar is None:
            print(line, file=self._stream, flush=True)
        else:
            self._bar.write(line, file=self._stream)

    def _line(self, now: float) -> str:
        """Return the amount done, the pace, and the remaining time, or at the end the elapsed time."""
        line = f"{_number(self._done)}/{_number(self._total)} {self._unit}"
        if self._done >= self._total:
            elapsed = now - self._start
            rate, rest = (self._done - self._resumed) / max(elapsed, 1e-9), f"{elapsed:.1f} s"
        else:
            then, before = self._first or (now, self._done)
            if self._done <= before or now <= then:
                return line
            rate = (self._done - before) / (now - then)
            rest = f"{(self._total - self._done) / rate:.0f} s left"
        return f"{line}, {rate:.0f} {self._unit}/s, {rest}" if self._pace else f"{line}, {rest}"


class Portions:
    """Converts work on many things at once into whole things: as many as the same work would finish one by one.

    **Arguments:**

    - `count`: number of things.
    - `report`: receives the number of things that are newly done; the last one only after `finish`.
    """

    def __init__(self, count: int, report: Callable[[int], None]) -> None:
        self._count, self._report = count, report
        self._work, self._reported = 0.0, 0

    def add(self, work: Amount) -> None:
        """Add work, where 1 is the whole work on one thing."""
        self._work += work
        self._reach(min(int(self._work), self._count - 1))

    def finish(self) -> None:
        """Report all things as done."""
        self._reach(self._count)

    def _reach(self, done: int) -> None:
        if done > self._reported:
            self._report(done - self._reported)
            self._reported = done


def end_lines() -> None:
    """End the lines of all bars, so that the next output begins a line."""
    for progress in list(Progress._on_terminal):
        progress.close()


@contextmanager
def timed(name: str) -> Iterator[None]:
    """Log the duration of the block when it ends."""
    began = time.monotonic()
    yield
    LOG.info("%s: %.2f s", name, time.monotonic() - began)


def _bar(total: Amount, line: str) -> "tqdm.tqdm":
    """Return a bar whose text its owner sets."""
    from tqdm import tqdm  # slow to import, and needed only on a terminal

    # Some terminals report no columns and no lines, and tqdm would draw nothing on them.
    columns, lines = get_terminal_size()
    layout = {"bar_format": "[{bar:30}] {desc}", "ascii": ".#", "ncols": columns - 1, "nrows": lines}
    return tqdm(desc=line, total=total, file=sys.stderr, **layout)


def _number(amount: Amount) -> str:
    """Return a count as it is, and any other amount to a tenth."""
    return str(amount) if isinstance(amount, int) else f"{amount:.1f}".removesuffix(".0")

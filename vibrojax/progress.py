"""Progress reports of long computations on stderr: a progress bar on a terminal, plain lines elsewhere.

with Progress(sweep.lanes, "lanes") as progress:  # closes the bar on exit, even if the work stops early
    progress.resume(512)                          # done by an earlier run: reported, but not included in the rate
    progress.add(64)                              # 576/1000 lanes, 2100 lanes/s, 0.2 s left
    progress.say("rotary: 40 points")             # a separate line, preceded by the elapsed seconds
"""

import logging
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from shutil import get_terminal_size
from threading import RLock
from typing import TYPE_CHECKING, ClassVar

if TYPE_CHECKING:
    import tqdm

LOG = logging.getLogger("vibrojax")

Amount = int | float
"""An amount of work: a count, or a continuous quantity such as simulated time."""

QUIET_SECONDS = 10.0
"""Least time [s] between two plain lines, which keeps logs short."""


class Progress:
    """The progress of one computation: the completed amount of work, the rate, and the remaining time.

    On a terminal, a bar is redrawn. Elsewhere, a plain line is printed at most every `QUIET_SECONDS`, for each outcome,
    and at the end. The rate is measured from the first completed amount on, because programs are compiled before.

    `total`: total amount of work; `unit`: unit shown after a number, such as "lanes" or "s simulated"; `shown`: whether
    progress is shown at all; `pace`: whether the amount per second is shown.
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
        self._lock = RLock()  # several threads may report amounts

    def resume(self, done: Amount) -> None:
        """Report the amount completed by an earlier run; this amount is not included in the rate."""
        with self._lock:
            self._done = self._resumed = done
            if done:
                are = "is" if done == 1 else "are"
                self._print(f"{_number(done)} of {_number(self._total)} {self._unit} {are} there from an earlier run")

    def add(self, amount: Amount = 1, outcome: str = "") -> None:
        """Report a newly completed amount; a non-empty `outcome` is printed with it on a line."""
        with self._lock:
            self.reach(self._done + amount, outcome)

    def reach(self, done: Amount, outcome: str = "") -> None:
        """Report the total amount completed so far; `outcome`: as for `add`."""
        with self._lock:
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
                from tqdm import tqdm  # slow to import, and needed only on a terminal

                # Some terminals report a size of zero columns and lines, on which tqdm would draw nothing.
                columns, lines = get_terminal_size()
                layout = {"bar_format": "[{bar:30}] {desc}", "ascii": ".#", "ncols": columns - 1, "nrows": lines}
                self._bar = tqdm(desc=line, total=self._total, file=sys.stderr, **layout)
                self._on_terminal.add(self)
            self._bar.n = self._done
            self._bar.set_description_str(line, refresh=complete)
            if complete:
                self.close()
            else:
                self._bar.update(0)

    def say(self, text: str) -> None:
        """Print `text` on a separate line, preceded by the elapsed seconds."""
        with self._lock:
            self._print(f"{time.monotonic() - self._start:5.0f} s  {text}")

    def close(self) -> None:
        """Close the progress bar and end its line, if there is a bar."""
        with self._lock:
            if self._bar is not None:
                self._bar.close()
                self._bar = None
            self._on_terminal.discard(self)

    def __enter__(self) -> "Progress":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _print(self, line: str) -> None:
        if not self._shown:
            return
        if self._bar is None:
            print(line, file=self._stream, flush=True)
        else:
            self._bar.write(line, file=self._stream)

    def _line(self, now: float) -> str:
        """Return a line with the completed amount, the rate, and the remaining (at the end: elapsed) time."""
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
    """Converts work on many items in parallel into a number of completed items.

    The number is the number of items that the same work would complete one after the other, of `count` items in total.
    `report` is called with the number of newly completed items. The last item is reported only by `finish`.
    """

    def __init__(self, count: int, report: Callable[[int], None]) -> None:
        self._count, self._report = count, report
        self._work, self._reported = 0.0, 0
        self._lock = RLock()  # several threads may report work

    def add(self, work: Amount) -> None:
        """Add an amount of work; 1 is the work on one item."""
        with self._lock:
            self._work += work
            self._reach(min(int(self._work), self._count - 1))

    def finish(self) -> None:
        with self._lock:
            self._reach(self._count)

    def _reach(self, done: int) -> None:
        if done > self._reported:
            self._report(done - self._reported)
            self._reported = done


def end_lines() -> None:
    """Close all progress bars and end their lines, so that the next output starts on a new line."""
    for progress in list(Progress._on_terminal):
        progress.close()


@contextmanager
def timed(name: str) -> Iterator[None]:
    """Log the duration of the `with` block when it ends without an error."""
    began = time.monotonic()
    yield
    LOG.info("%s: %.2f s", name, time.monotonic() - began)


@contextmanager
def quiet() -> Iterator[None]:
    """Suppress numpy's warnings in all threads: diverging lanes are flagged instead."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        yield


def _number(amount: Amount) -> str:
    """Return an integer as a string, and any other amount rounded to one decimal."""
    return str(amount) if isinstance(amount, int) else f"{amount:.1f}".removesuffix(".0")

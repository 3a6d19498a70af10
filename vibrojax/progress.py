"""How far some work is, on stderr: a bar on a terminal, plain lines elsewhere.

    progress = Progress(sweep.lanes, "lanes", shown=True)
    progress.resume(512)                      # done by an earlier run: said, and left out of the pace
    progress.add(64)                          # 576/1000 lanes, 2100 lanes/s, 0.2 s left

    progress = Progress(20.0, "s simulated", pace=False)
    progress.reach(3.5)                       # 3.5/20 s simulated, 12 s left

    progress = Progress(len(settings), "settings", pace=False)
    progress.add(1, "rotary: error 1e-06")    # 3/14 settings, 8 s left: rotary: error 1e-06

    progress.say("rotary: 40 points")         # a line of its own, with the seconds since the start

Works that can stop in the middle of a bar are put in a `with progress:`, which ends its line.
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

Amount = int | float
"""Things that are counted, or a measure such as a time."""

QUIET_SECONDS = 10.0
"""Seconds between two plain lines at least, so that logs stay short."""

_BAR = "[{bar:30}] {desc}"
_SIGNS = ".#"


class Progress:
    """Shows how much of a work is done, at what pace, and how long the rest will take.

    On a terminal it is a bar that is drawn over; elsewhere a plain line now and then, one for each outcome that is
    given, and one at the end. The pace is counted from the first amount that is done: before it programs are compiled,
    which says nothing about the rest.

    **Arguments:**

    - `total`: the whole amount.
    - `unit`: what is counted, as it reads behind a number: "lanes", "settings", "s simulated".
    - `shown`: whether to show anything at all.
    - `pace`: whether to show the amount per second.
    """

    _on_terminal: ClassVar["set[Progress]"] = set()

    def __init__(self, total: Amount, unit: str, shown: bool = True, *, pace: bool = True) -> None:
        self._total = total
        self._unit = unit
        self._shown = shown
        self._pace = pace
        self._stream = sys.stderr
        self._start = self._said = time.monotonic()
        self._done: Amount = 0
        self._resumed: Amount = 0
        self._first: tuple[float, Amount] | None = None
        self._bar: tqdm.tqdm | None = None
        self._lock = RLock()  # amounts may come from several threads

    def resume(self, done: Amount) -> None:
        """The amount that an earlier run has done: said where there is any, and no part of the pace."""
        with self._lock:
            self._done = self._resumed = done
            if done:
                self._print(f"{_number(done)} of {_number(self._total)} {self._unit} are there from an earlier run")

    def add(self, amount: Amount = 1, outcome: str = "") -> None:
        """An amount that has just been done, and in words what came of it, if that is worth a line."""
        with self._lock:
            self._reach(self._done + amount, outcome)

    def reach(self, done: Amount) -> None:
        """The amount that is done by now, all together."""
        with self._lock:
            self._reach(done, "")

    def say(self, text: str) -> None:
        """A line of its own, after the seconds since the start: what is being done now."""
        with self._lock:
            self._print(f"{time.monotonic() - self._start:5.0f} s  {text}")

    def close(self) -> None:
        """End the line of the bar, if one is drawn; nothing else changes."""
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
        whole = self._done >= self._total
        line = self._line(now) + (f": {outcome}" if outcome else "")
        if self._stream.isatty():
            self._draw(line, whole)
        elif whole or outcome or now - self._said >= QUIET_SECONDS:
            self._said = now
            print(line, file=self._stream, flush=True)

    def _draw(self, line: str, whole: bool) -> None:
        if self._bar is None:
            self._bar = _bar(self._total, line)
            self._on_terminal.add(self)
        self._bar.n = self._done
        self._bar.set_description_str(line, refresh=whole)
        if whole:
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
        """How much is done, at what pace, and how long the rest or, at the end, all of it took."""
        done = f"{_number(self._done)}/{_number(self._total)} {self._unit}"
        if self._done >= self._total:
            seconds = now - self._start
            return f"{done}{self._rate((self._done - self._resumed) / max(seconds, 1e-9))}, {seconds:.1f} s"
        then, before = self._first or (now, self._done)
        if self._done <= before or now <= then:
            return done
        rate = (self._done - before) / (now - then)
        return f"{done}{self._rate(rate)}, {(self._total - self._done) / rate:.0f} s left"

    def _rate(self, rate: float) -> str:
        return f", {rate:.0f} {self._unit}/s" if self._pace else ""


class Portions:
    """Turns work that goes on in many things at once into whole things: as many as the work would finish together.

    **Arguments:**

    - `count`: how many things there are.
    - `report`: called with how many more of them count as done; the last one only when all is finished.
    """

    def __init__(self, count: int, report: Callable[[int], None]) -> None:
        self._count, self._report = count, report
        self._work, self._reported = 0.0, 0

    def add(self, work: Amount) -> None:
        """Work that has been done, where 1 is all that one thing takes."""
        self._work += work
        self._reach(min(int(self._work), self._count - 1))

    def finish(self) -> None:
        """All things are done."""
        self._reach(self._count)

    def _reach(self, done: int) -> None:
        if done > self._reported:
            self._report(done - self._reported)
            self._reported = done


def end_lines() -> None:
    """End the lines of all bars that are being drawn, so that what is printed next begins a line."""
    for progress in list(Progress._on_terminal):
        progress.close()


def _bar(total: Amount, line: str) -> "tqdm.tqdm":
    """A bar with a text that its owner changes as it goes."""
    from tqdm import tqdm  # slow to import, and of no use but on a terminal

    # Some terminals say that they have no columns and no lines, and tqdm would draw nothing on them.
    columns, lines = get_terminal_size()
    return tqdm(desc=line, total=total, file=sys.stderr, bar_format=_BAR, ascii=_SIGNS, ncols=columns - 1, nrows=lines)


def _number(amount: Amount) -> str:
    """A count as it is, any other amount to a tenth."""
    return str(amount) if isinstance(amount, int) else f"{amount:.1f}".removesuffix(".0")


LOG = logging.getLogger("vibrojax")


@contextmanager
def timed(what: str) -> Iterator[None]:
    """Tell how many seconds `what` took, once it is done."""
    began = time.monotonic()
    yield
    LOG.info("%s: %.2f s", what, time.monotonic() - began)

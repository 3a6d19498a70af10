"""How far a sweep is: a bar on a terminal, plain lines elsewhere."""

import sys
import time
from collections.abc import Callable
from typing import TextIO

BAR = 30
QUIET_SECONDS = 10.0


class Progress:
    """Tells on `stream` how many lanes are done, lanes per second, and the time left.

    On a terminal a bar that is drawn over; elsewhere a plain line now and then, so that logs stay short.
    """

    def __init__(self, lanes: int, shown: bool = True, stream: TextIO | None = None):
        self._lanes = lanes
        self._shown = shown
        self._stream = stream or sys.stderr
        self._start = self._last = time.monotonic()
        self._done = 0
        self._before = 0
        self._first: tuple[float, int] | None = None  # programs are compiled before it: no pace to go by

    def resume(self, done: int) -> None:
        """Lanes that an earlier run has computed."""
        self._done = self._before = done
        if done and self._shown:
            print(f"{done} of {self._lanes} lanes are there from an earlier run", file=self._stream)

    def add(self, lanes: int) -> None:
        """Lanes that have just been computed."""
        self._done += lanes
        if not self._shown:
            return
        now = time.monotonic()
        self._first = self._first or (now, self._done)
        whole = self._done >= self._lanes
        if self._stream.isatty():
            filled = BAR * self._done // self._lanes
            print(f"\r[{'#' * filled}{'.' * (BAR - filled)}] {self._line(now)} ", end="", file=self._stream)
            if whole:
                print(file=self._stream)
            self._stream.flush()
        elif whole or now - self._last >= QUIET_SECONDS:
            self._last = now
            print(self._line(now), file=self._stream, flush=True)

    def _line(self, now: float) -> str:
        lanes, seconds = f"{self._done}/{self._lanes} lanes", now - self._start
        if self._done >= self._lanes:
            return f"{lanes}, {(self._done - self._before) / max(seconds, 1e-9):.0f} lanes/s, {seconds:.1f} s"
        then, done = self._first or (now, self._done)
        if self._done == done or now <= then:
            return lanes
        rate = (self._done - done) / (now - then)
        return f"{lanes}, {rate:.0f} lanes/s, {(self._lanes - self._done) / rate:.0f} s left"


class Worked:
    """Lanes of a chunk that count as done: so many as their work done together would finish.

    `told` is called with whole lanes, the last of them by `finish`.
    """

    def __init__(self, lanes: int, told: Callable[[int], None]):
        self._lanes, self._told = lanes, told
        self._work, self._given = 0.0, 0

    def add(self, work: float) -> None:
        """Work in lanes: 1 is all of what one takes."""
        self._work += work
        self._give(min(int(self._work), self._lanes - 1))

    def finish(self) -> None:
        """All lanes are done."""
        self._give(self._lanes)

    def _give(self, done: int) -> None:
        if done > self._given:
            self._told(done - self._given)
            self._given = done

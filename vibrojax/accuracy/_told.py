"""How far the study is: a line that is drawn over on a terminal, plain lines elsewhere."""

import sys
from typing import TextIO

import numpy as np

from vibrojax.accuracy._measure import Measured


class Told:
    """Tells on `stream` what came of each setting, and how many there are."""

    def __init__(self, settings: int, shown: bool = True, stream: TextIO | None = None):
        self._settings = settings
        self._shown = shown
        self._stream = stream or sys.stderr
        self._done = 0

    def add(self, result: Measured) -> None:
        """A setting that has just been measured."""
        self._done += 1
        if not self._shown:
            return
        line = f"{self._done}/{self._settings} {_text(result)}"
        if self._stream.isatty():
            end = "\n" if self._done == self._settings else ""
            print(f"\r\033[K{line[:110]}", end=end, file=self._stream, flush=True)
        else:
            print(line, file=self._stream, flush=True)


def _text(result: Measured) -> str:
    one = result.setting
    name = f"{one.scene}: {one.method}, {one.precision}, {one.varied} {one.value:g}: "
    if not result.agreeing:
        return name + result.reason
    return f"{name}error {result.errors['overall'].max():.1e}, {1e6 * np.median(result.seconds):.3g} µs/lane-s"

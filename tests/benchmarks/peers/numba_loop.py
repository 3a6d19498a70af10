"""Compiled loops from switch to switch (numba), one lane at a time on each core."""

import time
from dataclasses import dataclass

import numpy as np

from peers import _dormand_prince, _taylor
from peers._compiled import numba, program
from peers._peer import CORES, Peer, Ran


@dataclass(frozen=True)
class Series:
    """Order of the steps, and their length in units of the mode's time scale."""

    order: int
    stride: float

    def __str__(self):
        return f"order {self.order}, stride {self.stride:g}"


@dataclass(frozen=True)
class Tolerance:
    """Tolerance of the steps, relative to v for velocities and to v over the mode's rate for positions."""

    tolerance: float

    def __str__(self):
        return f"tolerance {self.tolerance:g}"


class Loop(Peer):
    """Common part of both loops: the state machine in `_compiled`, and threads over the lanes."""

    lanes = 4096

    def __init__(self):
        self._programs = {}

    def missing(self):
        return None if numba else "numba is not installed"

    def program_of(self, setting):
        """Return the program of a setting and its numeric argument."""
        raise NotImplementedError

    def run(self, points, setting, settle, observe, judged):
        run, value = self.program_of(setting)
        compiling = 0.0
        if numba:
            numba.set_num_threads(CORES)
            began = time.perf_counter()
            run(*points[np.arange(2)].columns, 0.01, 0.01, value)
            compiling = time.perf_counter() - began
        began = time.perf_counter()
        found = run(*points.columns, settle, observe, value)
        return Ran(found[:, 0], found[:, 1], time.perf_counter() - began, compiling)


class NumbaDormandPrince(Loop):
    name = "numba, Dormand-Prince 5(4)"
    about = "per-lane loop from switch to switch, adaptive steps, Newton on the dense output"

    def ladders(self, quick):
        tolerances = (1e-4, 1e-6) if quick else (1e-3, 1e-4, 3e-5, 1e-5, 3e-6, 1e-6, 1e-7, 1e-8, 1e-9)
        return [[Tolerance(one) for one in tolerances]]

    def program_of(self, setting):
        if not self._programs:
            self._programs[0] = program(_dormand_prince.step, _dormand_prince.DEGREE, _dormand_prince.both)
        return self._programs[0], setting.tolerance


class NumbaTaylor(Loop):
    name = "numba, Taylor series"
    about = "the same loop, recurrences of the series written out for one order, Newton on its polynomials"

    def ladders(self, quick):
        if quick:
            return [[Series(8, 1.0), Series(8, 0.5)]]
        return [[Series(8, s) for s in (1.6, 1.2, 1.0, 0.85, 0.7, 0.5)], [Series(12, s) for s in (1.4, 1.2, 1.0, 0.7)]]

    def program_of(self, setting):
        if setting.order not in self._programs:
            step, both = _taylor.stepper(setting.order)
            self._programs[setting.order] = program(step, setting.order, both)
        return self._programs[setting.order], setting.stride

"""Our own sweep, including its check run."""

import time
from dataclasses import dataclass

import numpy as np

import vibrojax as vj
from peers._peer import Peer, Points, Ran
from peers.lanes import box, columns


@dataclass(frozen=True)
class Error:
    """The requested error."""

    error: float

    def __str__(self):
        return f"error = {self.error:g}"


class Ours(Peer):
    name = "vibrojax"
    about = "run_sweep, end_early = false, certified (second run included)"
    lanes = 4096

    def __init__(self):
        began = time.perf_counter()
        self._sweep(box()[np.arange(64)], Error(1e-4), 0.01, 0.01)
        self._compiling = time.perf_counter() - began

    def ladders(self, quick):
        errors = (1e-2, 1e-4) if quick else (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-9)
        return [[Error(error) for error in errors]]

    def run(self, points, setting, settle, observe, judged):
        compiling, self._compiling = self._compiling, 0.0
        began = time.perf_counter()
        found = self._sweep(points, setting, settle, observe)
        seconds = time.perf_counter() - began
        return Ran(found["period"].values, found["impact_velocity"].values, seconds, compiling)

    @staticmethod
    def _sweep(points: Points, setting: Error, settle: float, observe: float):
        run = {"error": setting.error, "end_early": False, "settle": settle, "observe": observe}
        return vj.run_sweep({"scene": "vibro-impact", "points": columns(points), "run": run}, progress=False)

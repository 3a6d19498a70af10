"""The smoothed loop in C++, vectorised over lanes: compiled at run time for this processor, and called by ctypes."""

import ctypes
import shutil
import subprocess
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from peers._peer import CORES, Peer, Ran

LANES = 8
"""Lanes per vector: one register of AVX-512, two of AVX. Sixteen are not faster, and wait longer for one another."""

# Without -ffast-math, since a library linked with it makes the whole process flush subnormal numbers.
FLAGS = (
    *("-O3", "-march=native", "-mprefer-vector-width=512", "-fno-math-errno", "-fno-trapping-math"),
    *("-fno-signed-zeros", "-freciprocal-math", "-fassociative-math", "-fopenmp", "-shared", "-fPIC"),
)


@dataclass(frozen=True)
class Steps:
    """Width of the friction switch [m/s], and step lengths.

    Where friction is steep, steps are in units of its time scale. The longest steps [s] are in flight and in contact.
    """

    width: float
    steep: float
    flight: float
    contact: float

    def __str__(self):
        return f"width {self.width:g} m/s, steps {self.flight:g} s, in contact {self.contact:g} s"


class Simd(Peer):
    name = "C++ SIMD, RK4, smoothed"
    about = f"hand-written, {LANES} lanes abreast, each with its own steps, which end near contact's begin and end"
    lanes = 256

    def __init__(self):
        self._function = None
        self._folder = None

    def missing(self):
        return None if shutil.which("g++") else "g++ is not installed"

    def ladders(self, quick):
        if quick:
            return [[Steps(1e-3, 2.5, 2e-3, 4e-4), Steps(1e-4, 2.5, 2e-3, 2e-4)]]
        coarse = ((1e-3, 4e-4), (2.5e-4, 2e-4), (5e-5, 2e-4), (2.5e-5, 2e-4), (1.2e-5, 2e-4))
        rows = [(width, 2e-3, contact) for width, contact in coarse] + [(2.5e-6, 1e-3, 1e-4), (2.5e-7, 5e-4, 5e-5)]
        return [[Steps(width, 2.5, flight, contact) for width, flight, contact in rows]]

    def run(self, points, setting, settle, observe, judged):
        began = time.perf_counter()
        compiling = 0.0
        if self._function is None:
            self._function = self._built()
            compiling = time.perf_counter() - began
        n = len(points)
        whole = points[np.minimum(np.arange(-(-n // LANES) * LANES), n - 1)]
        period, velocity = np.empty(len(whole)), np.empty(len(whole))
        values = np.array([setting.width, setting.steep, setting.flight, setting.contact])
        began = time.perf_counter()
        self._function(
            len(whole),
            *map(_pointer, whole.columns),
            ctypes.c_double(settle),
            ctypes.c_double(observe),
            _pointer(values),
            CORES,
            _pointer(period),
            _pointer(velocity),
        )
        return Ran(period[:n], velocity[:n], time.perf_counter() - began, compiling)

    def _built(self):
        self._folder = tempfile.TemporaryDirectory()
        library = Path(self._folder.name) / "simd.so"
        source = Path(__file__).with_name("simd.cpp")
        subprocess.run(["g++", *FLAGS, f"-DLANES={LANES}", source, "-o", library], check=True)
        function = ctypes.CDLL(str(library)).simd_run
        function.restype = ctypes.c_long
        return function

    def close(self):
        if self._folder:
            self._folder.cleanup()


def _pointer(array: np.ndarray):
    return array.ctypes.data_as(ctypes.POINTER(ctypes.c_double))

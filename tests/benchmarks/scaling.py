"""Measure the processor time of the parts of a sweep, and the limits of using more threads.

    python tests/benchmarks/scaling.py [SCALE [THREADS ...]]

SCALE multiplies the number of lanes.

A printout, not a test. It takes a minute. Native code runs without the interpreter lock. All other processor time is an
upper bound of the time with the lock, because numpy releases it in large operations. The time with the lock itself is
sampled: a thread without the lock reads the interpreter's flag 20,000 times a second. This needs a C compiler, and
works with the versions of Python that keep the flag where it is expected.
"""

import ctypes
import subprocess
import sys
import tempfile
import threading
import time
from statistics import median

import vibrojax as vj
from vibrojax.compile import native
from vibrojax.compile.xla import with_threads
from vibrojax.maps.read import read_sweep

REPEATS = 3
CASES = {"long": (6000, {"settle": 40.0, "observe": 8.0}), "short": (18000, {"settle": 3.0, "observe": 2.0})}
ROWS = 60
spent: dict[int, float] = {}


def sweep(lanes: int, run: dict):
    axes = {"beta": (0.1, 1.2, ROWS), "gamma": (0.3, 1.2, lanes // ROWS // 2)}
    grid = {name: dict(zip(("start", "stop", "num"), axis, strict=True)) for name, axis in axes.items()}
    return read_sweep({"scene": "vibro-impact", "grid": grid, "starts": ["drive", "stuck"], "run": run})


SAMPLER = """
#include <time.h>
#include <stdint.h>
void sample(volatile int *locked, volatile int *stop, int64_t *counts) {
  struct timespec pause = {0, 50000};
  while (!*stop) { counts[0] += *locked != 0; counts[1]++; nanosleep(&pause, 0); }
}
"""
INTERVAL, SEARCHED = 4321, 20000  # microseconds; words


class HeldLock:
    """A context that samples the share of the time in which some thread has the interpreter lock; NaN if unknown."""

    def __init__(self) -> None:
        """Find the flag beside the switch interval, which is set to an unusual number for the search."""
        usual, self.share, self._address = sys.getswitchinterval(), float("nan"), 0
        sys.setswitchinterval(INTERVAL * 1e-6)
        runtime = ctypes.addressof(ctypes.c_char.in_dll(ctypes.pythonapi, "_PyRuntime"))
        words = (ctypes.c_uint64 * SEARCHED).from_address(runtime)
        places = [k for k in range(SEARCHED - 2) if words[k] == INTERVAL and words[k + 2] & 0xFFFFFFFF in (0, 1)]
        sys.setswitchinterval(usual)
        with tempfile.TemporaryDirectory() as folder:
            command = ["cc", "-x", "c", "-O2", "-shared", "-fPIC", "-o", f"{folder}/sampler.so", "-"]
            try:
                subprocess.run(command, input=SAMPLER.encode(), check=True)
            except (OSError, subprocess.CalledProcessError):
                return
            self._sample = ctypes.CDLL(f"{folder}/sampler.so").sample
        if len(places) == 1:
            self._address = runtime + 8 * (places[0] + 2)

    def __enter__(self) -> "HeldLock":
        self._counts, self._stop = (ctypes.c_int64 * 2)(), ctypes.c_int(0)
        arguments = (ctypes.c_void_p(self._address), ctypes.byref(self._stop), self._counts)
        self._thread = threading.Thread(target=lambda: self._address and self._sample(*arguments))
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.value = 1
        self._thread.join()
        if self._counts[1]:
            self.share = self._counts[0] / self._counts[1]


class TimedKernel(native.Kernel):
    """A kernel that adds the processor time of its native code to `spent`."""

    def __init__(self, *arguments, **options):
        super().__init__(*arguments, **options)
        code = self.code

        def timed(*given):
            began = time.thread_time()
            code(*given)
            thread = threading.get_ident()
            spent[thread] = spent.get(thread, 0.0) + time.thread_time() - began

        self.code = timed


def once(definition, threads: int, lock: HeldLock) -> tuple[float, float, float, float]:
    """Return processor time, its part in native code, wall time [s], and the share with the lock from another run."""
    spent.clear()
    with with_threads(threads):
        processor, clock = time.process_time(), time.perf_counter()
        vj.run_sweep(definition, progress=False)
        processor, clock = time.process_time() - processor, time.perf_counter() - clock
        code = sum(spent.values())
        with lock:
            vj.run_sweep(definition, progress=False)
    return processor, code, clock, lock.share


def main() -> None:
    native.Kernel = TimedKernel
    scale, *asked = [int(text) for text in sys.argv[1:]] or [1]
    lock = HeldLock()
    print("lanes   threads  processor s  native s  other us/lane  share  lock us/lane  share  clock s  gain, 16 and 64")
    for name, (lanes, run) in CASES.items():
        lanes = lanes * scale
        definition = sweep(lanes, run)
        vj.run_sweep(sweep(240, run), progress=False)  # compiles
        time.sleep(1.0)  # the last program compiles in the background
        for threads in asked or [1]:  # the share with the lock is a serial fraction for one thread only
            runs = [once(definition, threads, lock) for _ in range(REPEATS)]
            processor, code, clock, serial = (median(run[k] for run in runs) for k in range(4))
            other, share = 1e6 * (processor - code) / lanes, 1 - code / processor
            gains = " and ".join(f"{1 / (serial + (1 - serial) / n):.1f}" for n in (16, 64))
            print(
                f"{name:8}{threads:7}{processor:13.2f}{code:10.2f}{other:15.1f}{share:7.1%}"
                f"{1e6 * serial * processor / lanes:14.1f}{serial:7.1%}{clock:9.2f}  {gains}",
                flush=True,
            )


if __name__ == "__main__":
    main()

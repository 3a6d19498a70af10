"""Where the processor time of a sweep goes, and what it leaves for more threads.

    python tests/benchmarks/scaling.py [THREADS ...]

A printout, not a test: nothing is asserted. It takes half a minute. Native code runs without the interpreter lock. All
other processor time is an upper bound of the time with the lock, because numpy releases it in large operations.
"""

import sys
import threading
import time
from statistics import median

import vibrojax as vj
from vibrojax.compile.kernels import native
from vibrojax.compile.xla import with_threads
from vibrojax.sweep.input.read import read_sweep

CASES = {"long": (6000, {"settle": 40.0, "observe": 8.0}), "short": (18000, {"settle": 3.0, "observe": 2.0})}
ROWS, REPEATS = 60, 5
spent: dict[int, float] = {}


def sweep(lanes: int, run: dict):
    axes = {"beta": (0.1, 1.2, ROWS), "gamma": (0.3, 1.2, lanes // ROWS // 2)}
    grid = {name: dict(zip(("start", "stop", "num"), axis, strict=True)) for name, axis in axes.items()}
    return read_sweep({"scene": "vibro-impact", "grid": grid, "starts": ["drive", "stuck"], "run": run})


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


def once(definition, threads: int) -> tuple[float, float, float]:
    """Processor time, of it in native code, and time by the clock [s]."""
    spent.clear()
    with with_threads(threads):
        processor, clock = time.process_time(), time.perf_counter()
        vj.run_sweep(definition, progress=False)
        return time.process_time() - processor, sum(spent.values()), time.perf_counter() - clock


def main() -> None:
    native.Kernel = TimedKernel
    asked = [int(text) for text in sys.argv[1:]] or [1, 2]
    print(
        "lanes   threads  processor s  native s  other us/lane  share  clock s  gain with 16 and 64 threads, at least"
    )
    for name, (lanes, run) in CASES.items():
        definition = sweep(lanes, run)
        vj.run_sweep(sweep(240, run), progress=False)  # compiles
        time.sleep(1.0)  # the last program compiles in the background
        for threads in asked:
            runs = [once(definition, threads) for _ in range(REPEATS)]
            processor, code, clock = (median(run[k] for run in runs) for k in range(3))
            other, share = 1e6 * (processor - code) / lanes, 1 - code / processor
            gains = " and ".join(f"{1 / (share + (1 - share) / n):.1f}" for n in (16, 64))
            print(f"{name:8}{threads:7}{processor:13.2f}{code:10.2f}{other:15.1f}{share:7.1%}{clock:9.2f}  {gains}")


if __name__ == "__main__":
    main()

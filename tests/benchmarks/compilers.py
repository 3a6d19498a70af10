"""Time the regime map with kernels and with XLA alone, with cold and warm caches; print seconds and ratios.

    python tests/benchmarks/compilers.py

A printout, not a test. Each run is a separate process; jax's persistent cache is on for both compilers.
"""

import os
import resource
import statistics
import subprocess
import sys
import time
from collections import defaultdict
from tempfile import TemporaryDirectory

REPEATS = 3

PROGRAM = """
import sys
import vibrojax as vj
if sys.argv[1] == "XLA":
    from vibrojax.compile.assembly import Untranslatable
    from vibrojax.lanes import compiler
    def refuse(*arguments, **options):
        raise Untranslatable("measured without kernels")
    compiler.kernel_for = refuse
vj.run_sweep("regime-map", progress=False)
"""


def run(compiler: str, folder: str) -> tuple[float, float]:
    """Return (processor time of all threads, wall time) [s] of one map, with its caches in a folder."""
    caches = {"VIBROJAX_CACHE": f"{folder}/kernels", "JAX_COMPILATION_CACHE_DIR": f"{folder}/jax"}
    always = {"JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0", "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1"}
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run([sys.executable, "-c", PROGRAM, compiler], check=True, env=os.environ | caches | always)
    after, ended = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, ended - began


def main() -> None:
    times = defaultdict(list)
    for _ in range(REPEATS):
        for compiler in ("kernels", "XLA"):
            with TemporaryDirectory() as folder:
                for caches in ("cold", "warm"):
                    times[caches, compiler].append(run(compiler, folder))
    print(f"{'':<6}{'kernels':>18}{'XLA':>18}{'ratio':>8}   processor time (wall time) [s]")
    for caches in ("cold", "warm"):
        kernels, xla = (
            [statistics.median(column) for column in zip(*times[caches, compiler], strict=True)]
            for compiler in ("kernels", "XLA")
        )
        cells = "".join(f"{f'{x[0]:.1f} ({x[1]:.1f})':>18}" for x in (kernels, xla))
        print(f"{caches:<6}{cells}{xla[0] / kernels[0]:>8.1f}")


if __name__ == "__main__":
    main()

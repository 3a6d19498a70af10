"""Compilation of functions of lanes: a function in, a callable out.

A lane is one independent point of a batch. [vibrojax.compile.lane_function][] takes a function whose arguments and
results are pytrees of arrays with the lanes along the last axis. It returns a callable that runs as a native kernel on
CPUs, or through XLA where no kernel can be made:

    @lane_function(static=1, registers=2, policy=policy)
    def settle(scene, state, until): ...

[vibrojax.compile.run_kernel][] does the same without the way through XLA. This folder knows no scenes: a caller whose
functions call foreign code passes a `policy`, which compares kernels of that code with XLA before the first one runs.

- `kernels/`: translation of jax's trace to LLVM's language, compilation, and the cache on disk.
- `xla.py`: XLA's options, and functions that run block by block.
- `agreement.py`, `trust.py`: comparison of a kernel with XLA, and the verdicts.
- `arithmetic.py`: check of elementary functions against numpy. `devices.py`: devices, threads, precision.

**Reason for a second compiler.** On CPUs XLA recomputes shared values across fusions and starts each fusion by itself.
A step of lanes is plain arithmetic with many shared values. As one loop over vectors of lanes, LLVM compiles it in
about a second.

The table (`tests/benchmarks/compilers.py`, `lane_steps.py`) compares kernels with XLA alone. jax's persistent cache is
on for both (`JAX_COMPILATION_CACHE_DIR`, minimum compile time 0). The map is the bundled `regime-map` with 8,280 lanes,
from the start of the process to the finished dataset; *cold* is with empty caches, *warm* is a second process. The
lane-step is one of that scene, with located events and an accepted error of 1e-4.

| processor time | kernels | XLA | ratio |
|---|---|---|---|
| Python 3.11, jax 0.10.2: map, cold | 6.0 s | 32.5 s | 5.4 |
| map, warm | 5.3 s | 20.2 s | 3.8 |
| lane-step | 98 ns | 875 ns | 8.9 |
| Python 3.13, jax 0.12.0.1: map, cold | 6.1 s | 15.9 s | 2.6 |
| map, warm | 5.4 s | 8.3 s | 1.6 |
| lane-step | 99 ns | 246 ns | 2.5 |

These are medians of 3 processes (map) and of 9 runs (lane-step) on an x86-64 machine with AVX-512 and two cores, which
other work shared. Hence the processor time of all threads; wall time was 1.0 to 1.15 times that while the machine was
quieter. A repetition on Python 3.13 gave ratios of 2.7 and 1.5 for the map.

So with the newest jax and a warm cache, kernels save a third of the time to the map. With Python 3.11, for which there
is no later jax than 0.10.2, they save three quarters.

The second reason is identical bits. Kernels gave the same bits with both versions of Python and jax, in sweeps of all
five scenes in both precisions, and in simulations of three. XLA did not: it took 3,142,015 and 3,142,000 steps for
2,048 lanes, kernels took 3,141,996 with both. A lane's bits do not depend either on the lanes beside it or on the width
of the processor's vectors.
"""

from vibrojax.compile.kernels import Untranslatable
from vibrojax.compile.lanes import lane_function
from vibrojax.compile.trust import KernelComparison, KernelRefused, Policy, Subject, run_kernel
from vibrojax.compile.xla import jitted

__all__ = [
    "KernelComparison",
    "KernelRefused",
    "Policy",
    "Subject",
    "Untranslatable",
    "jitted",
    "lane_function",
    "run_kernel",
]

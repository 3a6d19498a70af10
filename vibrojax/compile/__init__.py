"""Compilation of functions of lanes to native kernels.

A lane is one independent trajectory of a batch. [vibrojax.compile.lane_function][] decorates a function whose arguments
and results are pytrees of arrays with the lanes along the last axis. The decorated function runs as a native kernel on
CPUs, or through XLA where no kernel can be made:

    @lane_function(static=1, policy=policy)
    def settle(scene, state, until): ...

[vibrojax.compile.trusted_kernel][] returns the kernel itself, without the fallback to XLA. This folder does not depend
on scenes. The caller's `policy` decides which calls depend on foreign code (code from outside this package). Kernels of
foreign code are compared with XLA before the first of them runs.

- `kernels/`: translation of jax's trace to LLVM's intermediate representation (IR), compilation, and the disk cache.
- `xla.py`: XLA's options, functions that run block by block, devices, threads, precision.
- `agreement.py`, `trust.py`: comparison of a kernel with XLA and of elementary functions with numpy; the decision which
  compiler runs.

**Reason for a second compiler.** On CPUs, XLA recomputes values that several fusions share, and launches each fusion
separately. One time step of all lanes is plain arithmetic with many shared values. LLVM compiles such a step, written
as one loop over vectors of lanes, in about a second.

The table (`tests/benchmarks/compilers.py`, `lane_steps.py`) compares kernels with XLA alone. jax's persistent cache is
on for both (`JAX_COMPILATION_CACHE_DIR`, minimum compile time 0). The rows *map* measure the bundled `regime-map` with
8,280 lanes, from the launch of the process to the finished dataset. *Cold* means empty caches; *warm* means a second
process. The rows *lane-step* measure one time step of one lane of the same scene, with located events and an error
tolerance of 1e-4.

| processor time | kernels | XLA | ratio |
|---|---|---|---|
| Python 3.11, jax 0.10.2: map, cold | 6.0 s | 32.5 s | 5.4 |
| map, warm | 5.3 s | 20.2 s | 3.8 |
| lane-step | 98 ns | 875 ns | 8.9 |
| Python 3.13, jax 0.12.0.1: map, cold | 6.1 s | 15.9 s | 2.6 |
| map, warm | 5.4 s | 8.3 s | 1.6 |
| lane-step | 99 ns | 246 ns | 2.5 |

These are medians of 3 processes (map) and of 9 runs (lane-step) on an x86-64 machine with AVX-512 and two cores. Other
programs shared that machine, so the table lists the processor time of all threads. While the machine was less loaded,
the wall time was 1.0 to 1.15 times the processor time. A repetition on Python 3.13 gave ratios of 2.7 and 1.5 for the
map.

With the newest jax and a warm cache, kernels thus save a third of the time that the map takes. With Python 3.11, which
supports no jax later than 0.10.2, kernels save three quarters.

The second reason is bitwise reproducibility. Kernels gave the same bits with both versions of Python and jax, in sweeps
of all five scenes in both precisions, and in simulations of three scenes. XLA did not: for the same 2,048 lanes it took
3,142,015 steps with one version and 3,142,000 with the other. Kernels took 3,141,996 steps with both. A lane's bits
depend neither on the other lanes of the batch nor on the width of the processor's vectors.
"""

from vibrojax.compile.kernels import Untranslatable
from vibrojax.compile.trust import KernelRefused, Policy, Subject, lane_function, trusted_kernel
from vibrojax.compile.xla import jitted

__all__ = [
    "KernelRefused",
    "Policy",
    "Subject",
    "Untranslatable",
    "jitted",
    "lane_function",
    "trusted_kernel",
]

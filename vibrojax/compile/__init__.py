"""Compilation of functions of lanes to native kernels.

A lane is one independent trajectory of a batch. [vibrojax.compile.lane_function][] decorates a function whose arguments
and results are pytrees of arrays with the lanes along the last axis. The decorated function runs as a native kernel on
CPUs, or through XLA where no kernel can be made:

    @lane_function(static=1, policy=policy)
    def settle(scene, state, until): ...

[vibrojax.compile.trusted_kernel][] returns the kernel itself, without the fallback to XLA. This folder does not depend
on scenes. The caller's `policy` decides which calls depend on foreign code (code from outside this package). If its
instructions are not covered by the tests, it is compared with XLA before the first of its kernels runs.

- `translation.py`, `assembly.py`, `native.py` and others: translation of jax's trace to LLVM's intermediate
  representation (IR), compilation; `cache.py`: the disk cache; `identity.py`: what decides a trace.
- `trees.py`: arguments and results as pytrees, without jax.
- `xla.py`: XLA's options, functions that run block by block, devices, threads, precision.
- `foreign.py`, `agreement.py`, `trust.py`: whether foreign code needs a comparison; comparison of a kernel with XLA and
  of elementary functions with numpy; the decision which compiler runs.

A kernel has the semantics of jax. Each translation rule is correct for the types that it accepts. All other cases raise
`Untranslatable`, and XLA runs the lanes. Three things differ from XLA on a CPU:

- Subnormal numbers keep their value (XLA flushes them to 0).
- Functions of the C library, such as `exp`, are rounded differently.
- The sign of a sum of zeros and the bits of a NaN may differ.

The width of the processor's vectors changes no bit of a lane, because the lanes of a group share only loops and
branches. Fused multiply-add does change bits: a processor without it rounds each product before the sum.

**Reason for a second compiler.** On CPUs, XLA recomputes values that several fusions share, and launches each fusion
separately. One time step of all lanes is plain arithmetic with many shared values. LLVM compiles such a step, written
as one loop over vectors of lanes, in about a second.

`tests/benchmarks/compilers.py` and `lane_steps.py` compare kernels with XLA alone, both with jax's persistent cache.
*map* is the bundled `regime-map`, from the launch of the process to the dataset, with empty caches (cold) and in a
second process (warm). *lane-step* is one time step of one lane at an error tolerance of 1e-4.

| processor time | kernels | XLA | ratio |
|---|---|---|---|
| Python 3.11, jax 0.10.2: map, cold | 6.0 s | 32.5 s | 5.4 |
| map, warm | 5.3 s | 20.2 s | 3.8 |
| lane-step | 98 ns | 875 ns | 8.9 |
| Python 3.13, jax 0.12.0.1: map, cold | 6.1 s | 15.9 s | 2.6 |
| map, warm | 5.4 s | 8.3 s | 1.6 |
| lane-step | 99 ns | 246 ns | 2.5 |

These are medians of 3 processes (map) and of 9 runs (lane-step) on two shared cores with AVX-512.

The second reason is bitwise reproducibility. Kernels gave the same bits with both versions of Python and jax, in sweeps
of all five scenes in both precisions; XLA did not. A lane's bits depend neither on the other lanes of the batch nor on
the width of the processor's vectors.
"""

from vibrojax.compile.assembly import Untranslatable
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

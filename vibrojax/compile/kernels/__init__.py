"""Kernels: functions of lanes compiled to machine code from jax's trace.

XLA compiles a function of lanes in seconds and launches its parts separately. A time step is plain arithmetic, the same
for every lane. Here it is translated from jax's trace to instructions for vectors of lanes, which LLVM compiles in a
tenth of the time. The kernel runs as one loop, and its results do not depend on the version of jax.

A kernel has the semantics of jax. Each translation rule is correct for the types that it accepts. All other cases raise
`Untranslatable`, and XLA runs the lanes. Three things differ from XLA on a CPU:

- Subnormal numbers keep their value (XLA flushes them to 0).
- Functions of the C library, such as `exp`, are rounded differently.
- The sign of a sum of zeros and the bits of a NaN may differ.

The width of the processor's vectors changes no bit of a lane, because the lanes of a group share only loops and
branches. Fused multiply-add does change bits: a processor without it rounds each product before the sum.
"""

from vibrojax.compile.kernels.assembly import LANES, Untranslatable
from vibrojax.compile.kernels.native import BoundKernel, Kernel, kernel_for, kernels, trace

__all__ = ["LANES", "BoundKernel", "Kernel", "Untranslatable", "kernel_for", "kernels", "trace"]

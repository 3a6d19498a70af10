"""Kernels: functions of lanes as machine code, from the same equations that jax traces.

XLA compiles a program of lanes in seconds, and starts its pieces one by one. A step of lanes is plain arithmetic, the
same for every lane. Written from jax's trace for vectors of lanes, it is compiled by LLVM in a tenth of the time. It
runs as one loop, and does not depend on the version of jax.

A kernel means what jax means: each rule is right for the types that it accepts, and `Untranslatable` refuses the rest,
so that XLA runs the lanes. Three things differ from XLA on a CPU. Subnormal numbers count (XLA takes them for 0).
Functions of the C library, such as `exp`, are rounded differently. The sign of a sum of zeros may differ, and so may
the bits of a NaN.

The width of the processor's vectors changes no bit of a lane: a group of lanes shares only its loops and branches.
Fused multiply-add does: a processor without it rounds products before sums.
"""

from vibrojax.compile.kernels.kernel import Kernel, kernel_for, kernels, trace
from vibrojax.compile.kernels.operands import LANES, Untranslatable

__all__ = ["LANES", "Kernel", "Untranslatable", "kernel_for", "kernels", "trace"]

"""Functions of lanes as machine code, of the same equations that jax traces.

XLA compiles a program of lanes in seconds, and starts its pieces one by one. What a step of lanes does is plain
arithmetic, the same for every lane: written out from jax's own trace for vectors of lanes, LLVM compiles it in a tenth
of the time, and it runs as one loop, whatever the version of jax.

A kernel means what jax means: each rule is right for the types that it accepts, and `Untranslatable` refuses the rest,
so that XLA runs the lanes. Three things differ from XLA on a CPU. Subnormal numbers count (XLA takes them for 0).
Functions of the C library, such as `exp`, are rounded differently. The sign of a sum of zeros may differ, and the bits
of a NaN.

The width of the processor's vectors changes no bit of a lane: a group of lanes shares only its loops and branches.
Fused multiply-add does: a processor without it rounds products before sums.
"""

from vibrojax.compile.kernels.kernel import Kernel, trace
from vibrojax.compile.kernels.made import kernels, made, run
from vibrojax.compile.kernels.operands import LANES, Untranslatable

__all__ = ["LANES", "Kernel", "Untranslatable", "kernels", "made", "run", "trace"]

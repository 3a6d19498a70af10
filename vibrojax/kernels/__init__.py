"""Functions of lanes as machine code, of the same equations that jax traces.

XLA compiles a program of lanes in seconds, and starts its pieces one by one. What a step of lanes does is plain
arithmetic, the same for every lane: written out from jax's own trace for vectors of lanes, LLVM compiles it in a tenth
of the time, and it runs as one loop, whatever the version of jax.
"""

from vibrojax.kernels.kernel import Kernel
from vibrojax.kernels.made import kernels, run
from vibrojax.kernels.native import vector_bytes
from vibrojax.kernels.operands import Untranslatable

__all__ = ["Kernel", "Untranslatable", "kernels", "run", "vector_bytes"]

"""Compilation of functions of lanes to native kernels.

A lane is one independent trajectory of a batch. [vibrojax.compile.native.kernel_for][] compiles a function whose
arguments and results are pytrees of arrays with the lanes along the last axis to a native kernel for CPUs. Where no
kernel can be made, XLA compiles the function ([vibrojax.lanes.compiler.lane_function][]).

A kernel has the semantics of jax. Each translation rule is correct for the types and parameters that it accepts: the
tests compare random programs of all rules with XLA, bit for bit. All other cases, such as parameters of a later jax,
raise `Untranslatable`, and XLA runs the lanes. Three things differ from XLA on a CPU:

- Subnormal numbers keep their value (XLA flushes them to 0).
- Functions of the C library, such as `exp`, are rounded differently.
- The sign of a sum of zeros and the bits of a NaN may differ.

The width of the processor's vectors changes no bit of a lane, because the lanes of a group share only loops and
branches. Fused multiply-add does change bits: a processor without it rounds each product before the sum.

**Reason for a second compiler.** On CPUs, XLA recomputes values that several fusions share, and launches each fusion
separately. One time step of all lanes is plain arithmetic with many shared values. LLVM compiles such a step, written
as one loop over vectors of lanes, in about a second.

`tests/benchmarks/README.md` compares the times of both compilers.

The second reason is bitwise reproducibility. Kernels gave the same bits with both versions of Python and jax, in sweeps
of all five scenes in both precisions; XLA did not. A lane's bits depend neither on the other lanes of the batch nor on
the width of the processor's vectors.
"""

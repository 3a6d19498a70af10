"""Functions of lanes compiled to kernels, as in sweeps. XLA takes several times as long to compile them."""

from functools import partial

import jax
import numpy as np

from vibrojax.compile.native import Kernel


def by_kernels(static):
    """Return a decorator like `jax.jit` with the first arguments static. One program serves any number of lanes."""

    def decorate(function):
        kernels = {}

        def call(*arguments):
            fixed, given = arguments[:static], jax.tree.map(np.asarray, arguments[static:])
            key = fixed, tuple((x.dtype, x.ndim) for x in jax.tree.leaves(given))
            if key not in kernels:
                kernels[key] = Kernel(partial(function, *fixed), *given)
            return kernels[key](*given)

        return call

    return decorate

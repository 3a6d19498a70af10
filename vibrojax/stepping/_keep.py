"""Values that are worked out once."""

from jax import lax


def keep(values):
    """The same values, held in memory.

    XLA's CPU compiler works a value out again in every fusion that reads it; in a step, where everything depends on
    everything before, that multiplies the arithmetic. A barrier ends the fusion.
    """
    return lax.optimization_barrier(values)

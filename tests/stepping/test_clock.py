"""The clock of a lane: no time is lost over a long run, in either precision."""

from fractions import Fraction

import jax
import jax.numpy as jnp
import pytest

from vibrojax.stepping import Clock

STEPS = 3_000_000


@jax.jit
def ticked(clock, dt):
    """`clock` after so many steps of `dt` [s], and a plain sum of them."""

    def tick(_, both):
        clock, total = both
        return clock.advanced(dt), total + dt

    return jax.lax.fori_loop(0, STEPS, tick, (clock, clock.high))


@pytest.mark.parametrize(("dtype", "bound"), [("float32", 2e-3), ("float64", 1e-11)])
def test_three_million_steps_lose_nothing(dtype, bound):
    """10^5 cycles are some 3e6 steps and 4e4 s: the clock tells n dt to half of its last digit, where a plain sum has
    drifted by thousands of them."""
    zero, dt = jnp.zeros((), dtype), jnp.asarray(0.0127, dtype)
    clock, plain = ticked(Clock(zero, zero), dt)
    exact = STEPS * Fraction(float(dt))
    told = Fraction(float(clock.high)) + Fraction(float(clock.low))
    assert abs(float(told - exact)) < bound
    assert abs(float(Fraction(float(plain)) - exact)) > 1000 * bound
    assert float(clock.until(jnp.asarray(float(exact), dtype))) == pytest.approx(0.0, abs=2 * bound)

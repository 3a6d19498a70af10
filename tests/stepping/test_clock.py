"""Test that the clock of a lane loses no time over a long run, in either precision."""

from fractions import Fraction

import jax
import jax.numpy as jnp
import pytest

from vibrojax.stepping import Clock

STEPS = 3_000_000


@jax.jit
def tick_many_times(clock, dt):
    """Return `clock` after STEPS steps of `dt` [s], and the plain sum."""

    def tick(_, both):
        clock, total = both
        return clock.advanced(dt), total + dt

    return jax.lax.fori_loop(0, STEPS, tick, (clock, clock.high))


@pytest.mark.parametrize(("dtype", "bound"), [("float32", 2e-3), ("float64", 1e-11)])
def test_clock_is_exact_over_three_million_steps(dtype, bound):
    """Some 3e6 steps make 10^5 cycles, or 4e4 s. The clock gives n dt to half a unit in the last place, while a plain
    sum drifts by thousands of these units.
    """
    zero, dt = jnp.zeros((), dtype), jnp.asarray(0.0127, dtype)
    clock, plain = tick_many_times(Clock(zero, zero), dt)
    exact = STEPS * Fraction(float(dt))
    clock_time = Fraction(float(clock.high)) + Fraction(float(clock.low))
    assert abs(float(clock_time - exact)) < bound
    assert abs(float(Fraction(float(plain)) - exact)) > 1000 * bound
    assert float(clock.until(jnp.asarray(float(exact), dtype))) == pytest.approx(0.0, abs=2 * bound)

"""Arithmetic that steps and measures use in place of a library's: a root, a cosine and sine, a polynomial's maximum."""

from math import factorial

import jax.numpy as jnp
import numpy as np
import pytest

from vibrojax.measures.motion import cos_sin
from vibrojax.stepping.polynomial import highest, rough_root


@pytest.mark.parametrize("dtype", ["float64", "float32"])
@pytest.mark.parametrize("n", [7, 9, 11])
def test_rough_root(dtype, n):
    x = np.exp(np.linspace(-80, 80, 9999)).astype(dtype)
    ratio = np.asarray(rough_root(jnp.asarray(x), n)) / x.astype(float) ** (1 / n)
    assert ratio.min() > 1 - 1e-5 and ratio.max() < 1.07
    zero, infinite, unknown = rough_root(jnp.asarray([0.0, np.inf, np.nan], dtype), n)
    assert zero < 1e-3 and infinite > 1 and unknown > 1


def test_cos_sin():
    angle = np.linspace(-300, 300, 20001)
    cos, sin = cos_sin(jnp.asarray(angle))
    np.testing.assert_allclose(cos, np.cos(angle), rtol=0, atol=1e-15)
    np.testing.assert_allclose(sin, np.sin(angle), rtol=0, atol=1e-15)


def test_highest():
    """A wave of 2 rad, the longest stride, is 1 at its top; a rise is highest at its end, a fall at its start."""
    quarter = np.pi / 2
    wave = [jnp.full(2, np.sin(0.3 + k * quarter) * 2.0**k / factorial(k)) for k in range(18)]
    np.testing.assert_allclose(highest(wave, jnp.asarray([1.0, 0.4])), [1.0, np.sin(1.1)], rtol=1e-10)
    fall = [-c for c in wave]
    np.testing.assert_allclose(highest(fall, jnp.asarray([0.2, 0.4])), -np.sin(0.3), rtol=1e-12)

"""Gauge of the phase lag between the fundamental harmonics of striker and bit."""

from dataclasses import dataclass
from math import factorial, pi
from typing import Any

import jax
import jax.numpy as jnp

from vibrojax.measures.gauge import Gauge, Moment, Sums, Whole
from vibrojax.models.arrays import Lanes, keep
from vibrojax.models.scenes.scene import Scene
from vibrojax.stepping.polynomial import value

GAUSS_NODE = 0.15**0.5
"""Distance of the outer nodes of three-point Gauss quadrature from the middle of a step, as a fraction of the step."""


@dataclass(frozen=True)
class Harmonics(Gauge[Scene[Any]]):
    """phase_lag [rad] in (-pi, pi]: lag of the striker's position (x2) behind the bit's position (x1).

    The frequency of the harmonics is the frequency of the section crossings. The Fourier integrals of a position minus
    its mean use three-point Gauss quadrature on the steps' polynomials. Steps before the frequency is known are left
    out. If a period has several return intervals, the frequency follows from their mean duration.
    """

    summed = ("known", "cos0", "sin0", "mean1", "cos1", "sin1", "mean2", "cos2", "sin2")

    def increments(self, scene: Scene[Any], c: Any, moment: Moment) -> Sums:
        step = moment.step
        dt = jnp.where(moment.frequency > 0, step.dt, 0)
        turned = moment.frequency * step.dt
        cos, sin = keep(cos_sin(moment.phase - turned / 2))
        cos_off, sin_off = keep(cos_sin(turned * GAUSS_NODE))
        outer, inner = dt * (5 / 18), dt * (4 / 9)
        waves = keep(
            [
                (outer, outer * (cos * cos_off + sin * sin_off), outer * (sin * cos_off - cos * sin_off)),
                (inner, inner * cos, inner * sin),
                (outer, outer * (cos * cos_off - sin * sin_off), outer * (sin * cos_off + cos * sin_off)),
            ]
        )
        known, cos, sin = (sum(wave) for wave in zip(*waves, strict=True))
        sums = {"known": known, "cos0": cos, "sin0": sin}
        assert scene.section is not None
        for name, swing in zip(("1", "2"), scene.section.swings, strict=False):
            x = step.polynomials[scene.place(swing.position)]
            values = keep([value(x, step.tau * (0.5 + node)) for node in (-GAUSS_NODE, 0.0, GAUSS_NODE)])
            for kind, weight in zip(("mean", "cos", "sin"), zip(*waves, strict=True), strict=True):
                sums[kind + name] = sum(k * y for k, y in zip(weight, values, strict=True))
        return sums

    def read(self, scene: Scene[Any], c: Any, carry: Any, whole: Whole) -> dict[str, Lanes]:
        sums = whole.sums

        def integral(kind: str, name: str) -> Lanes:
            return sums[kind + name] - sums["mean" + name] / sums["known"] * sums[kind + "0"]

        cos1, sin1, cos2, sin2 = (integral(kind, name) for name in "12" for kind in ("cos", "sin"))
        # The striker's lag is arg(X2* X1) with X = cos - i sin.
        across = sin2 * cos1 - cos2 * sin1
        along = cos2 * cos1 + sin2 * sin1
        lag = jnp.arctan2(across, along)
        return {"phase_lag": jnp.where((across == 0) & (along == 0), jnp.nan, lag)}


_COS = [(-1.0) ** k / factorial(2 * k) for k in range(9)]
_SIN = [(-1.0) ** k / factorial(2 * k + 1) for k in range(9)]
# pi/2 as a sum of two numbers. The first has so few digits that its product with any number of quarters used here is
# exact.
_QUARTER = 1.5707963109016418
_REST = 1.5893254773528196e-08


def cos_sin(angle: Lanes) -> tuple[jax.Array, jax.Array]:
    """Return (cos, sin) of `angle` [rad] of any shape, accurate to a few rounding errors of the angle.

    On a CPU, the library functions would be called for one lane at a time. Instead, Taylor polynomials are evaluated
    for angles up to pi/4 and rotated by multiples of pi/2.
    """
    quarters = jnp.round(angle * (2 / pi))
    rest = (angle - quarters * _QUARTER) - quarters * _REST
    square = rest * rest
    cos, sin = value(_COS, square), rest * value(_SIN, square)
    odd = quarters - 2 * jnp.floor(quarters / 2) > 0.5
    cos, sin = jnp.where(odd, sin, cos), jnp.where(odd, cos, sin)
    quarter = quarters - 4 * jnp.floor(quarters / 4)
    return jnp.where((quarter > 0.5) & (quarter < 2.5), -cos, cos), jnp.where(quarter > 1.5, -sin, sin)

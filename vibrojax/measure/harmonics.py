"""How far the striker's fundamental lags the bit's."""

from dataclasses import dataclass

import jax.numpy as jnp

from vibrojax.measure._gauge import Gauge
from vibrojax.measure._waves import cos_sin
from vibrojax.stepping import keep
from vibrojax.stepping.polynomial import value

_NODE = 0.15**0.5
"""Of the outer points, from the middle of the step, as a fraction of it."""


@dataclass(frozen=True)
class Harmonics(Gauge):
    """phase_lag [rad] of x2 behind x1 at the frequency of the returns, in (-pi, pi].

    Fourier integrals of x less its mean, by Gauss's rule of three points on the steps' polynomials. Steps before the
    frequency is known are left out. Where returns alternate, this is the harmonic of the repeat that their mean period
    belongs to.
    """

    summed = ("known", "cos0", "sin0", "mean1", "cos1", "sin1", "mean2", "cos2", "sin2")

    def increments(self, scene, p, moment):
        step = moment.step
        dt = jnp.where(moment.frequency > 0, step.dt, 0)
        turned = moment.frequency * step.dt
        cos, sin = keep(cos_sin(moment.phase - turned / 2))
        cos_off, sin_off = keep(cos_sin(turned * _NODE))
        outer, inner = dt * (5 / 18), dt * (4 / 9)
        waves = keep(
            [
                (outer, outer * (cos * cos_off + sin * sin_off), outer * (sin * cos_off - cos * sin_off)),
                (inner, inner * cos, inner * sin),
                (outer, outer * (cos * cos_off - sin * sin_off), outer * (sin * cos_off + cos * sin_off)),
            ]
        )
        known, cos, sin = (sum(wave) for wave in zip(*waves, strict=True))
        found = {"known": known, "cos0": cos, "sin0": sin}
        for name, index in (("1", 0), ("2", 2)):
            x = step.polynomials[index]
            values = keep([value(x, step.tau * (0.5 + node)) for node in (-_NODE, 0.0, _NODE)])
            for kind, weight in zip(("mean", "cos", "sin"), zip(*waves, strict=True), strict=True):
                found[kind + name] = sum(k * y for k, y in zip(weight, values, strict=True))
        return found

    def read(self, scene, p, carry, whole):
        sums = whole.sums

        def integral(kind, name):
            return sums[kind + name] - sums["mean" + name] / sums["known"] * sums[kind + "0"]

        cos1, sin1, cos2, sin2 = (integral(kind, name) for name in "12" for kind in ("cos", "sin"))
        # arg(X2* X1) of X = cos - i sin: how far the striker is behind.
        across = sin2 * cos1 - cos2 * sin1
        along = cos2 * cos1 + sin2 * sin1
        lag = jnp.arctan2(across, along)
        return {"phase_lag": jnp.where((across == 0) & (along == 0), jnp.nan, lag)}

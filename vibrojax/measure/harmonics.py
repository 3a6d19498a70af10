"""How far the striker's fundamental lags the bit's."""

from dataclasses import dataclass

import jax.numpy as jnp

from vibrojax.measure._gauge import Gauge
from vibrojax.stepping import keep
from vibrojax.stepping.polynomial import value


@dataclass(frozen=True)
class Harmonics(Gauge):
    """phase_lag [rad] of x2 behind x1 at the frequency of the returns, in (-pi, pi].

    Fourier integrals of x less its mean, by Simpson's rule on the steps' polynomials. Steps before the frequency is
    known are left out. Where returns alternate, this is the harmonic of the repeat that their mean period belongs to.
    """

    summed = ("known", "cos0", "sin0", "mean1", "cos1", "sin1", "mean2", "cos2", "sin2")

    def increments(self, scene, p, moment):
        step = moment.step
        dt = jnp.where(moment.frequency > 0, step.dt, 0)
        weights = [dt / 6, dt * (2 / 3), dt / 6]
        start, end = moment.phase - moment.frequency * step.dt, moment.phase
        waves = keep(
            [(k, k * jnp.cos(a), k * jnp.sin(a)) for k, a in zip(weights, (start, (start + end) / 2, end), strict=True)]
        )
        known, cos, sin = (sum(wave) for wave in zip(*waves, strict=True))
        found = {"known": known, "cos0": cos, "sin0": sin}
        for name, index in (("1", 0), ("2", 2)):
            x = step.polynomials[index]
            values = keep([x[0], value(x, step.tau / 2), value(x, step.tau)])
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

"""How far the striker's fundamental lags the bit's."""

from dataclasses import dataclass

import jax.numpy as jnp

from vibrojax.measure._gauge import Gauge
from vibrojax.stepping import keep
from vibrojax.stepping.polynomial import value


@dataclass(frozen=True)
class Harmonics(Gauge):
    """phase_lag [rad] of x2 behind x1 at the frequency of the returns, in (-pi, pi].

    The Fourier integrals of each return run from its own beginning at the mean frequency of the last ones, by Simpson's
    rule on the step's polynomials.
    """

    summed = ("cos1", "sin1", "cos2", "sin2")

    def increments(self, scene, p, moment):
        step = moment.step
        start, end = moment.frequency * (moment.since - step.dt), moment.frequency * moment.since
        middle = (start + end) / 2
        weights = [step.dt / 6, step.dt * (2 / 3), step.dt / 6]
        phases = keep([(jnp.cos(a), jnp.sin(a)) for a in (start, middle, end)])
        found = {}
        for name, index in (("1", 0), ("2", 2)):
            x = step.polynomials[index]
            values = keep([x[0], value(x, step.tau / 2), value(x, step.tau)])
            found["cos" + name] = sum(k * y * c for k, y, (c, _) in zip(weights, values, phases, strict=True))
            found["sin" + name] = sum(k * y * s for k, y, (_, s) in zip(weights, values, phases, strict=True))
        return found

    def read(self, scene, p, carry, whole):
        sums = whole.sums
        # arg(X2* X1) of X = cos - i sin: how far the striker is behind.
        across = sums["sin2"] * sums["cos1"] - sums["cos2"] * sums["sin1"]
        along = sums["cos2"] * sums["cos1"] + sums["sin2"] * sums["sin1"]
        lag = jnp.arctan2(across, along)
        return {"phase_lag": jnp.where((across == 0) & (along == 0), jnp.nan, lag)}

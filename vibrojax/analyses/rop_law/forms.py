"""The forms of the rate-of-penetration law that are fitted beside each other.

The source's law, rate = C ln(P/D) (eq. 6.4), gives a negative rate where the relief P/D is below 1. It is therefore
read in three ways, as printed, with P/D in percent, and with an onset, and compared with a line and a power law.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Float

from vibrojax.analyses.rop_law.least_squares import LaneFlags, LaneValues, Minimum, Number, Theta, linear, nonlinear
from vibrojax.models.arrays import Array

Coefficients = Float[Array, " 3"]
"""C [rate's unit], eta0 [1], exponent [1]; NaN where the form has none."""


@dataclass(frozen=True)
class Frame:
    """Where a form's variable t lies in one group: z = (t − centre)/spread, so that coefficients are of order one."""

    centre: Number
    spread: Number


@dataclass(frozen=True)
class Proportional:
    """rate = C t(eta): one coefficient, linear."""

    name: str
    formula: str
    variable: Callable[[Array], Array]
    size: ClassVar[int] = 1

    def frame(self, t: LaneValues, lanes: LaneFlags) -> Frame:
        """The frame of the `lanes` at a rate above zero."""
        return Frame(jnp.zeros(()), jnp.sqrt(_mean(t**2, lanes)))

    def predict(self, theta: Theta, z: LaneValues) -> LaneValues:
        """The rate."""
        return theta[0] * z

    def start(self, z: LaneValues, rate: LaneValues, lanes: LaneFlags) -> Theta:
        """Where a search begins; there is none for a linear form."""
        return jnp.zeros(self.size)

    def minimum(
        self, z: LaneValues, rate: LaneValues, weight: LaneValues, censored: LaneFlags, start: Theta
    ) -> Minimum:
        """The least squares of the rate."""
        return linear(z[:, None], rate, weight, censored)

    def coefficients(self, theta: Theta, frame: Frame) -> Coefficients:
        """Theta in terms of the law."""
        return jnp.array([theta[0] / frame.spread, jnp.nan, jnp.nan])


@dataclass(frozen=True)
class WithOnset:
    """rate = C (t(eta) − t(eta0)): two coefficients, linear in C and C t(eta0)."""

    name: str
    formula: str
    variable: Callable[[Array], Array]
    inverse: Callable[[Array], Array]
    size: ClassVar[int] = 2

    def frame(self, t: LaneValues, lanes: LaneFlags) -> Frame:
        """The frame of the `lanes` at a rate above zero."""
        return _standard(t, lanes)

    def predict(self, theta: Theta, z: LaneValues) -> LaneValues:
        """The rate."""
        return theta[0] + theta[1] * z

    def start(self, z: LaneValues, rate: LaneValues, lanes: LaneFlags) -> Theta:
        """Where a search begins; there is none for a linear form."""
        return jnp.zeros(self.size)

    def minimum(
        self, z: LaneValues, rate: LaneValues, weight: LaneValues, censored: LaneFlags, start: Theta
    ) -> Minimum:
        """The least squares of the rate."""
        return linear(jnp.stack([jnp.ones_like(z), z], axis=1), rate, weight, censored)

    def coefficients(self, theta: Theta, frame: Frame) -> Coefficients:
        """Theta in terms of the law."""
        eta0 = self.inverse(frame.centre - frame.spread * theta[0] / theta[1])
        return jnp.array([theta[1] / frame.spread, eta0, jnp.nan])


@dataclass(frozen=True)
class Power:
    """rate = C eta^exponent with C > 0, as exp(ln C + exponent ln eta): two coefficients, not linear."""

    name: str
    formula: str
    size: ClassVar[int] = 2
    greatest: ClassVar[float] = 60.0  # of the exponent, so that a wild step does not overflow

    def variable(self, eta: Array) -> Array:
        """t(eta)."""
        return jnp.log(eta)

    def frame(self, t: LaneValues, lanes: LaneFlags) -> Frame:
        """The frame of the `lanes` at a rate above zero."""
        return _standard(t, lanes)

    def predict(self, theta: Theta, z: LaneValues) -> LaneValues:
        """The rate."""
        return jnp.exp(jnp.minimum(theta[0] + theta[1] * z, self.greatest))

    def start(self, z: LaneValues, rate: LaneValues, lanes: LaneFlags) -> Theta:
        """The straight line through the logarithms, weighted by rate² so that its errors are about those of rates."""
        weight, log = lanes * rate**2, jnp.log(jnp.where(lanes, rate, 1.0))
        total = jnp.sum(weight)
        z_mean, log_mean = jnp.sum(weight * z) / total, jnp.sum(weight * log) / total
        slope = jnp.sum(weight * (z - z_mean) * (log - log_mean)) / jnp.sum(weight * (z - z_mean) ** 2)
        return jnp.stack([log_mean - slope * z_mean, slope])

    def minimum(
        self, z: LaneValues, rate: LaneValues, weight: LaneValues, censored: LaneFlags, start: Theta
    ) -> Minimum:
        """The least squares of the rate."""
        return nonlinear(lambda theta: self.predict(theta, z), start, rate, weight, censored)

    def coefficients(self, theta: Theta, frame: Frame) -> Coefficients:
        """Theta in terms of the law."""
        exponent = theta[1] / frame.spread
        return jnp.array([jnp.exp(theta[0] - exponent * frame.centre), jnp.nan, exponent])


Form = Proportional | WithOnset | Power


def _percent(eta: Array) -> Array:
    return jnp.log(100 * eta)


def _itself(eta: Array) -> Array:
    return eta


FORMS: tuple[Form, ...] = (
    Proportional("literal", "C ln(eta)", jnp.log),
    Proportional("percent", "C ln(100 eta)", _percent),
    WithOnset("onset", "C ln(eta/eta0)", jnp.log, jnp.exp),
    WithOnset("line", "C (eta - eta0)", _itself, _itself),
    Power("power", "C eta^exponent"),
)

LOGARITHMIC = ("literal", "percent", "onset")
"""The three readings of the source's law, eq. 6.4."""


def _mean(x: LaneValues, lanes: LaneFlags) -> Number:
    return jnp.sum(jnp.where(lanes, x, 0.0)) / jnp.sum(jnp.where(lanes, 1.0, 0.0))


def _standard(t: LaneValues, lanes: LaneFlags) -> Frame:
    centre = _mean(t, lanes)
    return Frame(centre, jnp.sqrt(_mean((t - centre) ** 2, lanes)))

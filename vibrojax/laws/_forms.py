"""The forms of the rate-of-penetration law that are fitted beside each other (reading R9)."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import jax.numpy as jnp
from jax import Array


@dataclass(frozen=True)
class Frame:
    """Where a form's variable t lies in one group: z = (t − centre)/spread, so that coefficients are of order one."""

    centre: Array
    spread: Array


@dataclass(frozen=True)
class Proportional:
    """rate = C t(eta): one coefficient, linear."""

    name: str
    formula: str
    variable: Callable[[Array], Array]
    size: ClassVar[int] = 1
    linear: ClassVar[bool] = True

    def frame(self, t: Array, lanes: Array) -> Frame:
        return Frame(jnp.zeros(()), jnp.sqrt(_mean(t**2, lanes)))

    def columns(self, z: Array) -> Array:
        return z[:, None]

    def predict(self, theta: Array, z: Array) -> Array:
        return theta[0] * z

    def coefficients(self, theta: Array, frame: Frame) -> Array:
        """C, eta0, exponent; NaN where the form has none."""
        return jnp.array([theta[0] / frame.spread, jnp.nan, jnp.nan])


@dataclass(frozen=True)
class Chord:
    """rate = C (t(eta) − t(eta0)): two coefficients, linear in C and C t(eta0)."""

    name: str
    formula: str
    variable: Callable[[Array], Array]
    inverse: Callable[[Array], Array]
    size: ClassVar[int] = 2
    linear: ClassVar[bool] = True

    def frame(self, t: Array, lanes: Array) -> Frame:
        return _standard(t, lanes)

    def columns(self, z: Array) -> Array:
        return jnp.stack([jnp.ones_like(z), z], axis=1)

    def predict(self, theta: Array, z: Array) -> Array:
        return theta[0] + theta[1] * z

    def coefficients(self, theta: Array, frame: Frame) -> Array:
        """C, eta0, exponent; NaN where the form has none."""
        eta0 = self.inverse(frame.centre - frame.spread * theta[0] / theta[1])
        return jnp.array([theta[1] / frame.spread, eta0, jnp.nan])


@dataclass(frozen=True)
class Power:
    """rate = C eta^exponent with C > 0, as exp(ln C + exponent ln eta): two coefficients, not linear."""

    name: str
    formula: str
    size: ClassVar[int] = 2
    linear: ClassVar[bool] = False
    greatest: ClassVar[float] = 60.0  # of the exponent, so that a wild step does not overflow

    def variable(self, eta: Array) -> Array:
        return jnp.log(eta)

    def frame(self, t: Array, lanes: Array) -> Frame:
        return _standard(t, lanes)

    def predict(self, theta: Array, z: Array) -> Array:
        return jnp.exp(jnp.minimum(theta[0] + theta[1] * z, self.greatest))

    def start(self, z: Array, rate: Array, lanes: Array) -> Array:
        """The straight line through the logarithms, weighted by rate² so that its errors are about those of rates."""
        weight, log = lanes * rate**2, jnp.log(jnp.where(lanes, rate, 1.0))
        total = jnp.sum(weight)
        z_mean, log_mean = jnp.sum(weight * z) / total, jnp.sum(weight * log) / total
        slope = jnp.sum(weight * (z - z_mean) * (log - log_mean)) / jnp.sum(weight * (z - z_mean) ** 2)
        return jnp.stack([log_mean - slope * z_mean, slope])

    def coefficients(self, theta: Array, frame: Frame) -> Array:
        """C, eta0, exponent; NaN where the form has none."""
        exponent = theta[1] / frame.spread
        return jnp.array([jnp.exp(theta[0] - exponent * frame.centre), jnp.nan, exponent])


Form = Proportional | Chord | Power


def _percent(eta: Array) -> Array:
    return jnp.log(100 * eta)


def _itself(eta: Array) -> Array:
    return eta


FORMS: tuple[Form, ...] = (
    Proportional("literal", "C ln(eta)", jnp.log),
    Proportional("percent", "C ln(100 eta)", _percent),
    Chord("onset", "C ln(eta/eta0)", jnp.log, jnp.exp),
    Chord("line", "C (eta - eta0)", _itself, _itself),
    Power("power", "C eta^exponent"),
)

LOGARITHMIC = ("literal", "percent", "onset")
"""The three readings of the source's law, eq. 6.4."""


def _mean(x: Array, lanes: Array) -> Array:
    return jnp.sum(jnp.where(lanes, x, 0.0)) / jnp.sum(lanes)


def _standard(t: Array, lanes: Array) -> Frame:
    centre = _mean(t, lanes)
    return Frame(centre, jnp.sqrt(_mean((t - centre) ** 2, lanes)))

"""Taylor series of the elementary functions, computed with the recurrences from their differential equations."""

from collections.abc import Callable

import jax.numpy as jnp

from vibrojax.models.arrays import Value
from vibrojax.models.physics import elementary
from vibrojax.stepping.series import (
    Number,
    Sequence,
    Series,
    Terms,
    by_rule,
    combined,
    constant,
    kept,
    terms_of,
    times,
    total,
)


@elementary.exp.register
def _exp(a: Series) -> Series:
    """Return e = exp(a) from e' = a' e, so k e_k = sum_j j a_j e_{k-j}."""
    inside = terms_of(a)

    def term(k: int, e: Terms) -> Number:
        return total(times(times(j / k, inside[j]), e[k - j]) for j in range(1, k + 1))

    return by_rule(jnp.exp(a.value), term)


@elementary.log.register
def _log(a: Series) -> Series:
    """Return y = log(a) from a y' = a'."""
    inside = terms_of(a)

    def term(k: int, y: Terms) -> Number:
        return (a[k] - total(times(times(j / k, y[j]), inside[k - j]) for j in range(1, k))) / inside[0]

    return by_rule(jnp.log(a.value), term)


@elementary.sqrt.register
def _sqrt(a: Series) -> Series:
    """Return the Taylor series of sqrt(a), by a recurrence for its coefficients that follows from y² = a."""

    def term(k: int, y: Terms) -> Number:
        return (a[k] - total(times(y[j], y[k - j]) for j in range(1, k))) / (2 * y[0])

    return by_rule(jnp.sqrt(a.value), term)


@elementary.power.register
def _power(a: Series, exponent: Value) -> Series:
    """Return y = a^s from a y' = s a' y, so k a_0 y_k = sum_j (s j - (k - j)) a_j y_{k-j}."""
    inside = terms_of(a)

    def term(k: int, y: Terms) -> Number:
        factors = (times(exponent * (j / k) - (k - j) / k, inside[j]) for j in range(1, k + 1))
        return total(times(factor, y[k - j]) for j, factor in enumerate(factors, start=1)) / inside[0]

    return by_rule(a.value**exponent, term)


@elementary.sin.register
def _sin(a: Series) -> Series:
    return _sine_and_cosine(a)[0]


@elementary.cos.register
def _cos(a: Series) -> Series:
    return _sine_and_cosine(a)[1]


def _sine_and_cosine(a: Series) -> tuple[Series, Series]:
    """Return s = sin(a) and c = cos(a), from s' = a' c and c' = -a' s."""
    inside = terms_of(a)
    s, c = (Terms(kept(of(a.value))) for of in (jnp.sin, jnp.cos))
    s.rest, c.rest = _integral(inside, c, 1.0), _integral(inside, s, -1.0)
    return Series(s.value, {s.rest: 1.0}), Series(c.value, {c.rest: 1.0})


@elementary.tanh.register
def _tanh(a: Series) -> Series:
    """Return y = tanh(a) from y' = a' w, w = 1 - y²."""
    value = kept(jnp.tanh(a.value))
    y, w = Terms(value), Terms(kept(1.0 - value * value))
    w.rest = Sequence(lambda k: times(-1.0, total(times(y[j], y[k - j]) for j in range(k + 1))))
    y.rest = _integral(terms_of(a), w, 1.0)
    return Series(y.value, {y.rest: 1.0})


def _integral(inside: Terms, other: Terms, sign: float) -> Sequence:
    """Return the coefficients from c_1 on of y with y' = sign a' other."""

    def term(k: int) -> Number:
        return total(times(times(sign * j / k, inside[j]), other[k - j]) for j in range(1, k + 1))

    return Sequence(term)


@elementary.arctan.register
def _arctan(a: Series) -> Series:
    """Return y = arctan(a) from y' (1 + a²) = a'."""
    below = terms_of(a * a + 1.0)

    def term(k: int, y: Terms) -> Number:
        return (a[k] - total(times(times(j / k, y[j]), below[k - j]) for j in range(1, k))) / below[0]

    return by_rule(jnp.arctan(a.value), term)


@elementary.maximum.register
def _maximum(a: Series, b: Series | Value) -> Series:
    """Return the series, `a` or `b`, whose value is greater at the start of the step."""
    other = b if isinstance(b, Series) else constant(b)
    first = a.value >= other.value
    choose: Callable[[Number, Number], Number] = lambda f, g: jnp.where(first, f, g)  # noqa: E731
    return combined(choose(a.value, other.value), a, other, choose)


@elementary.absolute.register
def _absolute(a: Series) -> Series:
    """Return `a` or `-a`, whichever is positive at the start of the step."""
    return a * jnp.where(a.value < 0, -1.0, 1.0)

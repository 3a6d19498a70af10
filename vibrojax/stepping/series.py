"""Truncated Taylor series in the scaled time of one step: the arithmetic of the located stepper.

Coefficients are computed one order at a time, so that the next coefficient of a state may depend on all lower
coefficients. In this way the solution of an ordinary differential equation is expanded (Jorba and Zou, Experimental
Mathematics 14 (2005); Biscani and Izzo, heyoka, MNRAS 504 (2021)). Equations written with +, -, *, / and
[vibrojax.models.physics.elementary][] accept series unchanged.

Most equations are linear. A series is therefore stored as its value at the start of the step and a linear combination
of coefficient sequences: one per state, and one per product, quotient or function. Sums and scalings only change the
factors of the combination, which are computed once per step and not at every order.
"""

from collections.abc import Callable, Iterable, Iterator
from typing import Any

import jax
import jax.numpy as jnp

from vibrojax.models.arrays import Array, Lanes, Real, Value, keep

Number = Any
"""A coefficient: an array (lanes,) or a float. The float 0.0 means that the coefficient is identically zero."""


def is_zero(x: Number) -> bool:
    """Return whether a coefficient is identically zero (the float 0.0)."""
    return isinstance(x, float) and x == 0.0


def kept(c: Number) -> Number:
    """Return the coefficient behind an optimization barrier, so that it is computed only once."""
    return c if isinstance(c, float) else keep(c)


def plus(a: Number, b: Number) -> Number:
    """Return a + b, leaving out a term that is identically zero."""
    if is_zero(a):
        return b
    return a if is_zero(b) else a + b


def times(a: Number, b: Number) -> Number:
    """Return a b, or the float 0.0 if a factor is identically zero."""
    return 0.0 if is_zero(a) or is_zero(b) else a * b


def total(terms: Iterable[Number]) -> Number:
    """Return the sum of coefficients, leaving out terms that are identically zero."""
    result: Number = 0.0
    for term in terms:
        result = plus(result, term)
    return result


class Sequence:
    """Coefficients c_1, c_2, ..., each either appended or computed by `term(k)` at its first use."""

    def __init__(self, term: Callable[[int], Number] | None = None, known: Iterable[Number] = ()):
        self._term = term
        self._known = list(known)

    def __getitem__(self, order: int) -> Number:
        while len(self._known) < order:
            assert self._term is not None, "the coefficient is neither known nor given by a rule"
            self.append(self._term(len(self._known) + 1))
        return self._known[order - 1]

    def append(self, c: Number) -> None:
        """Add the next coefficient."""
        self._known.append(kept(c))


class Series:
    """A series sum_k c_k tau^k.

    `value` is c_0. For k >= 1, c_k is a linear combination of the sequences in `parts`, which maps each sequence to its
    factor. Value and factors are arrays of one shape (lanes) or floats; the float 0.0 means identically zero.
    """

    __array_priority__ = 1000  # so that array * series calls __rmul__ of the series
    __array_ufunc__ = None

    def __init__(self, value: Number, parts: dict[Sequence, Number]):
        self.value = value
        self.parts = {sequence: factor for sequence, factor in parts.items() if not is_zero(factor)}
        self._factors: list[Number] | None = None
        self._sequence: Sequence | None = None

    def __getitem__(self, order: int) -> Number:
        if order == 0:
            return self.value
        if self._factors is None:
            self._factors = [kept(factor) for factor in self.parts.values()]
        return total(times(f, s[order]) for f, s in zip(self._factors, self.parts, strict=True))

    def array(self, order: int, like: Lanes) -> jax.Array:
        """Return the coefficient of tau^order as an array with the shape of `like`, also if it is a float."""
        c = self[order]
        return jnp.full_like(like, c) if isinstance(c, float) else c

    def arrays(self, order: int, like: Lanes) -> list[Array]:
        """Return the coefficients up to tau^order as arrays with the shape of `like`."""
        return [self.array(k, like) for k in range(order + 1)]

    def sequence(self) -> Sequence:
        """Return c_1, c_2, ... as one sequence, for nonlinear functions."""
        if self._sequence is None:
            [*parts] = self.parts.items()
            single = len(parts) == 1 and isinstance(parts[0][1], float) and parts[0][1] == 1.0
            self._sequence = parts[0][0] if single else Sequence(lambda k: self[k])
        return self._sequence

    def __add__(self, other: "Series | Value") -> "Series":
        if isinstance(other, Series):
            return combined(plus(self.value, other.value), self, other, plus)
        return Series(self.value + other, self.parts)

    __radd__ = __add__

    def __neg__(self) -> "Series":
        return self * -1.0

    def __sub__(self, other: "Series | Value") -> "Series":
        return self + (-other)

    def __rsub__(self, other: "Series | Value") -> "Series":
        return -self + other

    def __mul__(self, other: "Series | Value") -> "Series":
        if not isinstance(other, Series):
            return Series(times(self.value, other), {s: times(f, other) for s, f in self.parts.items()})
        if not other.parts:
            return self * other.value
        return other * self.value if not self.parts else _product(self, other)

    __rmul__ = __mul__

    def __truediv__(self, other: "Series | Value") -> "Series":
        if not isinstance(other, Series):
            return self * (1 / other)
        return _quotient(self, other) if other.parts else self * (1 / other.value)

    def __rtruediv__(self, other: "Series | Value") -> "Series":
        return constant(other) / self


def constant(value: Number) -> Series:
    """Return the series of a value that is constant within the step."""
    return Series(value, {})


def known(coefficients: list[Any]) -> Series:
    """Return the series with the specified coefficients c_0, c_1, ..."""
    return Series(coefficients[0], {Sequence(known=coefficients[1:]): 1.0})


def combined(value: Number, a: Series, b: Series, factor: Callable[[Number, Number], Number]) -> Series:
    """Return the series with this value whose factors are `factor(f, g)`.

    f and g are the factors of the same sequence in `a` and `b`, 0.0 where the sequence is missing.
    """
    sequences = dict.fromkeys((*a.parts, *b.parts))
    return Series(value, {s: factor(a.parts.get(s, 0.0), b.parts.get(s, 0.0)) for s in sequences})


class Terms:
    """The coefficients c_0, c_1, ... of a series."""

    def __init__(self, value: Number, rest: Sequence | None = None):
        self.value, self.rest = value, rest

    def __getitem__(self, order: int) -> Number:
        if order == 0:
            return self.value
        assert self.rest is not None
        return self.rest[order]


def by_rule(value: Number, term: Callable[[int, Terms], Number]) -> Series:
    """Return the series with c_0 = `value` and c_k = `term(k, terms)`, where `terms` has the lower coefficients."""
    value = kept(value)
    terms = Terms(value)
    rest = terms.rest = Sequence(lambda k: term(k, terms))
    return Series(value, {rest: 1.0})


def terms_of(a: Series) -> Terms:
    """Return the coefficients c_0, c_1, ... of a series."""
    return Terms(a.value, a.sequence())


def _product(a: Series, b: Series) -> Series:
    """Return the series with c_k = sum_j a_j b_{k-j}; for a square, equal products are computed only once."""
    first, second = terms_of(a), terms_of(b)

    def square_terms(k: int) -> Iterator[Number]:
        for j in range((k + 1) // 2):
            yield times(times(2.0, first[j]), first[k - j])
        if k % 2 == 0:
            yield times(first[k // 2], first[k // 2])

    if a is b:
        return by_rule(times(a.value, a.value), lambda k, _: total(square_terms(k)))
    return by_rule(times(a.value, b.value), lambda k, _: total(times(first[j], second[k - j]) for j in range(k + 1)))


def _quotient(a: Series, b: Series) -> Series:
    """Return q = a/b from a_k = sum_j q_j b_{k-j}."""
    below = terms_of(b)

    def term(k: int, q: Terms) -> Number:
        return (a[k] - total(times(q[j], below[k - j]) for j in range(k))) / b.value

    return by_rule(a.value / b.value, term)


def expand(
    field: Callable[[tuple[Series, ...]], tuple[Any, ...]], state: tuple[Array, ...], h: Real, order: int
) -> tuple[Series, ...]:
    """Return the Taylor series in tau = time/h, up to tau^order, of the solution of y' = field(y) from `state`.

    **Arguments:**

    - `field`: function that takes and returns a tuple of series, one per state. An entry of the result may be one of
      its arguments (x' = v).
    - `state`: tuple of arrays (lanes,); `h`: array (lanes,) [s].

    **Returns:** one series per state, with coefficients up to `order`.
    """
    sequences = tuple(Sequence() for _ in state)
    series = tuple(Series(value, {own: 1.0}) for value, own in zip(state, sequences, strict=True))
    changes = [rate * h for rate in field(series)]
    for k in range(order):
        coefficients = [times(1 / (k + 1), change[k]) for change in changes]
        for own, c in zip(sequences, coefficients, strict=True):
            own.append(c)
    return series

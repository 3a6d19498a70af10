"""Truncated Taylor series in the time of one step: the arithmetic of the located stepper.

Coefficients are computed one order at a time, so that a state's next coefficient may depend on all lower ones. This
expands an ordinary differential equation (Jorba and Zou, Experimental Mathematics 14 (2005); Biscani and Izzo, heyoka,
MNRAS 504 (2021)). Physics written with +, -, *, / and [vibrojax.models.physics.elementary][] accepts series unchanged.

Most physics is linear. A series is therefore its value at the start of the step, and beyond that a linear combination
of sequences: one per state, and one per product, quotient or function. Sums and scalings in equations only change the
combination's factors, which are computed once per step and not at every order.
"""

from collections.abc import Callable, Iterable, Iterator
from typing import Any

import jax
import jax.numpy as jnp

from vibrojax.models.arrays import Array, Lanes, Real, Value, keep

Number = Any
"""A coefficient: an array (lanes,) or a float; the float 0.0 vanishes by the structure of the equations."""


def is_zero(x: Number) -> bool:
    """Return True if a coefficient vanishes by the structure of the equations."""
    return isinstance(x, float) and x == 0.0


def kept(c: Number) -> Number:
    """Return a coefficient that is computed only once."""
    return c if isinstance(c, float) else keep(c)


def plus(a: Number, b: Number) -> Number:
    """Return a + b, without terms that vanish."""
    if is_zero(a):
        return b
    return a if is_zero(b) else a + b


def times(a: Number, b: Number) -> Number:
    """Return a b, 0.0 if a factor vanishes."""
    return 0.0 if is_zero(a) or is_zero(b) else a * b


def total(terms: Iterable[Number]) -> Number:
    """Return the sum of coefficients, without terms that vanish."""
    result: Number = 0.0
    for term in terms:
        result = plus(result, term)
    return result


class Sequence:
    """Coefficients c_1, c_2, ..., each computed by `term(k)` at its first use, or appended."""

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
    """A series sum_k c_k tau^k: `value` = c_0, and `parts`, the factors of the sequences whose combination is c_k.

    Values and factors are arrays of one shape (lanes) or floats; the float 0.0 vanishes by structure.
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
        """Return the coefficient of tau^order as an array shaped like `like`, even if it is a float by structure."""
        c = self[order]
        return jnp.full_like(like, c) if isinstance(c, float) else c

    def arrays(self, order: int, like: Lanes) -> list[Array]:
        """Return the coefficients up to tau^order as arrays shaped like `like`."""
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
    """Return the series with the given coefficients, from c_0 on."""
    return Series(coefficients[0], {Sequence(known=coefficients[1:]): 1.0})


def combined(value: Number, a: Series, b: Series, factor: Callable[[Number, Number], Number]) -> Series:
    """Return the series whose factors are `factor(a's, b's)`, with 0.0 for a missing part."""
    sequences = dict.fromkeys((*a.parts, *b.parts))
    return Series(value, {s: factor(a.parts.get(s, 0.0), b.parts.get(s, 0.0)) for s in sequences})


class Terms:
    """The coefficients of a series from c_0 on."""

    def __init__(self, value: Number, rest: Sequence | None = None):
        self.value, self.rest = value, rest

    def __getitem__(self, order: int) -> Number:
        if order == 0:
            return self.value
        assert self.rest is not None
        return self.rest[order]


def by_rule(value: Number, term: Callable[[int, Terms], Number]) -> Series:
    """Return the series of a value and a rule for c_k, called with the lower coefficients."""
    value = kept(value)
    terms = Terms(value)
    rest = terms.rest = Sequence(lambda k: term(k, terms))
    return Series(value, {rest: 1.0})


def terms_of(a: Series) -> Terms:
    """Return the coefficients of a series from c_0 on."""
    return Terms(a.value, a.sequence())


def _product(a: Series, b: Series) -> Series:
    """Return the series of c_k = sum_j a_j b_{k-j}; a square needs half of the products, twice."""
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
    """Return the Taylor series of the solution of y' = field(y) from `state`, in tau = time/h, up to tau^order.

    **Arguments:**

    - `field`: takes and returns a tuple of series, one per state; an entry may be a state's own series (x' = v).
    - `state`: tuple of arrays (lanes); `h`: array (lanes) [s].

    **Returns:** one series per state, known up to `order`.
    """
    sequences = tuple(Sequence() for _ in state)
    series = tuple(Series(value, {own: 1.0}) for value, own in zip(state, sequences, strict=True))
    changes = [rate * h for rate in field(series)]
    for k in range(order):
        coefficients = [times(1 / (k + 1), change[k]) for change in changes]
        for own, c in zip(sequences, coefficients, strict=True):
            own.append(c)
    return series

"""Truncated Taylor series in the time of one step: the arithmetic of the located stepper.

A series' coefficients are worked out one order at a time, so that a state's next coefficient may depend on all lower
ones: this is how an ordinary differential equation is expanded (Jorba and Zou, Experimental Mathematics 14 (2005);
Biscani and Izzo, heyoka, MNRAS 504 (2021)). Physics written with +, -, *, / and [vibrojax.models.physics.elementary][]
runs on it unchanged.

Most of physics is linear. A series is therefore its value where the step starts, and beyond that a linear combination
of sequences: the states', and one for each product, quotient or function. What equations add and scale becomes the
combination's factors, which are worked out once per step, not at every order.
"""

from collections.abc import Callable, Iterable, Iterator
from typing import Any

import jax
import jax.numpy as jnp

from vibrojax.models.arrays import Array, Lanes, Real, Value, keep

Number = Any
"""A coefficient: an array (lanes,) or a float, of which 0.0 is what the structure makes vanish."""


def is_zero(x: Number) -> bool:
    """Whether a coefficient vanishes by the structure of the equations."""
    return isinstance(x, float) and x == 0.0


def kept(c: Number) -> Number:
    """A coefficient that is worked out once."""
    return c if isinstance(c, float) else keep(c)


def plus(a: Number, b: Number) -> Number:
    """a + b, without what vanishes."""
    if is_zero(a):
        return b
    return a if is_zero(b) else a + b


def times(a: Number, b: Number) -> Number:
    """a b, without what vanishes."""
    return 0.0 if is_zero(a) or is_zero(b) else a * b


def total(terms: Iterable[Number]) -> Number:
    """The sum of coefficients, without what vanishes."""
    found: Number = 0.0
    for term in terms:
        found = plus(found, term)
    return found


class Sequence:
    """Coefficients c_1, c_2, ..., each found by `term(k)` when it is first asked for, or appended."""

    def __init__(self, term: Callable[[int], Number] | None = None, known: Iterable[Number] = ()):
        self._term = term
        self._known = list(known)

    def __getitem__(self, order: int) -> Number:
        while len(self._known) < order:
            assert self._term is not None, "a coefficient that is neither known nor follows from a rule"
            self.append(self._term(len(self._known) + 1))
        return self._known[order - 1]

    def append(self, c: Number) -> None:
        """Add the next coefficient."""
        self._known.append(kept(c))


class Series:
    """A series sum_k c_k tau^k: `value` = c_0, and c_k of the sum of factor times sequence, `parts`.

    Values and factors are arrays of one shape (lanes) or floats; the float 0.0 is what the structure makes vanish.
    """

    __array_priority__ = 1000  # so that array * series comes here
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
        """The coefficient of tau^order as an array shaped like `like`, where the structure makes it a number too."""
        c = self[order]
        return jnp.full_like(like, c) if isinstance(c, float) else c

    def sequence(self) -> Sequence:
        """c_1, c_2, ... as one sequence, for what is not linear."""
        if self._sequence is None:
            [*alone] = self.parts.items()
            own = len(alone) == 1 and isinstance(alone[0][1], float) and alone[0][1] == 1.0
            self._sequence = alone[0][0] if own else Sequence(lambda k: self[k])
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
    """A value that does not change within the step."""
    return Series(value, {})


def known(coefficients: list[Any]) -> Series:
    """A series whose coefficients are given, from c_0 on."""
    return Series(coefficients[0], {Sequence(known=coefficients[1:]): 1.0})


def combined(value: Number, a: Series, b: Series, factor: Callable[[Number, Number], Number]) -> Series:
    """The series whose factors are `factor(a's, b's)`, 0.0 where one has no such part."""
    sequences = dict.fromkeys((*a.parts, *b.parts))
    return Series(value, {s: factor(a.parts.get(s, 0.0), b.parts.get(s, 0.0)) for s in sequences})


def by_rule(value: Number, term: Callable[[int, "Coefficients"], Number]) -> Series:
    """A series by its value and a rule for c_k, which is given the coefficients from c_0 on that are known."""
    value = kept(value)
    coefficients = Coefficients(value)
    rest = coefficients.rest = Sequence(lambda k: term(k, coefficients))
    return Series(value, {rest: 1.0})


class Coefficients:
    """Coefficients of a series from c_0 on."""

    def __init__(self, value: Number, rest: Sequence | None = None):
        self.value, self.rest = value, rest

    def __getitem__(self, order: int) -> Number:
        if order == 0:
            return self.value
        assert self.rest is not None
        return self.rest[order]


def coefficients_of(a: Series) -> Coefficients:
    """The coefficients of a series from c_0 on."""
    return Coefficients(a.value, a.sequence())


def _product(a: Series, b: Series) -> Series:
    """c_k = sum_j a_j b_{k-j}; of a square half of them, twice."""
    one, two = coefficients_of(a), coefficients_of(b)
    if a is b:
        return by_rule(times(a.value, a.value), lambda k, _: total(_square_terms(one, k)))
    return by_rule(times(a.value, b.value), lambda k, _: total(times(one[j], two[k - j]) for j in range(k + 1)))


def _square_terms(a: Coefficients, k: int) -> Iterator[Number]:
    for j in range((k + 1) // 2):
        yield times(times(2.0, a[j]), a[k - j])
    if k % 2 == 0:
        yield times(a[k // 2], a[k // 2])


def _quotient(a: Series, b: Series) -> Series:
    """q = a/b from a_k = sum_j q_j b_{k-j}."""
    below = coefficients_of(b)

    def term(k: int, q: Coefficients) -> Number:
        return (a[k] - total(times(q[j], below[k - j]) for j in range(k))) / b.value

    return by_rule(a.value / b.value, term)


def expand(
    field: Callable[[tuple[Series, ...]], tuple[Any, ...]], state: tuple[Array, ...], h: Real, order: int
) -> tuple[Series, ...]:
    """Taylor coefficients of the solution of y' = field(y) from `state`, in tau = time/h, up to tau^order.

    **Arguments:**

    - `field`: takes and returns a tuple of series, one per state; an entry may be a state's own series (x' = v).
    - `state`: tuple of arrays (lanes).
    - `h`: array (lanes) [s].

    **Returns:** one series per state, known up to `order`.
    """
    sequences = tuple(Sequence() for _ in state)
    series = tuple(Series(value, {own: 1.0}) for value, own in zip(state, sequences, strict=True))
    changes = [rate * h for rate in field(series)]
    for k in range(order):
        found = [times(1 / (k + 1), change[k]) for change in changes]
        for own, c in zip(sequences, found, strict=True):
            own.append(c)
    return series

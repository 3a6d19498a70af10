"""Truncated Taylor series in the scaled time of one step: the arithmetic of the located stepper.

Coefficients are computed one order at a time, so that the next coefficient of a state may depend on all lower
coefficients. In this way the solution of an ordinary differential equation is expanded (Jorba and Zou, Experimental
Mathematics 14 (2005); Biscani and Izzo, heyoka, MNRAS 504 (2021)). Equations written with +, -, *, / and
[vibrojax.physics.elementary][] accept series unchanged.

Most equations are linear. A series is therefore stored as its value at the start of the step and a linear combination
of coefficient sequences: one per state, and one per product, quotient or function. Sums and scalings only change the
factors of the combination, which are computed once per step and not at every order.
"""

from collections.abc import Callable, Iterable, Iterator
from typing import Any

from vibrojax.lazy import jnp
from vibrojax.physics import elementary
from vibrojax.physics.arrays import Array, Lanes, Real, Value, keep

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
    """Coefficients c_0, c_1, ..., which are known, appended, or computed by `term(k)` at their first use."""

    def __init__(self, *known: Number, term: Callable[[int], Number] | None = None):
        self.term = term
        self._known = list(known)

    def __getitem__(self, order: int) -> Number:
        while len(self._known) <= order:
            assert self.term is not None, "the coefficient is neither known nor given by a rule"
            self.append(self.term(len(self._known)))
        return self._known[order]

    def append(self, c: Number) -> None:
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

    def arrays(self, order: int, like: Lanes) -> list[Array]:
        """Return the coefficients up to tau^order as arrays with the shape of `like`, also those that are floats."""
        coefficients = [self[k] for k in range(order + 1)]
        return [jnp.full_like(like, c) if isinstance(c, float) else c for c in coefficients]

    def sequence(self) -> Sequence:
        """Return c_0, c_1, ... as one sequence, for nonlinear functions."""
        if self._sequence is None:
            [*parts] = self.parts.items()
            single = len(parts) == 1 and isinstance(parts[0][1], float) and parts[0][1] == 1.0
            source = parts[0][0] if single else self
            if isinstance(source, Sequence) and source[0] is self.value:
                self._sequence = source
            else:
                self._sequence = Sequence(self.value, term=source.__getitem__)
        return self._sequence

    def __add__(self, other: "Series | Value") -> "Series":
        if isinstance(other, Series):
            return combined(self, other, plus)
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
        return Series(other, {}) / self

    def __pow__(self, exponent: "Value | int") -> "Series":
        return elementary.integer_power(self, exponent)

    def __abs__(self) -> "Series":
        return elementary.absolute(self)


def known(coefficients: list[Any]) -> Series:
    """Return the series with the specified coefficients c_0, c_1, ..."""
    return _series_of(Sequence(*coefficients))


def _series_of(sequence: Sequence) -> Series:
    return Series(sequence[0], {sequence: 1.0})


def combined(a: Series, b: Series, factor: Callable[[Number, Number], Number]) -> Series:
    """Return the series whose value and factors are `factor(f, g)` of those in `a` and `b`.

    The factor of a sequence that is missing in `a` or `b` is 0.0 there.
    """
    sequences = dict.fromkeys((*a.parts, *b.parts))
    value = factor(a.value, b.value)
    return Series(value, {s: factor(a.parts.get(s, 0.0), b.parts.get(s, 0.0)) for s in sequences})


def by_rule(value: Number, term: Callable[[int, Sequence], Number]) -> Series:
    """Return the series with c_0 = `value` and c_k = `term(k, c)`, where `c` has the lower coefficients."""
    c = Sequence(kept(value))
    c.term = lambda k: term(k, c)
    return _series_of(c)


def _product(a: Series, b: Series) -> Series:
    """Return the series with c_k = sum_j a_j b_{k-j}; for a square, equal products are computed only once."""
    first, second = a.sequence(), b.sequence()

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
    below = b.sequence()
    return by_rule(
        a.value / b.value, lambda k, q: (a[k] - total(times(q[j], below[k - j]) for j in range(k))) / b.value
    )


def _integral(k: int, a: Sequence, w: Sequence, sign: float = 1.0) -> Number:
    """Return the coefficient of tau^k of y with y' = sign a' w, so k y_k = sign sum_j j a_j w_{k-j}."""
    return total(times(times(sign * j / k, a[j]), w[k - j]) for j in range(1, k + 1))


def _integral_of_quotient(value: Number, a: Series, w: Sequence) -> Series:
    """Return y with y_0 = `value` and y' w = a'."""

    def term(k: int, y: Sequence) -> Number:
        return (a[k] - total(times(times(j / k, y[j]), w[k - j]) for j in range(1, k))) / w[0]

    return by_rule(value, term)


@elementary.exp.register
def _exp(a: Series) -> Series:
    """Return e = exp(a) from e' = a' e."""
    inside = a.sequence()
    return by_rule(jnp.exp(a.value), lambda k, e: _integral(k, inside, e))


@elementary.log.register
def _log(a: Series) -> Series:
    """Return y = log(a) from a y' = a'."""
    return _integral_of_quotient(jnp.log(a.value), a, a.sequence())


@elementary.arctan.register
def _arctan(a: Series) -> Series:
    """Return y = arctan(a) from y' (1 + a²) = a'."""
    below = (a * a + 1.0).sequence()
    return _integral_of_quotient(jnp.arctan(a.value), a, below)


@elementary.sqrt.register
def _sqrt(a: Series) -> Series:
    """Return y = sqrt(a) from y² = a."""
    return by_rule(
        jnp.sqrt(a.value), lambda k, y: (a[k] - total(times(y[j], y[k - j]) for j in range(1, k))) / (2 * y[0])
    )


@elementary.power.register
def _power(a: Series, exponent: Value) -> Series:
    """Return y = a^s from a y' = s a' y, so k a_0 y_k = sum_j (s j - (k - j)) a_j y_{k-j}."""
    inside = a.sequence()

    def term(k: int, y: Sequence) -> Number:
        factors = (times(exponent * (j / k) - (k - j) / k, inside[j]) for j in range(1, k + 1))
        return total(times(factor, y[k - j]) for j, factor in enumerate(factors, start=1)) / inside[0]

    return by_rule(a.value**exponent, term)


def _sine_and_cosine(a: Series) -> tuple[Series, Series]:
    """Return s = sin(a) and c = cos(a), from s' = a' c and c' = -a' s."""
    inside, s, c = a.sequence(), Sequence(kept(jnp.sin(a.value))), Sequence(kept(jnp.cos(a.value)))
    s.term, c.term = (lambda k: _integral(k, inside, c)), (lambda k: _integral(k, inside, s, -1.0))
    return _series_of(s), _series_of(c)


elementary.sin.register(Series, lambda a: _sine_and_cosine(a)[0])
elementary.cos.register(Series, lambda a: _sine_and_cosine(a)[1])


@elementary.tanh.register
def _tanh(a: Series) -> Series:
    """Return y = tanh(a) from y' = a' w, w = 1 - y²."""
    value = kept(jnp.tanh(a.value))
    y, w = Sequence(value), Sequence(kept(1.0 - value * value))
    w.term = lambda k: times(-1.0, total(times(y[j], y[k - j]) for j in range(k + 1)))
    inside = a.sequence()
    y.term = lambda k: _integral(k, inside, w)
    return _series_of(y)


@elementary.greater.register
def _maximum(a: Series, b: Series | Value) -> Series:
    """Return the series, `a` or `b`, whose value is greater at the start of the step."""
    other = b if isinstance(b, Series) else Series(b, {})
    first = a.value >= other.value
    return combined(a, other, lambda f, g: jnp.where(first, f, g))


@elementary.magnitude.register
def _absolute(a: Series) -> Series:
    """Return `a` or `-a`, whichever is positive at the start of the step."""
    return a * jnp.where(a.value < 0, -1.0, 1.0)


@elementary.whole.register
def _whole(a: Series) -> Any:
    """Return the floor of `a` at the start of the step."""
    return jnp.floor(a.value)


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
    sequences = tuple(map(Sequence, state))
    series = tuple(map(_series_of, sequences))
    changes = [rate * h for rate in field(series)]
    for k in range(order):
        coefficients = [times(1 / (k + 1), change[k]) for change in changes]
        for own, c in zip(sequences, coefficients, strict=True):
            own.append(c)
    return series

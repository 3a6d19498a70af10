"""Truncated Taylor series in the time of one step: the arithmetic of the located stepper.

A series' coefficients are worked out one order at a time, so that a state's next coefficient may depend on all lower
ones: this is how an ordinary differential equation is expanded (Jorba and Zou, Experimental Mathematics 14 (2005);
Biscani and Izzo, heyoka, MNRAS 504 (2021)). Physics written with +, -, *, / and [vibrojax.physics.elementary][] runs on
it unchanged.

Most of physics is linear. A series is therefore its value where the step starts, and beyond that a linear combination
of sequences: the states', and one for each product, quotient or function. What equations add and scale becomes the
combination's factors, which are worked out once per step, not at every order.
"""

from collections.abc import Callable

import jax.numpy as jnp

from vibrojax.physics import elementary
from vibrojax.stepping._keep import keep


def _is_zero(x) -> bool:
    return isinstance(x, float) and x == 0.0


def _keep(c):
    return c if isinstance(c, float) else keep(c)


def _add(a, b):
    if _is_zero(a):
        return b
    return a if _is_zero(b) else a + b


def _multiply(a, b):
    return 0.0 if _is_zero(a) or _is_zero(b) else a * b


def _total(terms):
    total = 0.0
    for term in terms:
        total = _add(total, term)
    return total


class Sequence:
    """Coefficients c_1, c_2, ..., each found by `term(k)` when it is first asked for, or appended."""

    def __init__(self, term: Callable | None = None, known=()):
        self._term = term
        self._known = list(known)

    def __getitem__(self, order: int):
        while len(self._known) < order:
            self.append(self._term(len(self._known) + 1))
        return self._known[order - 1]

    def append(self, c) -> None:
        """Add the next coefficient."""
        self._known.append(_keep(c))


class Series:
    """A series sum_k c_k tau^k: `value` = c_0, and c_k of the sum of factor times sequence, `parts`.

    Values and factors are arrays of one shape (lanes) or floats; the float 0.0 is what the structure makes vanish.
    """

    __array_priority__ = 1000  # so that array * series comes here
    __array_ufunc__ = None

    def __init__(self, value, parts: dict):
        self.value = value
        self.parts = {sequence: factor for sequence, factor in parts.items() if not _is_zero(factor)}
        self._factors: list | None = None
        self._sequence: Sequence | None = None

    def __getitem__(self, order: int):
        if order == 0:
            return self.value
        if self._factors is None:
            self._factors = [_keep(factor) for factor in self.parts.values()]
        return _total(_multiply(f, s[order]) for f, s in zip(self._factors, self.parts, strict=True))

    def array(self, order: int, like):
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

    def __add__(self, other):
        if isinstance(other, Series):
            return _combined(_add(self.value, other.value), self, other, _add)
        return Series(self.value + other, self.parts)

    __radd__ = __add__

    def __neg__(self):
        return self * -1.0

    def __sub__(self, other):
        return self + (-other)

    def __rsub__(self, other):
        return -self + other

    def __mul__(self, other):
        if not isinstance(other, Series):
            return Series(_multiply(self.value, other), {s: _multiply(f, other) for s, f in self.parts.items()})
        if not other.parts:
            return self * other.value
        return other * self.value if not self.parts else _product(self, other)

    __rmul__ = __mul__

    def __truediv__(self, other):
        if not isinstance(other, Series):
            return self * (1 / other)
        return _quotient(self, other) if other.parts else self * (1 / other.value)

    def __rtruediv__(self, other):
        return constant(other) / self


def constant(value) -> Series:
    """A value that does not change within the step."""
    return Series(value, {})


def known(coefficients) -> Series:
    """A series whose coefficients are given, from c_0 on."""
    return Series(coefficients[0], {Sequence(known=coefficients[1:]): 1.0})


def _combined(value, a: Series, b: Series, factor: Callable) -> Series:
    """The series whose factors are `factor(a's, b's)`, 0.0 where one has no such part."""
    sequences = dict.fromkeys((*a.parts, *b.parts))
    return Series(value, {s: factor(a.parts.get(s, 0.0), b.parts.get(s, 0.0)) for s in sequences})


def _found(value, term: Callable) -> Series:
    """A series by its value and a rule for c_k, which is given the coefficients from c_0 on that are known."""
    value = _keep(value)
    coefficients = _FromZero(value)
    coefficients.rest = Sequence(lambda k: term(k, coefficients))
    return Series(value, {coefficients.rest: 1.0})


class _FromZero:
    """Coefficients of a series from c_0 on."""

    def __init__(self, value, rest: Sequence | None = None):
        self.value, self.rest = value, rest

    def __getitem__(self, order: int):
        return self.rest[order] if order else self.value


def _coefficients(a: Series) -> _FromZero:
    return _FromZero(a.value, a.sequence())


def _product(a: Series, b: Series) -> Series:
    """c_k = sum_j a_j b_{k-j}; of a square half of them, twice."""
    one, two = _coefficients(a), _coefficients(b)
    if a is b:
        return _found(_multiply(a.value, a.value), lambda k, _: _total(_square_terms(one, k)))
    return _found(_multiply(a.value, b.value), lambda k, _: _total(_multiply(one[j], two[k - j]) for j in range(k + 1)))


def _square_terms(a, k: int):
    for j in range((k + 1) // 2):
        yield _multiply(_multiply(2.0, a[j]), a[k - j])
    if k % 2 == 0:
        yield _multiply(a[k // 2], a[k // 2])


def _quotient(a: Series, b: Series) -> Series:
    """q = a/b from a_k = sum_j q_j b_{k-j}."""
    below = _coefficients(b)

    def term(k, q):
        return (a[k] - _total(_multiply(q[j], below[k - j]) for j in range(k))) / b.value

    return _found(a.value / b.value, term)


@elementary.exp.register
def _exp(a: Series) -> Series:
    """e = exp(a) from e' = a' e, so k e_k = sum_j j a_j e_{k-j}."""
    inside = _coefficients(a)

    def term(k, e):
        return _total(_multiply(_multiply(j / k, inside[j]), e[k - j]) for j in range(1, k + 1))

    return _found(jnp.exp(a.value), term)


@elementary.sin.register
def _sin(a: Series) -> Series:
    """s = sin(a) with c = cos(a), from s' = a' c and c' = -a' s."""
    inside = _coefficients(a)
    s, c = (_FromZero(_keep(of(a.value))) for of in (jnp.sin, jnp.cos))

    def by(other, sign):
        def term(k):
            return _total(_multiply(_multiply(sign * j / k, inside[j]), other[k - j]) for j in range(1, k + 1))

        return Sequence(term)

    s.rest, c.rest = by(c, 1.0), by(s, -1.0)
    return Series(s.value, {s.rest: 1.0})


@elementary.arctan.register
def _arctan(a: Series) -> Series:
    """y = arctan(a) from y' (1 + a²) = a'."""
    below = _coefficients(a * a + 1.0)

    def term(k, y):
        return (a[k] - _total(_multiply(_multiply(j / k, y[j]), below[k - j]) for j in range(1, k))) / below[0]

    return _found(jnp.arctan(a.value), term)


@elementary.maximum.register
def _maximum(a: Series, b) -> Series:
    """The series of whichever of the two is greater where the step starts."""
    other = b if isinstance(b, Series) else constant(b)
    first = a.value >= other.value
    return _combined(jnp.where(first, a.value, other.value), a, other, lambda f, g: jnp.where(first, f, g))


@elementary.absolute.register
def _absolute(a: Series) -> Series:
    """The series with the sign that makes it positive where the step starts."""
    return a * jnp.where(a.value < 0, -1.0, 1.0)


def expand(field: Callable, state: tuple, h, order: int) -> tuple[Series, ...]:
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
        found = [_multiply(1 / (k + 1), change[k]) for change in changes]
        for own, c in zip(sequences, found, strict=True):
            own.append(c)
    return series

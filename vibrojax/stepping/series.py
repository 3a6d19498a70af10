"""Truncated Taylor series in the time of one step: the arithmetic of the located stepper.

A `Series` is a node of an expression whose coefficients are worked out one order at a time, so that a state's next
coefficient may depend on all lower ones: this is how an ordinary differential equation is expanded (Jorba and Zou,
Experimental Mathematics 14 (2005); Biscani and Izzo, heyoka, MNRAS 504 (2021)). Physics written with +, -, *, /
and [vibrojax.physics.elementary][] runs on it unchanged.
"""

from collections.abc import Callable

import jax.numpy as jnp

from vibrojax.physics import elementary
from vibrojax.stepping._keep import keep


def _is_zero(x) -> bool:
    return isinstance(x, float) and x == 0.0


def _keep(c):
    return c if _is_zero(c) else keep(c)


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


class Series:
    """A series sum_k c_k tau^k, known as a rule `term(k)` that gives c_k once all lower ones are known.

    Coefficients are arrays of one shape (lanes), or the float 0.0 where the structure makes them vanish.
    """

    __array_priority__ = 1000  # so that array * series comes here
    __array_ufunc__ = None

    def __init__(self, term: Callable | None = None, known: tuple = ()):
        self._term = term
        self._coefficients = list(known)

    def __getitem__(self, order: int):
        while len(self._coefficients) <= order:
            self._coefficients.append(self._term(len(self._coefficients)))
        return self._coefficients[order]

    def array(self, order: int, like):
        """The coefficient of tau^order as an array shaped like `like`, where the structure makes it a number too."""
        c = self[order]
        return jnp.full_like(like, c) if isinstance(c, float) else c

    def __add__(self, other):
        if isinstance(other, Series):
            return Series(lambda k: _add(self[k], other[k]))
        return Series(lambda k: self[0] + other if k == 0 else self[k])

    __radd__ = __add__

    def __neg__(self):
        return self * -1.0

    def __sub__(self, other):
        if isinstance(other, Series):
            return Series(lambda k: self[k] if _is_zero(other[k]) else _add(self[k], -other[k]))
        return self + (-other)

    def __rsub__(self, other):
        return -self + other

    def __mul__(self, other):
        if not isinstance(other, Series):
            return Series(lambda k: _multiply(self[k], other))
        if other is self:
            return Series(lambda k: _keep(_total(_square_terms(self, k))))
        return Series(lambda k: _keep(_total(_multiply(self[j], other[k - j]) for j in range(k + 1))))

    __rmul__ = __mul__

    def __truediv__(self, other):
        return self * (1 / other) if not isinstance(other, Series) else _quotient(self, other)

    def __rtruediv__(self, other):
        return _quotient(constant(other), self)


def _square_terms(a: Series, k: int):
    for j in range((k + 1) // 2):
        yield _multiply(_multiply(2.0, a[j]), a[k - j])
    if k % 2 == 0:
        yield _multiply(a[k // 2], a[k // 2])


def constant(value) -> Series:
    """A value that does not change within the step."""
    return Series(lambda k: value if k == 0 else 0.0)


def _quotient(a: Series, b: Series) -> Series:
    """q = a/b from a_k = sum_j q_j b_{k-j}."""

    def term(k):
        known = _total(_multiply(q[j], b[k - j]) for j in range(k))
        return _keep((a[k] - known) / b[0])

    q = Series(term)
    return q


@elementary.exp.register
def _exp(a: Series) -> Series:
    """e = exp(a) from e' = a' e, so k e_k = sum_j j a_j e_{k-j}."""

    def term(k):
        if k == 0:
            return _keep(jnp.exp(a[0]))
        return _keep(_total(_multiply(_multiply(j / k, a[j]), e[k - j]) for j in range(1, k + 1)))

    e = Series(term)
    return e


@elementary.sin.register
def _sin(a: Series) -> Series:
    """s = sin(a) with c = cos(a), from s' = a' c and c' = -a' s."""

    def term(of_zero, other, sign):
        def found(k):
            if k == 0:
                return _keep(of_zero(a[0]))
            return _keep(_total(_multiply(_multiply(sign * j / k, a[j]), other()[k - j]) for j in range(1, k + 1)))

        return found

    s = Series(term(jnp.sin, lambda: c, 1.0))
    c = Series(term(jnp.cos, lambda: s, -1.0))
    return s


@elementary.arctan.register
def _arctan(a: Series) -> Series:
    """y = arctan(a) from y' (1 + a²) = a'."""
    denominator = a * a + 1.0

    def term(k):
        if k == 0:
            return _keep(jnp.arctan(a[0]))
        known = _total(_multiply(_multiply(j / k, y[j]), denominator[k - j]) for j in range(1, k))
        return _keep((a[k] - known) / denominator[0])

    y = Series(term)
    return y


@elementary.maximum.register
def _maximum(a: Series, b) -> Series:
    """The series of whichever of the two is greater where the step starts."""
    other = b if isinstance(b, Series) else constant(b)
    return Series(lambda k: jnp.where(a[0] >= other[0], a[k], other[k]))


@elementary.absolute.register
def _absolute(a: Series) -> Series:
    """The series with the sign that makes it positive where the step starts."""
    return Series(lambda k: _multiply(jnp.where(a[0] < 0, -1.0, 1.0), a[k]))


def expand(field: Callable, state: tuple, h, order: int) -> tuple[Series, ...]:
    """Taylor coefficients of the solution of y' = field(y) from `state`, in tau = time/h, up to tau^order.

    **Arguments:**

    - `field`: takes and returns a tuple of series, one per state; an entry may be a state's own series (x' = v).
    - `state`: tuple of arrays (lanes).
    - `h`: array (lanes) [s].

    **Returns:** one series per state, known up to `order`.
    """
    series = tuple(Series(known=(value,)) for value in state)
    rates = field(series)
    for k in range(order):
        step = h / (k + 1)
        found = [_keep(_multiply(step, rate[k])) for rate in rates]
        for one, value in zip(series, found, strict=True):
            one._coefficients.append(value)
    return series

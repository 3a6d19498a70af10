"""Number types that equations accept beside arrays and Taylor series: dual numbers, rounding errors and magnitudes.

They work for every equation that is written with +, -, *, /, integer powers and
[vibrojax.physics.elementary][], so derivatives and resolutions need no second copy of the equation.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from vibrojax.lazy import jnp
from vibrojax.physics import elementary

Equation = Callable[[Any, Mapping[str, Any]], Any]
"""A function of the time and of the states by name."""

_DERIVATIVES: dict[str, Callable[[Any, Any], Any]] = {
    "exp": lambda x, y: y,
    "log": lambda x, y: 1.0 / x,
    "sqrt": lambda x, y: 0.5 / y,
    "sin": lambda x, y: elementary.cos(x),
    "cos": lambda x, y: -elementary.sin(x),
    "tanh": lambda x, y: 1.0 - y * y,
    "arctan": lambda x, y: 1.0 / (1.0 + x * x),
}
"""Derivative of each elementary function y(x), as a function of x and y."""


class _Number:
    """Operators that follow from +, * and / of a number type."""

    __array_priority__ = 1001  # so that array * number and series * number call the number's operator
    __array_ufunc__ = None

    def __radd__(self, other: Any) -> Any:
        return self + other

    def __rmul__(self, other: Any) -> Any:
        return self * other

    def __neg__(self) -> Any:
        return self * -1.0

    def __sub__(self, other: Any) -> Any:
        return self + (-other)

    def __rsub__(self, other: Any) -> Any:
        return -self + other

    def __pow__(self, exponent: Any) -> Any:
        return elementary.integer_power(self, exponent)

    def __abs__(self) -> Any:
        return elementary.absolute(self)

    def __add__(self, other: Any) -> Any:
        raise NotImplementedError

    def __mul__(self, other: Any) -> Any:
        raise NotImplementedError


class Dual(_Number):
    """A number `value` with the derivative `slope` along one direction; both may be duals of a lower `level`.

    The level separates nested derivatives: a number of a lower level is a constant.
    """

    def __init__(self, value: Any, slope: Any, level: int):
        self.value, self.slope, self.level = value, slope, level

    def _split(self, other: Any) -> tuple[Any, Any]:
        same = isinstance(other, Dual) and other.level == self.level
        return (other.value, other.slope) if same else (other, None)

    def __add__(self, other: Any) -> Any:
        if isinstance(other, Dual) and other.level > self.level:
            return other + self
        value, slope = self._split(other)
        return Dual(self.value + value, self.slope if slope is None else self.slope + slope, self.level)

    def __mul__(self, other: Any) -> Any:
        if isinstance(other, Dual) and other.level > self.level:
            return other * self
        value, slope = self._split(other)
        changed = self.slope * value
        return Dual(self.value * value, changed if slope is None else changed + self.value * slope, self.level)

    def __truediv__(self, other: Any) -> Any:
        if isinstance(other, Dual) and other.level > self.level:
            return Dual(self, 0.0, other.level) / other
        value, slope = self._split(other)
        quotient = self.value / value
        changed = self.slope if slope is None else self.slope - quotient * slope
        return Dual(quotient, changed / value, self.level)

    def __rtruediv__(self, other: Any) -> Any:
        return Dual(other, 0.0, self.level) / self


class Rounded(_Number):
    """An array `value` and a bound `size` on its rounding error in units of the machine epsilon."""

    def __init__(self, value: Any, size: Any):
        self.value, self.size = value, size

    def _split(self, other: Any) -> tuple[Any, Any]:
        return (other.value, other.size) if isinstance(other, Rounded) else (other, abs(other))

    # A size is at least the magnitude of the value. It thus includes the rounding error of a product with a parameter.

    def __add__(self, other: Any) -> Any:
        if isinstance(other, Dual):
            return other + self
        value, size = self._split(other)
        return type(self)(self.value + value, self.size + size)

    def __mul__(self, other: Any) -> Any:
        if isinstance(other, Dual):
            return other * self
        if not isinstance(other, Rounded):
            return type(self)(self.value * other, self.size * abs(other))
        size = self.size * abs(other.value) + other.size * abs(self.value)
        return type(self)(self.value * other.value, size)

    def __truediv__(self, other: Any) -> Any:
        if isinstance(other, Dual):
            return Dual(self, 0.0, other.level) / other
        if not isinstance(other, Rounded):
            return self * (1.0 / other)
        quotient = self.value / other.value
        return type(self)(quotient, (self.size + other.size * abs(quotient)) / abs(other.value))

    def __rtruediv__(self, other: Any) -> Any:
        return type(self)(other, abs(other)) / self


class Magnitude(Rounded):
    """An array `value` and a typical magnitude `size` that it may have nearby.

    Unlike a rounding error, a magnitude does not grow with the slope of a function that is bounded, or of the
    exponential of a law that falls steeply.
    """


_HEIGHTS: dict[str, Callable[[Any], Any]] = {
    "exp": lambda y: 2.0 * jnp.abs(y),
    "sin": lambda y: 1.0,
    "cos": lambda y: 1.0,
    "tanh": lambda y: 1.0,
    "arctan": lambda y: 0.5 * jnp.pi,
}
"""Greatest change of a function that counts for a magnitude, from its value."""


def array_of(x: Any) -> Any:
    """Return the array, or Python number, of a number at the start of a step."""
    while hasattr(x, "value") and not hasattr(x, "shape"):
        x = x.value
    return x


def _register() -> None:
    for name, derivative in _DERIVATIVES.items():
        function = getattr(elementary, name)

        def dual(x: Dual, function: Any = function, derivative: Any = derivative) -> Dual:
            y = function(x.value)
            return Dual(y, derivative(x.value, y) * x.slope, x.level)

        def rounded(x: Rounded, function: Any = function, derivative: Any = derivative) -> Rounded:
            y = function(x.value)
            return Rounded(y, jnp.abs(y) + jnp.abs(derivative(x.value, y)) * x.size)

        def typical(x: Magnitude, function: Any = function, derivative: Any = derivative, name: str = name) -> Any:
            y = function(x.value)
            change = jnp.abs(derivative(x.value, y)) * x.size
            return Magnitude(y, jnp.abs(y) + (jnp.minimum(change, _HEIGHTS[name](y)) if name in _HEIGHTS else change))

        function.register(Dual, dual)
        function.register(Rounded, rounded)
        function.register(Magnitude, typical)


_register()


class Plain(np.ndarray):
    """A numpy array whose elementary functions are those of numpy.

    XLA compiles a program for each operation on a jax array, which takes seconds for functions that run only once.
    """

    @classmethod
    def of(cls, x: Any) -> Any:
        """Return numbers as an array of floats that cannot be changed."""
        array = np.array(x, float).view(cls)
        array.flags.writeable = False
        return array


for _name in (*_DERIVATIVES, "absolute", "floor"):
    getattr(elementary, {"absolute": "magnitude", "floor": "whole"}.get(_name, _name)).register(
        Plain, getattr(np, _name)
    )
elementary.greater.register(Plain, np.maximum)


@elementary.magnitude.register
def _absolute(x: Dual) -> Any:
    return x * jnp.where(array_of(x) < 0, -1.0, 1.0)


@elementary.magnitude.register
def _absolute_rounded(x: Rounded) -> Any:
    return type(x)(jnp.abs(x.value), x.size)


@elementary.greater.register
def _maximum(x: Dual, y: Any) -> Any:
    first = jnp.where(array_of(x) >= array_of(y), 1.0, 0.0)
    return x * first + (1.0 - first) * y


@elementary.greater.register
def _maximum_rounded(x: Rounded, y: Any) -> Any:
    value, size = x._split(y)
    return type(x)(jnp.maximum(x.value, value), jnp.maximum(x.size, size))


@elementary.whole.register
def _whole(x: Dual) -> Any:
    return jnp.floor(array_of(x))


@elementary.whole.register
def _whole_rounded(x: Rounded) -> Any:
    return jnp.floor(x.value)


@elementary.power.register
def _power(x: Dual, exponent: Any) -> Any:
    y = elementary.power(x.value, exponent)
    return Dual(y, y * exponent / x.value * x.slope, x.level)


@elementary.power.register
def _power_rounded(x: Rounded, exponent: Any) -> Any:
    y = elementary.power(x.value, exponent)
    return type(x)(y, jnp.abs(y) * (1.0 + jnp.abs(exponent) * x.size / jnp.abs(x.value)))


class Degree(_Number):
    """The degree of a function in the states: 0, 1, or 2 for any nonlinear one, however flat it is at most states."""

    def __init__(self, value: int):
        self.value = value

    @classmethod
    def of(cls, x: Any) -> int:
        """Return the degree of a number of any type."""
        return x.value if isinstance(x, cls) else 0

    def __add__(self, other: Any) -> Any:
        return Degree(max(self.value, Degree.of(other)))

    def __mul__(self, other: Any) -> Any:
        return Degree(min(self.value + Degree.of(other), 2))

    def __truediv__(self, other: Any) -> Any:
        return Degree(min(self.value + 2 * Degree.of(other), 2))

    def __rtruediv__(self, other: Any) -> Any:
        return Degree(min(2 * self.value, 2))


for _name in (*_DERIVATIVES, "power"):
    getattr(elementary, _name).register(Degree, lambda x, *exponent: Degree(min(2 * x.value, 2)))
elementary.magnitude.register(Degree, lambda x: x)
elementary.greater.register(Degree, lambda x, y: x + y)
elementary.whole.register(Degree, lambda x: Degree(0))


EQUAL = 1e-12
"""Relative difference up to which two probed values are equal. States and parameters may have any units, so that no
absolute difference is small."""


def equal(a: Any, b: Any, tolerance: float = EQUAL) -> bool:
    """Return whether two values have at most the relative difference `tolerance` in all lanes."""
    a, b = np.asarray(a), np.asarray(b)
    with np.errstate(all="ignore"):
        return bool((np.abs(a - b) <= tolerance * np.maximum(np.abs(a), np.abs(b))).all())


def slope_along(equation: Equation, t: Any, y: Mapping[str, Any], rates: Sequence[Any], t_rate: float = 1.0) -> Any:
    """Return the derivative of `equation(t, y)` if the states change at `rates` and the time at `t_rate`."""
    return slopes_along(lambda t, y: [equation(t, y)], t, y, rates, t_rate)[0]


def slopes_along(
    equations: Equation, t: Any, y: Mapping[str, Any], rates: Sequence[Any], t_rate: float = 1.0
) -> list[Any]:
    """Return the derivatives of several equations, as `slope_along` does."""
    level = 1 + max((x.level for x in (*y.values(), *rates) if isinstance(x, Dual)), default=0)
    time = Dual(t, t_rate, level)
    moved = {name: Dual(x, rate, level) for (name, x), rate in zip(y.items(), rates, strict=True)}
    zero = 0.0 * next(iter(y.values()))
    results = equations(time, moved)
    return [x.slope if isinstance(x, Dual) and x.level == level else zero for x in results]

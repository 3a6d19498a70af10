"""Polynomials of degree N over a step, by their Chebyshev coefficients, and where they fall through zero."""

import numpy as np
from numpy.polynomial import chebyshev

N = 24
X = -np.cos(np.pi * np.arange(N + 1) / N)
"""Chebyshev-Lobatto nodes in [-1, 1], rising."""
NODES = (1 + X) / 2
"""The same as shares of the step."""
NODES[0], NODES[-1] = 0.0, 1.0
COEFFICIENTS = np.linalg.inv(chebyshev.chebvander(X, N))
"""Coefficients = COEFFICIENTS @ values at the nodes."""
INTEGRAL = np.stack(
    [chebyshev.chebval(X, chebyshev.chebint(c, lbnd=-1)) / 2 for c in COEFFICIENTS.T], axis=1
)  # integrals from 0 to each node of the polynomial that is 1 at one node, 0 at the others; the step is 1 long
DERIVATIVE = np.stack([np.append(chebyshev.chebder(e), 0.0) for e in np.eye(N + 1)], axis=1)
"""Coefficients of the derivative by x = those of the polynomial times this."""

LEFT, RIGHT = (COEFFICIENTS @ chebyshev.chebvander((X + side) / 2, N) for side in (-1, 1))
"""Coefficients over a half of [-1, 1] = LEFT or RIGHT @ those over all of it."""
NOISE = 1e-14
"""Rounding of a polynomial's values, with a margin, relative to the size of what it is made of."""
GAUSS, WEIGHTS = np.polynomial.legendre.leggauss(N)


def value(c: np.ndarray, x: float) -> float:
    """Clenshaw's sum."""
    one, two = 0.0, 0.0
    for coefficient in c[:0:-1].tolist():
        one, two = coefficient + 2 * x * one - two, one
    return c[0] + x * one - two


def falls(c: np.ndarray, end: float, size: float) -> list[float]:
    """Every x in [-1, end] at which the polynomial falls through zero, in order; being below it at -1 counts too.

    None is missed: a part of the interval is passed over only where its coefficients show that the polynomial has no
    zero in it, and is searched only where they show that it is monotone; else it is halved. A dip below zero no deeper
    than rounding of the given size is none.
    """
    lifted = c.copy()
    lifted[0] += NOISE * size
    if lifted[0] >= np.abs(c[1:]).sum():
        return []
    low, high = value(lifted, -1.0), value(lifted, 1.0)
    found = [-1.0] if low < 0 else []
    _search(lifted, -1.0, 1.0, low, high, found)
    slope = DERIVATIVE @ c
    return [x for x in (_polished(c, slope, x) for x in found) if x <= end]


def first_fall(c: np.ndarray, end: float, size: float) -> float | None:
    return min(falls(c, end, size), default=None)


def _search(c, a, b, low, high, found):
    """Adds the falls in [a, b], over which c are the coefficients; low and high are the values at its ends."""
    if abs(c[0]) > np.abs(c[1:]).sum():
        return
    slope = DERIVATIVE @ c
    if abs(slope[0]) > np.abs(slope[1:]).sum() or b - a < 1e-13:
        if low > 0 >= high:
            found.append(a + (b - a) * (1 + _root(c, slope)) / 2)
        return
    middle = (a + b) / 2
    left = LEFT @ c
    height = left.sum()
    _search(left, a, middle, low, height, found)
    _search(RIGHT @ c, middle, b, height, high, found)


def _root(c, slope):
    """The zero in [-1, 1] of what falls there, by Newton's steps kept within what is still in question."""
    a, b, x = -1.0, 1.0, 0.0
    for _ in range(100):
        height, steep = value(c, x), value(slope, x)
        if height > 0:
            a = x
        else:
            b = x
        new = x - height / steep if steep < 0 else (a + b) / 2
        if not a < new < b:
            new = (a + b) / 2
        if abs(new - x) <= 1e-16:
            break
        x = new
    return new


def _polished(c, slope, x):
    """The zero of c beside x, a zero of c lifted by its rounding; x itself where c is too flat to have one to tell."""
    new = x
    for _ in range(4):
        steep = value(slope, new)
        if steep >= 0:
            return x
        new = new - value(c, new) / steep
        if abs(new - x) > 1e-6 or new < -1:
            return x
    return new

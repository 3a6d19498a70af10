"""Polynomials of degree N over a step, given by Chebyshev coefficients, and their falls through zero."""

import numpy as np
from numpy.polynomial import chebyshev

N = 24
X = -np.cos(np.pi * np.arange(N + 1) / N)
"""Chebyshev-Lobatto nodes in [-1, 1], in increasing order."""
NODES = (1 + X) / 2
"""The nodes as fractions of the step."""
NODES[0], NODES[-1] = 0.0, 1.0
COEFFICIENTS = np.linalg.inv(chebyshev.chebvander(X, N))
"""Coefficients = COEFFICIENTS @ values at the nodes."""
INTEGRAL = np.stack(
    [chebyshev.chebval(X, chebyshev.chebint(c, lbnd=-1)) / 2 for c in COEFFICIENTS.T], axis=1
)  # integrals over a step of length 1, from 0 to each node, of the polynomial that is 1 at one node and 0 at the others
DERIVATIVE = np.stack([np.append(chebyshev.chebder(e), 0.0) for e in np.eye(N + 1)], axis=1)
"""Coefficients of the derivative by x = DERIVATIVE @ coefficients of the polynomial."""

LEFT, RIGHT = (COEFFICIENTS @ chebyshev.chebvander((X + side) / 2, N) for side in (-1, 1))
"""Coefficients over a half of [-1, 1] = LEFT or RIGHT @ coefficients over all of it."""
NOISE = 1e-14
"""Rounding error of a polynomial's values, with a margin, relative to the size of its terms."""
GAUSS, WEIGHTS = np.polynomial.legendre.leggauss(N)


def value(c: np.ndarray, x: float) -> float:
    """Return the value of the polynomial by Clenshaw's algorithm."""
    b1, b2 = 0.0, 0.0
    for coefficient in c[:0:-1].tolist():
        b1, b2 = coefficient + 2 * x * b1 - b2, b1
    return c[0] + x * b1 - b2


def falls(c: np.ndarray, end: float, size: float) -> list[float]:
    """Return all x in [-1, end] at which the polynomial falls through zero, in order; a negative value at -1 counts. No
    fall is missed. A part of the interval is skipped only if its coefficients prove that it has no zero, and searched
    only if they prove that the polynomial is monotone there. Otherwise it is halved. Dips below zero within the
    rounding error of the given size do not count."""
    lifted = c.copy()
    lifted[0] += NOISE * size
    if lifted[0] >= np.abs(c[1:]).sum():
        return []
    low, high = value(lifted, -1.0), value(lifted, 1.0)
    roots = [-1.0] if low < 0 else []
    _search(lifted, -1.0, 1.0, low, high, roots)
    slope = DERIVATIVE @ c
    return [x for x in (_polished(c, slope, x) for x in roots) if x <= end]


def first_fall(c: np.ndarray, end: float, size: float) -> float | None:
    return min(falls(c, end, size), default=None)


def _search(c, a, b, low, high, roots):
    """Append the falls in [a, b] to `roots`. `c` are the coefficients over [a, b], `low` and `high` the values at its
    ends."""
    if abs(c[0]) > np.abs(c[1:]).sum():
        return
    slope = DERIVATIVE @ c
    if abs(slope[0]) > np.abs(slope[1:]).sum() or b - a < 1e-13:
        if low > 0 >= high:
            roots.append(a + (b - a) * (1 + _root(c, slope)) / 2)
        return
    middle = (a + b) / 2
    left = LEFT @ c
    height = left.sum()
    _search(left, a, middle, low, height, roots)
    _search(RIGHT @ c, middle, b, height, high, roots)


def _root(c, slope):
    """Return the zero in [-1, 1] of a decreasing polynomial, by Newton's method within a shrinking bracket."""
    a, b, x = -1.0, 1.0, 0.0
    for _ in range(100):
        height, derivative = value(c, x), value(slope, x)
        if height > 0:
            a = x
        else:
            b = x
        new = x - height / derivative if derivative < 0 else (a + b) / 2
        if not a < new < b:
            new = (a + b) / 2
        if abs(new - x) <= 1e-16:
            break
        x = new
    return new


def _polished(c, slope, x):
    """Return the zero of c near x, a zero of c lifted by its rounding error; x itself if c is too flat there."""
    new = x
    for _ in range(4):
        derivative = value(slope, new)
        if derivative >= 0:
            return x
        new = new - value(c, new) / derivative
        if abs(new - x) > 1e-6 or new < -1:
            return x
    return new

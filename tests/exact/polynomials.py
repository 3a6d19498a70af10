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

PARTS = 16
MIDDLES = -1 + (2 * np.arange(PARTS) + 1) / PARTS
AT_MIDDLES = chebyshev.chebvander(MIDDLES, N)
NOISE = 1e-14
"""Rounding of a polynomial's values, with a margin, relative to the sum of its coefficients' sizes."""
GAUSS, WEIGHTS = np.polynomial.legendre.leggauss(N)


def value(c: np.ndarray, x: float) -> float:
    """Clenshaw's sum."""
    one, two = 0.0, 0.0
    for coefficient in c[:0:-1].tolist():
        one, two = coefficient + 2 * x * one - two, one
    return c[0] + x * one - two


def falls(c: np.ndarray, end: float = 1.0) -> list[float]:
    """Every x in [-1, end] at which the polynomial falls through zero, in order; below zero at -1 counts as a fall there.

    None is missed: a part of the interval is passed over only where a bound on the second derivative shows that the
    polynomial has no zero in it, and is searched only once the same bound shows that it is monotone. A dip below
    zero no deeper than rounding is none.
    """
    size = np.abs(c).sum()
    if c[0] > size - c[0] or size == 0:
        return []
    lifted = c.copy()
    lifted[0] += NOISE * size
    slope = DERIVATIVE @ c
    bend = np.abs(DERIVATIVE @ slope).sum()
    found = [-1.0] if value(lifted, -1.0) < 0 else []
    heights, slopes = AT_MIDDLES @ lifted, AT_MIDDLES @ slope
    r = 1 / PARTS
    unsure = np.abs(heights) <= np.abs(slopes) * r + bend * r * r / 2
    for i in np.flatnonzero(unsure):
        _search(lifted, slope, bend, MIDDLES[i] - r, MIDDLES[i] + r, found)
    if not found:
        return found
    return [x for x in (_polished(c, slope, x) for x in found) if x <= end]


def first_fall(c: np.ndarray, end: float) -> float | None:
    return min(falls(c, end), default=None)


def _search(c, slope, bend, a, b, found):
    """Adds the falls of c in [a, b]."""
    middle, r = (a + b) / 2, (b - a) / 2
    height, steep = value(c, middle), value(slope, middle)
    if abs(height) > abs(steep) * r + bend * r * r / 2:
        return
    if abs(steep) > bend * r or r < 1e-13:
        if steep < 0 and value(c, a) > 0 >= value(c, b):
            found.append(_root(c, slope, a, b))
        return
    _search(c, slope, bend, a, middle, found)
    _search(c, slope, bend, middle, b, found)


def _root(c, slope, a, b):
    """The zero of c in [a, b], where it falls, by Newton's steps kept within what is still in question."""
    x = (a + b) / 2
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
    return new if abs(new - x) < 1e-6 and new >= -1 else x

"""Segments of a log: intervals of depth with laws of their own, as many as the data suggest.

In each segment, the rate is a straight line over ln(eta), the form *onset*. The boundaries minimise

    sum over segments of n ln(RSS/n)/tau + penalty,

exactly over all sets of boundaries on a grid of rows. tau is the correlation time of the noise: n correlated rows tell
as much as n/tau independent ones.
"""

import numpy as np
from jaxtyping import Float, Int

LEAST_SEGMENT = 30
"""Least number of rows of a segment."""

_MOST_BOUNDARIES = 600  # size of the grid: boundaries of longer logs are located to a few rows
_COEFFICIENTS = 5.0  # of a segment: two of the line, its noise, its boundary, and one against chance
_LARGEST_CORRELATION = 0.95
_LEAST_SQUARES = 1e-24  # of a perfect fit, relative to the greatest rate


def segments(relief: Float[np.ndarray, " rows"], rate: Float[np.ndarray, " rows"]) -> Int[np.ndarray, " rows"]:
    """Return the number of the segment, from 0, of each row. The rows are in order of depth and have values."""
    if rate.size < 2 * LEAST_SEGMENT or not rate.max() > 0:
        return np.zeros(rate.size, int)
    x, y = np.log(relief), rate / rate.max()
    x = x - x.mean()
    tau = _correlation_time(y - np.polyval(np.polyfit(x, y, 1), x) if np.ptp(x) > 0 else y)
    step = max(1, -(-rate.size // _MOST_BOUNDARIES))
    grid = np.append(np.arange(0, rate.size - step + 1, step), rate.size)
    sums = np.cumsum(np.vstack([np.zeros(6), np.stack([np.ones(x.size), x, y, x * x, x * y, y * y], axis=1)]), axis=0)
    sums = sums[grid]
    penalty = _COEFFICIENTS * np.log(max(rate.size / tau, 2.0))
    cost, previous = np.full(grid.size, np.inf), np.zeros(grid.size, int)
    cost[0] = -penalty
    for end in range(1, grid.size):
        starts = np.flatnonzero(grid[:end] <= grid[end] - LEAST_SEGMENT)
        if not starts.size:
            continue
        n, sx, sy, sxx, sxy, syy = (sums[end] - sums[starts]).T
        vx, vy, vxy = sxx - sx**2 / n, syy - sy**2 / n, sxy - sx * sy / n
        squares = np.maximum(vy - np.divide(vxy**2, vx, out=np.zeros_like(vx), where=vx > _LEAST_SQUARES), 0.0)
        total = cost[starts] + n * np.log(squares / n + _LEAST_SQUARES) / tau + penalty
        best = int(np.argmin(total))
        cost[end], previous[end] = total[best], starts[best]
    numbers, end = np.zeros(rate.size, int), grid.size - 1
    while end > 0:
        start = previous[end]
        numbers[: grid[start]] -= 1
        end = start
    return numbers - numbers[0]


def _correlation_time(residual: Float[np.ndarray, " rows"]) -> float:
    """Return the correlation time of noise [rows], whatever steps lie beneath it.

    For neighbours with the correlation rho, differences over two rows are sqrt(1 + rho) times as large as over one.
    Medians make a few steps of the law harmless.
    """
    one, two = (float(np.median(np.abs(residual[k:] - residual[:-k]))) for k in (1, 2))
    rho = float(np.clip((two / one) ** 2 - 1 if one > 0 else 0.0, 0.0, _LARGEST_CORRELATION))
    return (1 + rho) / (1 - rho)

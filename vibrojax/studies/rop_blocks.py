"""Statistics of laws fitted to the rows of a log, whose noise is correlated from row to row, by blocks of rows.

The rows are in order of depth. Neighbours are correlated, so that rows are neither drawn nor left out one by one, but
in blocks that are longer than the correlation. A refit is one Gauss-Newton step from the fit to all rows, which is
exact for linear forms. It needs only the sums of J^T J and of J^T r over each block.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from enum import IntEnum

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.special import stdtrit

from vibrojax.studies.rop_least_squares import (
    ExponentialRates,
    Jacobian,
    LaneFlags,
    Lanes,
    LinearRates,
    Square,
    Theta,
    residuals,
)

LEAST_ROWS = 50
"""Least number of rows for blocks: five blocks of ten rows."""

_MOST_BLOCKS, _LEAST_BLOCKS = 20, 5  # of the cross-validation; the standard error of a difference needs at least 5
_ROWS_PER_BLOCK = 10
_CORRELATION_TIMES = 3.0  # length of a block of the cross-validation, in correlation times
_LEAST_DRAWN_BLOCKS = 8  # blocks of the bootstrap that make up the log
_LARGEST_CORRELATION = 0.97
_RIDGE = 1e-13

LEAST_SEGMENT = 30
"""Least number of rows of a segment."""

_MOST_BOUNDARIES = 600  # size of the grid: boundaries of longer logs are located to a few rows
_SEGMENT_COEFFICIENTS = 5.0  # two of the line, its noise, its boundary, and one against chance
_LARGEST_CORRELATION_OF_SEGMENTS = 0.95
_LEAST_MEAN_SQUARE = 1e-24  # of a perfect fit, relative to the greatest rate
# Two standard errors, and the probability up to them: 96.5 % between both ends instead of 95.4 %, since the length of
# the blocks follows from the noise itself, and an interval that is too short is the worse fault.
_TWO_ERRORS = 2.0, 0.9825

DECIDED, SIMPLER = 0.975, 0.9
"""Probabilities, by Student's distribution over the blocks, that a form predicts better than another one.

From the first on, the other form is rejected. Up to the second, the form with fewer coefficients is chosen."""


class Standing(IntEnum):
    """Result of the cross-validation for a form."""

    NOT_COMPARED = 0
    REJECTED = 1
    UNDECIDED = 2
    CONTAINS_CHOSEN = 3
    CHOSEN = 4


STANDINGS = tuple(standing.name.lower().replace("_", "-") for standing in Standing)

CONTAINED: Mapping[str, tuple[str, ...]] = {
    "literal": ("onset",),
    "percent": ("onset",),
    "constant": ("onset", "line", "power"),
}
"""Forms that contain another one as a special case: they are no rivals of it, since they cannot be worse."""


def correlation(residual: Lanes) -> float:
    """Return the correlation of neighbouring residuals, at least 0."""
    squares = float(residual @ residual)
    return float(np.clip(residual[1:] @ residual[:-1] / squares if squares > 0 else 0.0, 0.0, _LARGEST_CORRELATION))


def block_covariance(jacobian: Jacobian, residual: Lanes) -> Square:
    """Return the covariance of the coefficients by a circular block bootstrap of the rows.

    To first order, a resample moves the coefficients by (J^T J)^-1 times the sum of J^T r over its blocks. The
    covariance over all resamples is therefore that of the sums over all blocks of a length, and none is drawn.

    The length of the blocks is twice the optimum for noise with the `correlation` of the residuals (Carlstein 1986),
    since its bias matters more than its variance here. Three factors make two standard errors hold the truth at least
    as often as for independent normal noise: the correlation that the ends of the blocks cut, the number of
    coefficients, and Student's quantile for the number of blocks.
    """
    count, size = jacobian.shape
    rho = correlation(residual)
    decay = 2 * rho / (1 - rho**2)
    most = max(count // _LEAST_DRAWN_BLOCKS, 1)
    length = int(np.clip(np.ceil(2 * (1.5 * count * decay**2) ** (1 / 3)), 1, most))
    number = count / length
    slopes = jacobian * residual[:, None]
    summed = np.cumsum(np.vstack([np.zeros((1, size)), slopes, slopes[:length]]), axis=0)
    blocks = summed[length : length + count] - summed[:count]
    inverse = np.linalg.pinv(jacobian.T @ jacobian, hermitian=True)
    cut = 1 - min(decay / length, 0.5)
    student = float(stdtrit(number - size, _TWO_ERRORS[1])) / _TWO_ERRORS[0]
    return inverse @ (blocks.T @ blocks) @ inverse / length * number / (number - size) / cut * student**2


def blocks_of(residual: Lanes) -> Int[np.ndarray, " lanes"] | None:
    """Return the block of each row for the cross-validation; None if there are too few rows for the correlation."""
    rho = correlation(residual)
    length = max(_ROWS_PER_BLOCK, _CORRELATION_TIMES * (1 + rho) / (1 - rho))
    number = min(int(residual.size / length), _MOST_BLOCKS)
    return None if number < _LEAST_BLOCKS else np.arange(residual.size) * number // residual.size


def prediction_errors(
    model: LinearRates | ExponentialRates,
    theta: Theta,
    rate: Lanes,
    censored: LaneFlags,
    block: Int[np.ndarray, " lanes"],
) -> Float[np.ndarray, " blocks"]:
    """Return the mean squared error of each block of rows, predicted from the fit to the rows of all other blocks."""
    predicted = model.rates(theta)
    residual, active = residuals(predicted, rate, censored), ~censored | (predicted > 0)
    jacobian = np.where(active[:, None], model.jacobian(theta), 0.0)
    number = int(block[-1]) + 1
    first = np.searchsorted(block, np.arange(number))
    normal = np.add.reduceat(jacobian[:, :, None] * jacobian[:, None, :], first)
    slope = np.add.reduceat(jacobian * residual[:, None], first)
    tiny = _RIDGE * np.trace(normal.sum(axis=0)) * np.eye(theta.size)  # for blocks that alone determine a coefficient
    steps = np.linalg.solve(normal.sum(axis=0) - normal + tiny, (slope.sum(axis=0) - slope)[:, :, None])
    without = theta - steps[:, :, 0]
    # Coefficients of each row's block, as columns: their sum is the exponent or the rate.
    predicted = replace(model, columns=model.columns * without[block]).rates(np.ones(theta.size))
    squares = np.add.reduceat(residuals(predicted, rate, censored) ** 2, first)
    return squares / np.bincount(block)


def compare(
    errors: Float[np.ndarray, "forms blocks"], names: Sequence[str], sizes: Sequence[int]
) -> Int[np.ndarray, " forms"]:
    """Return the `Standing` of each form by its prediction errors in the same blocks; `sizes`: numbers of coefficients.

    A form is rejected if the form with the least error predicts better, with the probability `DECIDED` by the relative
    differences (a - b)/(a + b) in the blocks, which no single block dominates. Of the forms within the probability
    `SIMPLER`, the one with the fewest coefficients and then the least error is chosen. The remaining ones are
    undecided, unless they contain the chosen form.
    """
    mean = errors.mean(axis=1)
    if not np.isfinite(mean).any():
        return np.full(len(names), Standing.NOT_COMPARED)
    best = int(np.nanargmin(mean))
    total = errors + errors[best]
    excess = np.divide(errors - errors[best], total, out=np.zeros_like(errors), where=total > 0)
    noise = excess.std(axis=1, ddof=1) / np.sqrt(errors.shape[1])
    limits = stdtrit(errors.shape[1] - 1, np.array([DECIDED, SIMPLER]))[:, None] * noise
    kept: Bool[np.ndarray, " forms"] = np.isfinite(mean) & (excess.mean(axis=1) <= limits[0])
    near = kept & (excess.mean(axis=1) <= limits[1])
    kept[best] = near[best] = True
    chosen = min(np.flatnonzero(near).tolist(), key=lambda form: (sizes[form], mean[form]))
    standing = np.where(kept, Standing.UNDECIDED, np.where(np.isfinite(mean), Standing.REJECTED, 0))
    for form in np.flatnonzero(kept).tolist():
        if names[form] in CONTAINED.get(names[chosen], ()):
            standing[form] = Standing.CONTAINS_CHOSEN
    standing[chosen] = Standing.CHOSEN
    return standing


# Segments


def segments(relief: Lanes, rate: Lanes) -> Int[np.ndarray, " lanes"]:
    """Return the number of the segment, from 0, of each row: an interval of depth with a law of its own.

    The rows are in order of depth and have values. In each segment, the rate is a straight line over ln(eta), the form
    *onset*. The boundaries minimise

        sum over segments of n ln(RSS/n)/tau + penalty,

    exactly over all sets of boundaries on a grid of rows. tau is the correlation time of the noise: n correlated rows
    tell as much as n/tau independent ones.
    """
    if rate.size < 2 * LEAST_SEGMENT or not rate.max() > 0:
        return np.zeros(rate.size, int)
    x, y = np.log(relief), rate / rate.max()
    x = x - x.mean()
    tau = _correlation_time(y - np.polyval(np.polyfit(x, y, 1), x) if np.ptp(x) > 0 else y)
    step = max(1, -(-rate.size // _MOST_BOUNDARIES))
    grid = np.append(np.arange(0, rate.size - step + 1, step), rate.size)
    sums = np.cumsum(np.vstack([np.zeros(6), np.stack([np.ones(x.size), x, y, x * x, x * y, y * y], axis=1)]), axis=0)
    sums = sums[grid]
    penalty = _SEGMENT_COEFFICIENTS * np.log(max(rate.size / tau, 2.0))
    cost, previous = np.full(grid.size, np.inf), np.zeros(grid.size, int)
    cost[0] = -penalty
    for end in range(1, grid.size):
        starts = np.flatnonzero(grid[:end] <= grid[end] - LEAST_SEGMENT)
        if not starts.size:
            continue
        n, sx, sy, sxx, sxy, syy = (sums[end] - sums[starts]).T
        vx, vy, vxy = sxx - sx**2 / n, syy - sy**2 / n, sxy - sx * sy / n
        squares = np.maximum(vy - np.divide(vxy**2, vx, out=np.zeros_like(vx), where=vx > _LEAST_MEAN_SQUARE), 0.0)
        total = cost[starts] + n * np.log(squares / n + _LEAST_MEAN_SQUARE) / tau + penalty
        best = int(np.argmin(total))
        cost[end], previous[end] = total[best], starts[best]
    numbers, end = np.zeros(rate.size, int), grid.size - 1
    while end > 0:
        start = previous[end]
        numbers[: grid[start]] -= 1
        end = start
    return numbers - numbers[0]


def _correlation_time(residual: Lanes) -> float:
    """Return the correlation time of noise [rows].

    For neighbours with the correlation rho, differences over two rows are sqrt(1 + rho) times as large as over one.
    Medians make a few steps of the law harmless.
    """
    over_one, over_two = (float(np.median(np.abs(residual[k:] - residual[:-k]))) for k in (1, 2))
    rho = float(np.clip((over_two / over_one) ** 2 - 1 if over_one > 0 else 0.0, 0.0, _LARGEST_CORRELATION_OF_SEGMENTS))
    return (1 + rho) / (1 - rho)

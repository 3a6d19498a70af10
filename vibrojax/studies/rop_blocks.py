"""Statistics of measured rows: wrong rows, the founder weight, errors and comparisons in blocks of correlated rows.

The rows are in order of depth. Neighbours are correlated, so that rows are neither drawn nor left out one by one, but
in blocks that are longer than the correlation. A refit without a block is one Gauss-Newton step from the fit to all
rows, which is exact for linear forms.
"""

from collections.abc import Sequence
from dataclasses import replace
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.ndimage import median_filter
from scipy.special import stdtrit

from vibrojax.studies.rop_forms import (
    CONTAINED,
    FORMS,
    Jacobian,
    LaneFlags,
    Lanes,
    Minimum,
    Model,
    Square,
    evaluate,
    minimise,
    model_of,
    search,
    spread_of,
)

LEAST_ROWS = 50
"""Least number of rows for blocks: five blocks of ten rows."""

LEAST_CLEANED = 30
"""Least number of rows from which wrong rows and a founder weight are sought."""

CLEAR_AIC_DIFFERENCE = 2.0
"""Difference in AIC above which another form describes the data better (Burnham and Anderson's rule of thumb)."""

AIC_LIMITS, BLOCK_LIMITS = (CLEAR_AIC_DIFFERENCE, CLEAR_AIC_DIFFERENCE), (4.0, 9.0)
"""Evidence against a form up to which it is preferred if it has fewer coefficients, and beyond which it is rejected.

Of two forms with as many coefficients, the right one has evidence above 9 against it with a probability below 0.2 %:
twice the logarithm of a likelihood ratio with the mean d has the variance 4 d."""

_MOST_BLOCKS, _LEAST_BLOCKS = 20, 5  # of the cross-validation; the standard error of a difference needs at least 5
_ROWS_PER_BLOCK = 10
_CORRELATION_TIMES = 3.0  # length of a block of the cross-validation, in correlation times
_LEAST_DRAWN_BLOCKS = 8  # blocks of the bootstrap that make up the log
_LARGEST_CORRELATION = 0.97
_RIDGE, _TINY = 1e-13, 1e-30
# Two standard errors, and the probability up to them: 98.5 % between both ends instead of 95.4 %, since the length of
# the blocks and the founder weight follow from the data, and an interval that is too short is the worse fault.
_TWO_ERRORS = 2.0, 0.9925

_FAR = 3.0  # interquartile ranges beyond the quartiles from which a weight is far from the others
_LEAST_RANGE = 0.05  # of the quartiles, relative to them, for weights that hardly vary
_LONGEST_SPIKE = 2  # rows in succession; longer excursions are drilling
_MOST_SPIKES = 0.03  # share of rows above which weights far from the others are not errors
_OUTLIER = 5.0  # standard deviations from the law, and from the rows of nearly the same weight
_WINDOW = 15  # number of rows of nearly the same weight
_LEAST_OUTLIER = 1e-3  # standard deviation, relative to the greatest rate, below which no row is an outlier
_MOST_OUTLIERS = 0.2  # share of rows above which the noise has heavy tails, and no row is an outlier

_BENDS = 40  # founder weights that are tried before the search
_LEAST_BESIDE = 8  # rows below the founder weight, and above it
_LEAST_SHARE = 0.04  # of rows on either side
_FOUNDER = 9.0  # of n ln(RSS/RSS'), n the number of independent rows: exceeded by chance in 1 % of logs
_MOST_MARGIN = 0.08  # of the founder weight, below it
_LEAST_FALL = 1e-6  # greatest rates per greatest weight: rounding errors are smaller
_ERRORS_OF_FALL = 2.0  # standard errors above which the rate falls above the founder weight


class Standing(IntEnum):
    """Result of the comparison for a form."""

    NOT_COMPARED = 0
    REJECTED = 1
    UNDECIDED = 2
    CONTAINS_CHOSEN = 3
    CHOSEN = 4


STANDINGS = tuple(standing.name.lower().replace("_", "-") for standing in Standing)


# Wrong rows


def wrong_rows(relief: Lanes, weight: Lanes, rate: Lanes, loss: str) -> dict[str, LaneFlags]:
    """Return masks of the rows that are wrong, by reason.

    A weight that is far from all others for one or two rows in succession decides a fit by its leverage. Longer
    excursions, or many of them, are drilling and stay.

    A rate is wrong if it is far from the likeliest law, and from the rates at nearly the same weight. The second
    condition makes a law that describes the data badly harmless: all rows of a weight then miss it alike.
    """
    far = np.zeros(weight.size, bool)
    for values, sign in ((weight, 1.0), (np.log(weight), -1.0)):
        low, high = np.quantile(sign * values, (0.25, 0.75))
        far |= sign * values > high + _FAR * max(high - low, _LEAST_RANGE * (abs(high) if sign > 0 else 1.0))
    starts = np.flatnonzero(np.diff(far, prepend=False) & far)
    ends = np.flatnonzero(np.diff(far, append=False) & far) + 1
    for start, end in zip(starts, ends, strict=True):
        far[start:end] = end - start <= _LONGEST_SPIKE
    far &= far.sum() <= 1 + _MOST_SPIKES * weight.size
    off = np.zeros(weight.size, bool)
    found = [search(form, relief[~far], rate[~far], loss) for form in FORMS if form.size == 2]
    residuals = [minimum.residual for minimum in found if isinstance(minimum, Minimum)]
    if residuals and loss != "squares":
        residual, order = min(residuals, key=spread_of), np.argsort(weight[~far], kind="stable")
        local = np.empty(residual.size)
        local[order] = median_filter(residual[order], _WINDOW, mode="nearest")
        both = [np.abs(r) > _OUTLIER * max(spread_of(r), _LEAST_OUTLIER) for r in (residual, residual - local)]
        off[~far] = np.all(both, axis=0) & (np.mean(np.all(both, axis=0)) <= _MOST_OUTLIERS)
    return {"weight far from all others": far, "rate far from the law": off}


# The founder weight


class Founder(NamedTuple):
    """Weight above which the rate does not rise, and the fall of the rate per weight above it; NaN without one.

    The units are those of the data.
    """

    weight: float = np.nan
    weight_stderr: float = np.nan
    fall: float = np.nan
    fall_stderr: float = np.nan
    correlation: float = 0.0  # of the noise of neighbouring rows

    @property
    def end(self) -> float:
        """The weight up to which rows are below the founder weight, whose error they would carry into the law."""
        return self.weight - min(2 * self.weight_stderr, _MOST_MARGIN * self.weight)

    @property
    def is_known(self) -> bool:
        return bool(np.isfinite(self.weight))

    @property
    def falls(self) -> bool:
        return bool(self.fall > _ERRORS_OF_FALL * self.fall_stderr)


def find_founder(relief: Lanes, weight: Lanes, rate: Lanes) -> Founder:
    """Return the founder weight of rows in order of depth.

    Up to the founder weight, the rate follows a form of the law; above it, it stays or falls linearly. Three forms with
    a founder weight are compared with all forms that have none: the concave ones among these bend as well.
    """
    seen, unit, top = rate > 0, float(rate.max(initial=0.0)), float(weight.max(initial=0.0))
    order = np.sort(weight[seen])
    beside = max(_LEAST_BESIDE, int(np.ceil(_LEAST_SHARE * order.size)))
    if weight.size < LEAST_CLEANED or order.size <= 2 * beside or order[beside] >= order[-beside - 1]:
        return Founder()
    x, y = weight / top, rate / unit
    low, high = order[beside] / top, order[-beside - 1] / top
    models = [model_of(form, relief, seen) for form in FORMS if form.size == 1 or np.std(np.log(relief[seen])) > 0]
    least = min(_squares(minimise(model, y, seen)) for model in models)
    bends = np.unique(np.quantile(x[seen & (x >= low) & (x <= high)], np.linspace(0, 1, _BENDS)))
    bounds = np.array([-np.inf, -np.inf, low, 0.0]), np.array([np.inf, np.inf, high, np.inf])
    found: list[tuple[Minimum, np.ndarray]] = []
    for model in (replace(model, weight=x) for model in models if model.form.size == 2):
        start, squares = _founder_start(model, bends, y, seen)
        found.append((minimise(model, y, seen, start=np.clip(start, *bounds), bounds=bounds), squares))
    best, squares = min(found, key=lambda pair: _squares(pair[0]))
    rho = correlation(best.residual)
    independent = independent_rows(weight.size, rho)
    if best.theta[1] <= 0 or independent * np.log(max(least, _TINY) / max(_squares(best), _TINY)) < _FOUNDER:
        return Founder(correlation=rho)
    errors = np.sqrt(np.diag(block_covariance(best.jacobian, best.residual, rho)))
    likely = bends[independent * np.log(squares / squares.min()) <= 1.0]
    width = max(float(errors[2]), float(np.abs(likely - best.theta[2]).max()))  # the kink makes the sum not quadratic
    fall, scale = best.theta[3] if best.theta[3] > _LEAST_FALL else 0.0, unit / top
    return Founder(best.theta[2] * top, width * top, fall * scale, errors[3] * scale, rho)


def _squares(minimum: Minimum) -> float:
    return float(minimum.residual @ minimum.residual)


def _founder_start(
    model: Model, bends: Float[np.ndarray, " bends"], rate: Lanes, seen: LaneFlags
) -> tuple[Float[np.ndarray, " four"], Float[np.ndarray, " bends"]]:
    """Return the coefficients of the best of several founder weights, and the sum of squares of each.

    These are linear fits to the rows with a rate.
    To first order, a residual of the logarithm times the rate is the residual of the rate.
    """
    by_log, weight = model.form.name == "power", np.asarray(model.weight)
    factor, target = (rate, rate * np.log(np.where(seen, rate, 1.0))) if by_log else (np.ones_like(rate), rate)
    fits = []
    for bend in bends.tolist():
        z = (model.form.variable(model.relief * np.minimum(1.0, bend / weight)) - model.centre) / model.spread
        columns = np.stack([factor, factor * z, -np.maximum(weight - bend, 0.0)], axis=1)[seen]
        theta, squares, *_ = np.linalg.lstsq(columns, target[seen])
        if theta[2] < 0:
            theta[:2], squares, *_ = np.linalg.lstsq(columns[:, :2], target[seen])
        fits.append((float(squares.sum()), np.array([*theta[:2], bend, max(theta[2], 0.0)])))
    return min(fits, key=lambda fit: fit[0])[1], np.maximum([squares for squares, _ in fits], _TINY)


# Correlated rows


def correlation(residual: Lanes) -> float:
    """Return the correlation of neighbouring residuals, at least 0, without its bias for short logs (Kendall 1954)."""
    squares = float(residual @ residual)
    rho = max(float(residual[1:] @ residual[:-1]) / squares, 0.0) if squares > 0 else 0.0
    return min(rho + (1 + 3 * rho) / residual.size, _LARGEST_CORRELATION) if rho > 0 else 0.0


def independent_rows(rows: int, rho: float) -> float:
    """Return the number of independent rows that tell as much as rows whose neighbours have the correlation rho."""
    return rows * (1 - rho) / (1 + rho)


def block_covariance(jacobian: Jacobian, residual: Lanes, rho: float) -> Square:
    """Return the covariance of the coefficients by a circular block bootstrap of the rows.

    To first order, a resample moves the coefficients by (J^T J)^-1 times the sum of J^T r over its blocks. The
    covariance over all resamples is therefore that of the sums over all blocks of a length, and none is drawn.

    The length of the blocks is twice the optimum for noise with the `correlation` rho (Carlstein 1986), since its bias
    matters more than its variance here. Three factors make two standard errors hold the truth at least as often as for
    independent normal noise: the correlation that the ends of the blocks cut, the number of coefficients, and Student's
    quantile for the number of blocks.
    """
    count, size = jacobian.shape
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


def blocks_of(rows: int, rho: float) -> Int[np.ndarray, " lanes"] | None:
    """Return the block of each row for the cross-validation; None if there are too few rows for the correlation."""
    length = max(_ROWS_PER_BLOCK, _CORRELATION_TIMES * (1 + rho) / (1 - rho))
    number = min(int(rows / length), _MOST_BLOCKS)
    return None if number < _LEAST_BLOCKS else np.arange(rows) * number // rows


def prediction_errors(minimum: Minimum, rate: Lanes, block: Int[np.ndarray, " lanes"]) -> Float[np.ndarray, " blocks"]:
    """Return the mean squared error of each block of rows, predicted from the fit to the rows of all other blocks."""
    jacobian, residual, number = minimum.jacobian, minimum.residual, int(block[-1]) + 1
    first = np.searchsorted(block, np.arange(number))
    normal = np.add.reduceat(jacobian[:, :, None] * jacobian[:, None, :], first)
    slope = np.add.reduceat(jacobian * residual[:, None], first)
    tiny = _RIDGE * np.trace(normal.sum(axis=0)) * np.eye(minimum.theta.size)  # blocks that alone determine something
    steps = np.linalg.solve(normal.sum(axis=0) - normal + tiny, (slope.sum(axis=0) - slope)[:, :, None])
    errors = np.empty(number)
    for index, step in enumerate(steps[:, :, 0]):
        without = evaluate(minimum.model, minimum.theta - step, rate, rate > 0)
        errors[index] = np.mean(without.residual[block == index] ** 2)
    return errors


# The comparison of the forms


def block_evidence(errors: Float[np.ndarray, "forms blocks"], independent: float) -> Float[np.ndarray, " forms"]:
    """Return the evidence against each form, n ln(e/least e): e its mean error in the blocks, n independent rows."""
    mean = errors.mean(axis=1)
    if not np.isfinite(mean).any():
        return mean
    least = float(np.nanmin(mean))
    return independent * np.log(np.maximum(mean, _TINY) / max(least, _TINY))


def standings(
    evidence: Float[np.ndarray, " forms"], names: Sequence[str], limits: tuple[float, float]
) -> Int[np.ndarray, " forms"]:
    """Return the `Standing` of each form by the evidence against it.

    Beyond the second of the `limits`, a form is rejected. Of the forms up to the first one, that with the fewest
    coefficients and then the least evidence against it is chosen. The other forms that are kept are undecided, unless
    they contain the chosen form.
    """
    if not np.isfinite(evidence).any():
        return np.full(len(names), Standing.NOT_COMPARED)
    # The constant of percent is a convention: it is not preferred to onset, of which it is a special case.
    size, above = {form.name: form.size for form in FORMS} | {"percent": 2}, evidence - np.nanmin(evidence)
    chosen = min(np.flatnonzero(above <= limits[0]).tolist(), key=lambda form: (size[names[form]], above[form]))
    kept = above <= limits[1]
    standing = np.where(kept, Standing.UNDECIDED, np.where(np.isfinite(evidence), Standing.REJECTED, 0))
    for form in np.flatnonzero(kept).tolist():
        if names[form] in CONTAINED.get(names[chosen], ()):
            standing[form] = Standing.CONTAINS_CHOSEN
    standing[chosen] = Standing.CHOSEN
    return standing


def supported(
    standing: Int[np.ndarray, "groups forms"],
    evidence: Float[np.ndarray, "groups forms"],
    names: Sequence[str],
    limits: tuple[float, float],
) -> str:
    """Return the form that the data of all groups support, or "none".

    It is the form that the sum of the evidence chooses, if it leaves no rival and no group rejects it.
    """
    compared = (standing > 0).any(axis=1)
    if not compared.any():
        return "none"
    joint = standings(evidence[compared].sum(axis=0), names, limits)
    chosen, rejected = int(np.argmax(joint)), (standing[compared] == Standing.REJECTED).any(axis=0)
    # A special case of the chosen form is a rival unless a group rejects it: it has fewer coefficients in each group.
    special = [names.index(name) for name, wider in CONTAINED.items() if name in names and names[chosen] in wider]
    has_rival = (joint == Standing.UNDECIDED).any() or not rejected[
        [k for k in special if standing[compared, k].any()]
    ].all()
    return "none" if has_rival or rejected[chosen] else names[chosen]

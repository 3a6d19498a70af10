"""Fit of one group of lanes: wrong rows, the founder weight, and every form.

The rows of a log are in order of depth. Neighbours are correlated, so that rows are neither drawn nor left out one by
one, but in blocks that are longer than the correlation.
"""

from typing import NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Float
from scipy.ndimage import label, median_filter
from scipy.special import stdtrit

from vibrojax.studies import rop_forms
from vibrojax.studies.rop_forms import FORMS, Form, LaneBlocks, LaneFlags, Lanes, Minimum, search, spread_of, whiten

LEAST_DEGREES_OF_FREEDOM = 2
"""Degrees of freedom below which forms are not compared: the correction of AIC for small samples, 2k(k + 1)/(n - k - 1)
for k = 2 coefficients, is finite from n = 4 lanes on."""

LEAST_CLEANED = 30
"""Least number of rows from which wrong rows and a founder weight are sought, and errors follow from blocks of rows."""

LEAST_ROWS = 50  # least number of rows from which the forms are compared by blocks of rows

_MOST_BLOCKS, _ROWS_PER_BLOCK = 20, 6
# Two standard errors, and the probability up to them: 98.5 % between both ends instead of 95.4 %, since the correlation
# and the founder weight follow from the data, and an interval that is too short is the worse fault.
_TWO_ERRORS = 2.0, 0.9925
_LARGEST_CORRELATION = 0.97
_TINY = 1e-24  # sum of squares of an exact fit, whose residuals are rounding errors
_EPSILON = float(np.finfo(float).eps)

_FAR = 3.0  # interquartile ranges beyond the quartiles from which a weight is far from the others
_LEAST_RANGE = 0.05  # of the quartiles, relative to them, for weights that hardly vary
_LONGEST_SPIKE = 2  # rows in succession; longer excursions are drilling
_MOST_SPIKES = 0.03  # share of rows above which weights far from the others are not errors
_OUTLIER = 5.0  # standard deviations from the law, and from the rows of nearly the same weight
_WINDOW = 15  # number of rows of nearly the same weight
_LEAST_OUTLIER = 1e-3  # standard deviation, relative to the greatest rate, below which no row is an outlier
_MOST_OUTLIERS = 0.2  # share of rows above which the noise has heavy tails, and no row is an outlier

_BENDS, _ZOOMS = 40, 3  # founder weights that are tried, first between the ends and then near the best one
_LIKELY = 5.0  # evidence against founder weights up to two standard errors away: 97.5 % of the chi-squared distribution
_FEWEST_BESIDE = 3  # rows beside a founder weight within the error of the best one
_LEAST_BESIDE = 8  # rows below the founder weight, and above it
_LEAST_SHARE = 0.04  # of rows on either side
_MOST_SOUGHT, _RUN = 20_000, 100  # rows that suffice for a founder weight, and the runs of rows in which they are taken
_FOUNDER = 9.0  # evidence against all laws without a founder: exceeded by chance in 1 % of logs
_MOST_MARGIN = 0.08  # of the founder weight, below it
_LARGEST_LOG_RATE = 5.0  # of a power law, in units of the greatest rate: a worse guess is useless
_LEAST_FALL = 1e-6  # greatest rates per greatest weight: rounding errors are smaller
_ERRORS_OF_FALL = 2.0  # standard errors above which the rate falls above the founder weight

_LEAST_SLOPE = 1e-10
"""Slope theta_1 of rate/greatest rate below which there is no onset, since the slope is a rounding error."""

_LEAST_SLOPE_IN_ERRORS = 2.0
"""Slope theta_1 in standard errors below which there is no onset: its Fieller confidence interval is unbounded."""

FAR_WEIGHT, FAR_RATE = "weight far from all others", "rate far from the law"  # reasons why rows are wrong

COEFFICIENTS = ("C", "eta0", "exponent")
NAMES = [form.name for form in FORMS]
_COLUMNS = [*COEFFICIENTS, *(f"{name}_stderr" for name in COEFFICIENTS), "r_squared", "aic", "cv_error"]
_COLUMNS += ["evidence_against", "degrees_of_freedom", "used", "standing", "reason", "r_squared_reason"]


class Founder(NamedTuple):
    """Weight above which the rate does not rise, and the fall of the rate per weight above it; NaN without one.

    The units are the units of the data; `correlation` is the correlation of the noise of neighbouring rows.
    """

    weight: float = np.nan
    weight_stderr: float = np.nan
    fall: float = np.nan
    fall_stderr: float = np.nan
    correlation: float = 0.0

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


class GroupFit(NamedTuple):
    """Fit of a group: a table with a row per form, the founder, and masks of the lanes that were left out."""

    forms: pd.DataFrame
    founder: Founder
    wrong: dict[str, LaneFlags]
    above: LaneFlags


def fit_lanes(
    relief: Lanes,
    weight: Lanes,
    rate: Lanes,
    robust: bool = True,
    measured: bool = True,
    unknown: bool = False,
    has_force: bool = True,
) -> GroupFit:
    """Fit every form to the lanes of a group.

    `measured`: whether they are rows of a log, in order of depth; `unknown`: whether the threshold is unknown;
    `has_force`: whether `weight` is the mean force, without which no founder weight is sought.
    """
    founder, wrong = Founder(), dict[str, LaneFlags]()
    if measured and rate.size >= LEAST_CLEANED and (rate > 0).any() and np.ptp(relief) > 0:
        founder, wrong = clean(relief, weight, rate, robust, has_force)
    keep = ~np.any([np.zeros(rate.size, bool), *wrong.values()], axis=0)
    for end in (founder.end, founder.weight):  # none is above it, if that is NaN
        above = keep & (weight > end)
        fitted = keep & ~above
        if fitted.sum() >= _LEAST_BESIDE:
            break
    row = np.flatnonzero(fitted) if measured else None
    return GroupFit(_fit_forms(relief[fitted], rate[fitted], robust, unknown, row), founder, wrong, above)


# Wrong rows, and the founder weight


def clean(
    relief: Lanes, weight: Lanes, rate: Lanes, robust: bool = True, has_force: bool = True
) -> tuple[Founder, dict[str, LaneFlags]]:
    """Return the founder weight of rows in order of depth, and masks of the wrong rows by reason.

    A weight that is far from all others for one or two rows in succession decides a fit by its leverage. Longer
    excursions, or many of them, are drilling and stay.

    Wrong rates are sought twice. A law without a founder does not describe rows above it, so that small outliers do not
    stand out from its residuals: the second search is about the law that ends at the founder weight.
    """
    far = np.zeros(weight.size, bool)
    for values, sign in ((weight, 1.0), (np.log(weight), -1.0)):
        low, high = np.quantile(sign * values, (0.25, 0.75))
        far |= sign * values > high + _FAR * max(high - low, _LEAST_RANGE * (abs(high) if sign > 0 else 1.0))
    spike, _ = label(far)
    far &= np.bincount(spike)[spike] <= _LONGEST_SPIKE
    far &= far.sum() <= 1 + _MOST_SPIKES * weight.size
    keep, founder = ~far, Founder()
    fits = [search(form, relief[keep], rate[keep], robust) for form in FORMS if form.size == 2]
    residuals = [minimum.residual for minimum in fits if isinstance(minimum, Minimum)]
    residual = min(residuals, key=spread_of, default=None)
    for turn in range(2):
        wrong = _wrong_rates(residual, weight[keep]) if robust and residual is not None else np.zeros(keep.sum(), bool)
        if turn and not wrong.any():
            break
        keep[keep] = ~wrong
        if not has_force:
            break
        founder, residual = find_founder(relief[keep], weight[keep], rate[keep], np.flatnonzero(keep))
    return founder, {FAR_WEIGHT: far, FAR_RATE: ~keep & ~far}


def _wrong_rates(residual: Lanes, weight: Lanes) -> LaneFlags:
    """Return the rows whose rate is far from the law, and from the rates at nearly the same weight.

    The second condition makes a law that describes the data badly harmless: it is then far from all rows of a weight.
    """
    order, local = np.argsort(weight, kind="stable"), np.empty(residual.size)
    local[order] = median_filter(residual[order], _WINDOW, mode="mirror")  # "nearest" repeats the row at an end
    wrong = np.ones(residual.size, bool)
    for r in (residual, residual - local):
        spread = max(spread_of(half) for half in np.array_split(r[order], 2))  # noise may grow with the weight
        wrong &= np.abs(r) > _OUTLIER * max(spread, _LEAST_OUTLIER)
    return wrong & (wrong.mean() <= _MOST_OUTLIERS)


class _Profile(NamedTuple):
    """Fits of a form for several founder weights: sums of squares, theta and the fall, its error, and residuals."""

    squares: Float[np.ndarray, " bends"]
    theta: Float[np.ndarray, "bends coefficients"]
    fall_stderr: Float[np.ndarray, " bends"]
    residual: Float[np.ndarray, "rows bends"]


def find_founder(relief: Lanes, weight: Lanes, rate: Lanes, row: LaneBlocks) -> tuple[Founder, Lanes | None]:
    """Return the founder weight of rows in order of depth, and the residuals of the law; `row`: their numbers.

    Up to the founder weight, the rate follows a form of the law; above it, it stays or falls linearly. The profile of
    the likelihood over the founder weight gives its estimate and its standard error. The forms with a founder weight
    are compared with those without: the concave ones among these bend as well.
    """
    seen, unit, top = rate > 0, float(rate.max(initial=0.0)), float(weight.max(initial=0.0))
    order = np.sort(weight[seen])
    beside = max(_LEAST_BESIDE, int(np.ceil(_LEAST_SHARE * order.size)))
    if weight.size < LEAST_CLEANED or order.size <= 2 * beside or order[beside] >= order[-beside - 1]:
        return Founder(), None
    x, y, scale = weight / top, rate / unit, unit / top

    def between(beside: int) -> Float[np.ndarray, " bends"]:
        return np.unique(np.quantile(order[beside : order.size - beside] / top, np.linspace(0, 1, _BENDS)))

    def profiles(bends: Float[np.ndarray, " bends"]) -> list[_Profile]:
        return [_profile(form, relief, x, y, bends, decay_of(rho, row)) for form in FORMS if form.size == 2]

    if rate.size > _MOST_SOUGHT:
        some = np.arange(rate.size) // _RUN % -(-rate.size // _MOST_SOUGHT) == 0
        founder, _ = find_founder(relief[some], weight[some], rate[some], row[some])
        rho, bend = founder.correlation, founder.weight / top if founder.is_known else np.inf
        return founder, min(profiles(np.array([bend])), key=lambda profile: profile.squares[0]).residual[:, 0]
    rho = 0.0
    for _ in range(2):  # the second time with the correlation of the first residuals
        straight, best = (
            min(profiles(bend), key=lambda profile: profile.squares.min())
            for bend in (np.array([np.inf]), between(beside))
        )
        rho = correlation(best.residual[:, np.argmin(best.squares)], row)
    k = int(np.argmin(best.squares))
    if best.theta[k, 1] <= 0 or rate.size * np.log(straight.squares[0] / best.squares[k]) < _FOUNDER:
        return Founder(correlation=rho), straight.residual[:, 0]
    near = between(_FEWEST_BESIDE)
    for _ in range(_ZOOMS):  # all forms, and weights with few rows beside, are within the error
        bends = near
        of_forms = profiles(bends)
        squares = np.min([profile.squares for profile in of_forms], axis=0)
        k, likely = int(np.argmin(squares)), rate.size * np.log(squares / squares.min()) <= _LIKELY
        first, last = np.flatnonzero(likely)[[0, -1]]
        near = np.linspace(bends[max(first - 1, 0)], bends[min(last + 1, bends.size - 1)], _BENDS)
    best = min(of_forms, key=lambda profile: profile.squares[k])
    error, fall = np.abs(bends[likely] - bends[k]).max() / 2, float(best.theta[k, 2])
    values = float(bends[k] * top), float(error * top), fall * (fall > _LEAST_FALL) * scale
    return Founder(*values, float(best.fall_stderr[k] * scale), rho), best.residual[:, k]


def _profile(
    form: Form, relief: Lanes, weight: Lanes, rate: Lanes, bends: Float[np.ndarray, " bends"], decay: Lanes
) -> _Profile:
    """Fit the law up to each founder weight of `bends`, and a linear fall above it, by linear least squares."""
    weight, rate, is_power = weight[:, None], rate[:, None], form.name == "power"
    excess = np.maximum(weight - bends, 0.0)
    columns, law = form.columns(relief[:, None] * np.minimum(1.0, bends / weight)), rate
    for turn in range(2 if is_power else 3):
        if turn and not is_power and (law[rate[:, 0] > 0] > 0).all():
            break
        slopes, target = rop_forms.linear_problem(form, columns, rate, law)
        slopes = np.concatenate([slopes, -(excess * (rate > 0))[..., None]], axis=-1)
        slopes, target = whiten(slopes, decay), whiten(target, decay)
        normal, right = np.einsum("rbi,rbj->bij", slopes, slopes), np.einsum("rbi,rb->bi", slopes, target + 0 * excess)
        inverse = np.linalg.pinv(normal, hermitian=True)
        theta = np.einsum("bij,bj->bi", inverse, right)
        level = np.einsum("bij,bj->bi", np.linalg.pinv(normal[:, :2, :2], hermitian=True), right[:, :2])
        theta = np.where(theta[:, 2:] >= 0, theta, np.pad(level, ((0, 0), (0, 1))))  # the rate never rises there
        law = np.einsum("rbi,bi->rb", columns, theta[:, :2])
        law = np.exp(np.minimum(law, _LARGEST_LOG_RATE)) if is_power else law
    residual = np.where(rate > 0, np.maximum(law, 0.0) - theta[:, 2] * excess - rate, 0.0)
    squares = np.maximum(np.sum(whiten(residual, decay) ** 2, axis=0), _TINY)
    errors = np.sqrt(np.maximum(inverse[:, 2, 2], 0.0) * squares / max(rate.size - 4, 1))
    return _Profile(squares, theta, errors, residual)


# Correlated rows


def correlation(residual: Lanes, row: LaneBlocks) -> float:
    """Return the correlation of residuals in neighbouring rows, at least 0, without its bias in short logs.

    The bias is that of a fit with two coefficients (Kendall 1954).
    """
    pairs = np.flatnonzero(np.diff(row) == 1)
    variance = float(np.mean(residual**2)) if pairs.size else 0.0
    rho = float(np.mean(residual[pairs] * residual[pairs + 1])) / variance if variance > _TINY else 0.0
    return min(rho + (2 + 4 * rho) / pairs.size, _LARGEST_CORRELATION) if rho > 0 else 0.0


def decay_of(rho: float, row: LaneBlocks) -> Lanes:
    """Return the correlation of each row with the preceding one, if neighbours have the correlation rho."""
    return np.concatenate([np.zeros(1), rho ** np.diff(row).astype(float)])[: row.size]


def predictions_without(minimum: Minimum, rate: Lanes, block: LaneBlocks) -> Lanes:
    """Return the residuals of each block of rows, predicted from the fit to the rows of all other blocks."""
    moved = minimum.theta + rop_forms.moves_without(minimum, block)
    residuals = [minimum.form.residuals(theta, minimum.relief, rate)[0] for theta in moved]
    return np.array(residuals)[block, np.arange(rate.size)]


# The forms


def _fit_forms(relief: Lanes, rate: Lanes, robust: bool, unknown: bool, row: LaneBlocks | None) -> pd.DataFrame:
    """Return the values of every form, and compare the forms; `row`: the number of each row of a log."""
    rho, block, decay = 0.0, None, None

    def minima_of() -> dict[str, Minimum | rop_forms.Reason]:
        return {form.name: search(form, relief, rate, robust, decay) for form in FORMS if form.name not in same}

    same = rop_forms.SAME_AS_ONSET * unknown
    found = minima_of()
    if row is not None and (residuals := [x.residual for x in found.values() if isinstance(x, Minimum)]):
        rho = correlation(min(residuals, key=np.linalg.norm), row)
        if rate.size >= LEAST_CLEANED and np.ptp(relief) > 0:
            # The rows are whitened, so that blocks need not exceed the length of correlation.
            block = np.arange(rate.size) * int(np.clip(rate.size // _ROWS_PER_BLOCK, 1, _MOST_BLOCKS)) // rate.size
            decay = decay_of(rho, row)
            found = minima_of()
    missing = dict.fromkeys(same, rop_forms.Reason.UNKNOWN_THRESHOLD)
    records = {}
    for name, x in {**missing, **found}.items():
        unfitted = {"reason": x, "r_squared_reason": x, "degrees_of_freedom": 0}
        records[name] = _values(x, rate, block, decay) if isinstance(x, Minimum) else unfitted
    table = pd.DataFrame.from_dict(records, orient="index").reindex(NAMES, columns=_COLUMNS)
    table["used"], table["standing"] = rate.size, int(rop_forms.Standing.NOT_COMPARED)
    limit = rop_forms.AIC_LIMIT if row is None else rop_forms.BLOCK_LIMIT
    if block is None or rate.size < LEAST_ROWS:
        freedom = table["degrees_of_freedom"].drop(list(same))
        if freedom.min() < LEAST_DEGREES_OF_FREEDOM:
            return table
        costs = np.array([2 * form.size for form in FORMS])
        exact = rate.size * 2 * np.log(rop_forms.EXACT * rate.max())  # below it, forms are equally exact
        independent = (1 - rho) / (1 + rho)  # correlated rows count as fewer independent ones
        table["evidence_against"] = independent * np.maximum(table["aic"] - costs, exact) + costs
    table["evidence_against"] -= table["evidence_against"].min()
    table["standing"] = rop_forms.standings(table["evidence_against"].to_numpy(), NAMES, limit)
    return table


def _values(minimum: Minimum, rate: Lanes, block: LaneBlocks | None, decay: Lanes | None) -> dict[str, float | int]:
    """Return the coefficients of a form with standard errors, R², AIC, and the errors of predicted blocks.

    Standard errors are HC3 or, with blocks, those of their jackknife: Student's quantile for the number of blocks makes
    two standard errors hold the truth as often as they should.

    R² is NaN if the rates do not vary. RSS/n has a lower bound, the squared rounding error of the greatest rate, so
    that the AIC of exact data is finite.
    """
    unit, size, theta = float(rate.max()), minimum.theta.size, minimum.theta
    y = rate / unit
    moves = rop_forms.moves_without(minimum, np.arange(rate.size) if block is None else block)
    square = moves.T @ moves
    if block is not None:
        student = float(stdtrit(len(moves) - size, _TWO_ERRORS[1])) / _TWO_ERRORS[0]
        square *= (len(moves) - 1) / len(moves) * student**2
    values, slopes = minimum.form.coefficients(theta)
    errors = np.sqrt(np.einsum("ci,ij,cj->c", slopes, square, slopes))
    fit: dict[str, float | int] = {"reason": rop_forms.Reason.IDENTIFIED}
    if minimum.form.name in rop_forms.BEGINNING:
        # A horizontal line has C close to zero, and no onset.
        least = max(_LEAST_SLOPE, _LEAST_SLOPE_IN_ERRORS * float(np.sqrt(square[1, 1])))
        if abs(theta[1]) <= least or not np.isfinite(values[1]):
            values[1], fit["reason"] = np.nan, rop_forms.Reason.NO_SLOPE
    errors[np.isnan(values)] = np.nan
    for name, scale, value, error in zip(COEFFICIENTS, (unit, 1.0, 1.0), values, errors, strict=True):
        fit |= {name: scale * value, f"{name}_stderr": scale * error}
    squares, about_mean = float(np.sum(minimum.residual**2)), float(np.sum((y - y.mean()) ** 2))
    varies = about_mean > rate.size * rop_forms.EXACT**2
    if block is not None and rate.size >= LEAST_ROWS:
        # Blocks of a table in order of the weight would be parts of the curve, and those at its ends extrapolated.
        rises = np.diff(minimum.relief)
        in_order = (rises >= 0).all() or (rises <= 0).all()
        residual = predictions_without(minimum, y, np.arange(y.size) % len(moves) if in_order else block)
        fit["cv_error"] = unit * np.sqrt(np.mean(residual**2))
        fit["evidence_against"] = rate.size * np.log(max(np.mean(whiten(residual, decay) ** 2), _EPSILON**2))
    return fit | {
        "r_squared": 1 - squares / about_mean if varies else np.nan,
        "r_squared_reason": rop_forms.Reason.IDENTIFIED if varies else rop_forms.Reason.CONSTANT_RATES,
        "aic": rate.size * (np.log(max(squares / rate.size, _EPSILON**2)) + 2 * np.log(unit)) + 2 * size,
        "degrees_of_freedom": int(minimum.active.sum()) - size,
    }

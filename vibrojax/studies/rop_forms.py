"""Forms of the rate-of-penetration law: formulas, robust fits by SciPy, leaving out blocks of lanes, and comparison.

The source's law, rate = C ln(P/D) (eq. 6.4), gives a negative rate if the relief eta = P/D is below 1. It is therefore
read in three ways ("forms"): as printed, with P/D in percent, and as C ln(eta/eta0) with a fitted onset eta0, the
relief at which penetration begins. A straight line, a power law and a constant serve as comparison.

A lane (here, one pair of relief and rate) at zero rate is censored; all others are *seen*. A censored lane has a
residual only if the form predicts a positive rate. Below its onset, a form predicts a rate of zero.

Lanes of a log have correlated noise. *Whitening* subtracts from each residual what the preceding one predicts of it, so
that the fit weights lanes by the independent information that they hold (Prais and Winsten 1954).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import least_squares

Lanes: TypeAlias = Float[np.ndarray, " lanes"]
LaneFlags: TypeAlias = Bool[np.ndarray, " lanes"]
LaneBlocks: TypeAlias = Int[np.ndarray, " lanes"]
Theta: TypeAlias = Float[np.ndarray, " coefficients"]
Jacobian: TypeAlias = Float[np.ndarray, "lanes coefficients"]
ManyLanes: TypeAlias = Float[np.ndarray, "lanes ..."]
Columns: TypeAlias = Float[np.ndarray, "lanes ... coefficients"]


class Reason(IntEnum):
    """Reasons why a fitted value is NaN; without a known threshold, some forms are the same curve as another one."""

    IDENTIFIED = 0
    TOO_FEW_LANES = 1
    NO_SPREAD = 2
    ALL_CENSORED = 3
    NOT_CONVERGED = 4
    NO_SLOPE = 5
    CONSTANT_RATES = 6
    UNKNOWN_THRESHOLD = 7


REASONS = tuple(reason.name.lower().replace("_", "-") for reason in Reason)
"""Names of the reasons as stored in datasets."""

LEAST_SPREAD = 1e-6  # standard deviation of ln(eta) below which values count as equal: no instrument resolves it
EXACT = 1e-9  # standard deviation of residuals, or of rates, over the greatest rate, below which it is a rounding error
AIC_LIMIT = 2.0  # difference in AIC above which a form is rejected (Burnham and Anderson's rule of thumb)

BLOCK_LIMIT = 5.4
"""Evidence by blocks of rows above which a form is rejected.

Of two forms with equal numbers of coefficients, the right one has evidence above 5.4 against it with a probability
below 1 %, however much they differ. The reason is that twice the logarithm of a likelihood ratio with the mean d has
the variance 4 d."""

SPECIAL_LIMIT = 8.8
"""Evidence by blocks of rows above which a special case is rejected, such as `literal` beside `onset`.

A right special case has evidence above 8.8 against it in 0.1 % of groups: chi-squared above 10.8, as its missing
coefficient counts 2. The correlation and the founder weight, which follow from the data, leave this below 1 %."""

_SPECIAL_LIMITS = {BLOCK_LIMIT: SPECIAL_LIMIT, AIC_LIMIT: AIC_LIMIT}
_NORMAL_OVER_MAD = 1.4826  # standard deviation over median absolute deviation, for normal noise
_BOUND = 2.0  # standard deviations beyond which the robust loss grows linearly: 95 % as efficient as least squares
_LARGEST_EXPONENT = 60.0  # argument of exp, so that a poor trial step of the search does not overflow
_LARGEST_THETA = 1e3  # rates are scaled to order one: a search that goes farther diverges
_MOST_EVALUATIONS = 400  # ten times the largest number observed in a fit
_TOLERANCE, _ROBUST_TOLERANCE = 1e-15, 1e-8  # of least squares, whose steps are quick, and of the robust loss
_SCALE_ROUNDS, _SAME_SCALE = 12, 0.1  # fits of the robust loss, and the change of its scale that needs no further one
_LEAST_SCALE = 1e-9  # of the residuals, relative to the greatest rate, for data that are fitted exactly
_LEAST_FREE_SHARE = 1e-6  # value of 1 - h (h: leverage) below which a lane is fitted exactly, whatever its noise
_TAKEN = 1 - 1e-10  # share of a block that is left out, so that the other lanes determine every coefficient


@dataclass(frozen=True)
class Form:
    """A formula of the law, with the exponent n. `of_log`: whether the rate is a function of ln(eta).

    `size`: number of coefficients.

    `rate` is the formula as a function of eta and the coefficients C, eta0 and exponent. A fit determines theta: the
    rate (of power: its logarithm) is theta_0 t, or theta_0 + theta_1 t, where t is ln(eta), ln(100 eta), eta or 1.
    """

    name: str
    formula: str
    size: int
    of_log: bool
    rate: Callable[[Lanes, float, float, float], Lanes]

    def columns(self, relief: ManyLanes) -> Columns:
        """Return the columns by which theta is multiplied."""
        one, t = np.ones_like(relief), np.log(100 * relief if self.name == "percent" else relief)
        t = one if self.name == "constant" else t if self.of_log else relief
        return t[..., None] if self.size == 1 else np.stack([one, t], axis=-1)

    def residuals(self, theta: Theta, relief: Lanes, rate: Lanes) -> tuple[Lanes, Jacobian, LaneFlags]:
        """Return residuals, their derivatives by theta, and the active lanes: those seen, or predicted to penetrate."""
        jacobian = self.columns(relief)
        predicted = jacobian @ theta
        if self.name == "power":
            predicted = np.exp(np.minimum(predicted, _LARGEST_EXPONENT))
            jacobian = predicted[:, None] * jacobian
        active = (predicted > 0) | ((rate > 0) & (self.name not in BEGINNING))
        return np.where(active, predicted, 0.0) - rate, jacobian * active[:, None], active

    def coefficients(self, theta: Theta) -> tuple[Float[np.ndarray, " 3"], Float[np.ndarray, "3 coefficients"]]:
        """Return C, eta0 and exponent (NaN: the form has none), and their derivatives with respect to theta."""
        if self.size == 1:
            return np.array([theta[0], np.nan, np.nan]), np.array([[1.0], [np.nan], [np.nan]])
        (level, slope), none = theta, [np.nan, np.nan]
        if self.name == "power":
            c = np.exp(level)
            return np.array([c, np.nan, slope]), np.array([[c, 0.0], none, [0.0, 1.0]])
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            onset = -level / slope
            eta0 = np.exp(onset) if self.of_log else onset
            by_level = -(eta0 if self.of_log else 1.0) / slope
            slopes = [[0.0, 1.0], [by_level, by_level * onset], none]
        return np.array([slope, eta0, np.nan]), np.array(slopes)


FORMS = (
    Form("literal", "C ln(η)", 1, True, lambda eta, C, eta0, exponent: C * np.log(eta)),
    Form("percent", "C ln(100 η)", 1, True, lambda eta, C, eta0, exponent: C * np.log(100.0 * eta)),
    Form("onset", "C ln(η/η₀)", 2, True, lambda eta, C, eta0, exponent: C * np.log(eta / eta0)),
    Form("line", "C (η − η₀)", 2, False, lambda eta, C, eta0, exponent: C * (eta - eta0)),
    Form("power", "C ηⁿ", 2, True, lambda eta, C, eta0, exponent: C * eta**exponent),
    Form("constant", "C", 1, False, lambda eta, C, eta0, exponent: C * np.ones_like(eta)),
)

FORMULAS = {form.name: form.formula for form in FORMS}

LOGARITHMIC = ("literal", "percent", "onset")  # the three readings of the source's law, eq. 6.4

BEGINNING = ("onset", "line")
"""Forms whose rate begins at a fitted onset: below it, they predict no penetration, whose noise may be positive."""

SAME_AS_ONSET = ("literal", "percent")  # forms that have the same curve as the onset form if the threshold is unknown

CONTAINED = {"literal": ("onset",), "percent": ("onset",), "constant": ("onset", "line", "power")}
"""Forms that contain another one as a special case: they are no rivals of it, since they cannot be worse."""


def linear_problem(form: Form, columns: Columns, rate: ManyLanes, near: ManyLanes) -> tuple[Columns, ManyLanes]:
    """Return columns and targets of the linear least squares for theta over the seen lanes; censored lanes are zero.

    Below the onset of the rates `near`, nothing is fitted. The power law is linearised about them.
    """
    if form.name != "power":
        return ((rate > 0) & (near > 0))[..., None] * columns, rate
    near = np.where(rate > 0, near, 0.0)
    return near[..., None] * columns, rate - near + near * np.log(np.where(near > 0, near, 1.0))


def whiten(values: np.ndarray, decay: Lanes | None) -> np.ndarray:
    """Return residuals, or columns of a Jacobian, less what the preceding row predicts; `decay`: their correlation."""
    if decay is None or not decay.any():
        return values
    decay = decay.reshape(-1, *[1] * (values.ndim - 1))
    return (values - decay * np.roll(values, 1, axis=0)) / np.sqrt(1 - decay**2)


@dataclass(frozen=True)
class Minimum:
    """A minimum of the loss: theta, and the residuals and active lanes there.

    The product of `jacobian` and `influence`, the residuals as they enter theta, is the gradient of the loss, and that
    of `jacobian` with itself its curvature.
    """

    form: Form
    relief: Lanes
    theta: Theta
    residual: Lanes
    active: LaneFlags
    jacobian: Jacobian
    influence: Lanes


def search(form: Form, relief: Lanes, rate: Lanes, robust: bool, decay: Lanes | None = None) -> Minimum | Reason:
    """Return the fit of a form to one group, with rates in units of the greatest one, or the reason why it has none.

    The fit minimises the sum of squares or, if `robust`, SciPy's loss "soft_l1", whose scale is the standard deviation
    of the residuals by their median. A linear form without censored lanes above its onset needs no search. `decay`: the
    correlation of each row with the preceding one.
    """
    seen = rate > 0
    if not seen.any():
        return Reason.ALL_CENSORED if seen.size else Reason.TOO_FEW_LANES
    if seen.sum() <= form.size:
        return Reason.TOO_FEW_LANES
    if not np.std(np.log(relief[seen])) > LEAST_SPREAD:
        return Reason.NO_SPREAD
    rate = rate / rate.max()
    columns, target = linear_problem(form, form.columns(relief), rate, rate)
    theta, converged, scale = np.linalg.lstsq(whiten(columns, decay), whiten(target, decay))[0], True, np.inf
    residual, jacobian, active = form.residuals(theta, relief, rate)
    is_solved = form.name != "power" and np.array_equal(active, seen)
    for turn in range(is_solved, 1 + _SCALE_ROUNDS * robust):  # turn 0: of squares
        before = scale
        scale = _BOUND * max(spread_of(whiten(residual, decay)[active]), _LEAST_SCALE) if turn else np.inf
        if not active.any() or (turn > 1 and abs(scale - before) <= _SAME_SCALE * scale):
            break
        solution = least_squares(
            lambda theta: whiten(form.residuals(theta, relief, rate)[0], decay),
            theta,
            lambda theta: whiten(form.residuals(theta, relief, rate)[1], decay),
            loss="soft_l1" if turn else "linear",
            f_scale=scale if turn else 1.0,
            max_nfev=_MOST_EVALUATIONS,
            **dict.fromkeys(("ftol", "xtol", "gtol"), _ROBUST_TOLERANCE if turn else _TOLERANCE),
        )
        theta, converged = solution.x, solution.status > 0 and bool(np.abs(solution.x).max() < _LARGEST_THETA)
        residual, jacobian, active = form.residuals(theta, relief, rate)
    if not (converged and active.any() and np.isfinite(theta).all()):
        return Reason.NOT_CONVERGED
    # The loss 2 s² (sqrt(1 + (r/s)²) - 1) has the slope 2 r (1 + (r/s)²)^(-1/2) and the curvature 2 (1 + ...)^(-3/2).
    white = whiten(residual, decay)
    bend = 1 + (white / scale) ** 2
    jacobian = bend[:, None] ** -0.75 * whiten(jacobian, decay)
    return Minimum(form, relief, theta, residual, active, jacobian, bend**0.25 * white)


def spread_of(residual: Lanes) -> float:
    """Return the standard deviation of residuals about 0, estimated from their median absolute value."""
    return _NORMAL_OVER_MAD * float(np.median(np.abs(residual))) if residual.size else 0.0


def moves_without(minimum: Minimum, block: LaneBlocks) -> Float[np.ndarray, "blocks coefficients"]:
    """Return how theta moves if a block of lanes is left out, by one Newton step, which is exact for linear forms.

    The sum of the squares of the moves is the variance of theta. For blocks of one lane, this is HC3 (MacKinnon and
    White 1985, J. Econometrics 29, 305), which allows for noise whose variance differs between lanes: the usual
    estimate would give far too wide intervals for noise in proportion to the rate. For longer blocks, it is their
    jackknife, to first order a bootstrap of blocks, which also allows for correlated noise.
    """
    order = np.argsort(block, kind="stable")
    jacobian, residual, block = minimum.jacobian[order], minimum.influence[order], block[order]
    squares = jacobian.T @ jacobian
    # A lane that alone determines a coefficient is fitted exactly: its noise is estimated from the other lanes.
    free = 1 - _TAKEN * np.einsum("li,ij,lj->l", jacobian, np.linalg.pinv(squares, hermitian=True), jacobian)
    noise = np.sqrt(np.sum(residual**2) / max(minimum.active.sum() - jacobian.shape[1], 1))
    residual = np.where(free < _LEAST_FREE_SHARE, noise * free, residual)
    first = np.searchsorted(block, np.arange(block[-1] + 1))
    of_block = np.add.reduceat(jacobian[:, :, None] * jacobian[:, None, :], first)
    slopes = np.add.reduceat(jacobian * residual[:, None], first)
    return (np.linalg.pinv(squares - _TAKEN * of_block, hermitian=True) @ slopes[:, :, None])[:, :, 0]


# The comparison of the forms


class Standing(IntEnum):
    """Result of the comparison for a form."""

    NOT_COMPARED = 0
    REJECTED = 1
    UNDECIDED = 2
    CONTAINS_CHOSEN = 3
    CHOSEN = 4


STANDINGS = tuple(standing.name.lower().replace("_", "-") for standing in Standing)


def standings(evidence: Float[np.ndarray, " forms"], names: Sequence[str], limit: float) -> Int[np.ndarray, " forms"]:
    """Return the `Standing` of each form by the evidence against it: beyond `limit`, it is rejected.

    Of the others, that with the fewest coefficients and then the least evidence against it is chosen. The rest are
    undecided, unless they contain the chosen form. So is a special case of it up to its own limit.
    """
    if not np.isfinite(evidence).any():
        return np.full(len(names), Standing.NOT_COMPARED)
    # The constant of percent is a convention: it is not preferred to onset, of which it is a special case.
    size, above = {form.name: form.size for form in FORMS} | {"percent": 2}, evidence - np.nanmin(evidence)
    kept = above <= limit
    chosen = min(np.flatnonzero(kept).tolist(), key=lambda form: (size[names[form]], above[form]))
    standing = np.where(kept, Standing.UNDECIDED, np.where(np.isfinite(evidence), Standing.REJECTED, 0))
    for form, name in enumerate(names):
        if kept[form] and name in CONTAINED.get(names[chosen], ()):
            standing[form] = Standing.CONTAINS_CHOSEN
        elif names[chosen] in CONTAINED.get(name, ()) and above[form] <= _SPECIAL_LIMITS[limit]:
            standing[form] = Standing.UNDECIDED
    standing[chosen] = Standing.CHOSEN
    return standing


def supported(
    standing: Int[np.ndarray, "groups forms"],
    evidence: Float[np.ndarray, "groups forms"],
    names: Sequence[str],
    limit: float,
) -> str:
    """Return the form that the data of all groups support, or "none".

    It is the form that the sum of the evidence chooses, if it leaves no rival and no group rejects it.
    """
    compared = (standing > 0).any(axis=1)
    if not compared.any():
        return "none"
    standing, evidence = standing[compared], evidence[compared]
    joint = standings(evidence.sum(axis=0), names, limit)
    chosen = int(np.argmax(joint))
    # A special case of the chosen form is a rival, since it has fewer coefficients in each group, unless a group
    # rejects it. One of several groups does so by chance more often than a single one: hence 2 ln(groups).
    special = [names.index(name) for name, wider in CONTAINED.items() if name in names and names[chosen] in wider]
    special = [form for form in special if standing[:, form].any()]
    above = (evidence - np.nanmin(evidence, axis=1, keepdims=True))[:, special]
    is_rejected = (above > _SPECIAL_LIMITS[limit] + 2 * np.log(len(evidence))).any(axis=0)
    has_rival = (joint == Standing.UNDECIDED).any() or not is_rejected.all()
    return "none" if has_rival or (standing[:, chosen] == Standing.REJECTED).any() else names[chosen]

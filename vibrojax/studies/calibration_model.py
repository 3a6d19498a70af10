"""The model of a calibration: predictions of orbits and of a recorded velocity, and their least squares."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import least_squares

from vibrojax.errors import InputError, counted
from vibrojax.io.variables import VARIABLES
from vibrojax.lanes.labels import measured_besides
from vibrojax.lazy import qmc
from vibrojax.maps.read import Point
from vibrojax.physics.units import UNITS, likely_units
from vibrojax.studies.as_jax import Branch, settled_at
from vibrojax.studies.calibration_history import VELOCITY, History

CONSTANT = "C"
"""Name of the coefficient of the law, which is no parameter of a scene: rate_of_penetration = C ln(relief)."""

RATE, RELIEF = "rate_of_penetration", "relief"

MAX_EVALUATIONS = 60  # limit of the evaluations of one search; a search from a point of the box takes 5 to 20
TOLERANCE = 1e-8  # relative tolerance of a search, far below every standard error

ORBIT_ERROR = 1e-10
"""Relative error of the features of orbits; residuals cannot show a smaller error of the observations."""

SCREENED = 32  # number of points of the box whose motions are simulated, to begin the searches at the best of them
SCREENED_ROWS = 4  # largest number of observations that are simulated at each of these points

OTHER_UNIT = 10.0
"""Ratio to all motions inside the bounds beyond which observations are in another unit, if one brings them back."""

MAX_ROUNDS = 8
"""Number of fits from one point. Each has the observations and the weights that follow from the fit before."""

SAME_WEIGHTS = 1e-3
"""Relative change of the weights, far below any error of an estimated noise, at which the rounds end."""

STEP_SHARES = (1.0, 0.3, 0.1, 0.03, 0.01)  # shares of a step of Gauss and Newton that are tried where a search ends

SMALLEST_SHARE = 1e-2
"""Share of its variable's mean size below which a value has no smaller error: values near 0 are not exact."""

Theta = Float[np.ndarray, " unknown"]
Thetas = Float[np.ndarray, "draws unknown"]
Rows = Bool[np.ndarray, " observations"]
Values = Float[np.ndarray, "observations of"]


@dataclass(frozen=True, eq=False)
class Problem:
    """Observations, and the unknowns that shall explain them.

    - `point`: scene, initial condition and fixed parameters of the rows.
    - `names`: the unknown parameters, and then the unknown states at the first sample of the history; `low` and `high`:
      their bounds; `prior_mean` and `prior_error` along them, with an infinite error where there is no prior.
    - `conditions`: for each row the parameters that differ between rows, by name.
    - `of`: the observed variables; `values`: their values in the rows and at the samples of the history, NaN where
      there is none; `errors`: their standard errors, or None if the residuals shall give them.
    - `labels`: number of each row's line in the file, or of the row; samples follow the last row.
    - `seed`: seed of the points at which searches begin.
    """

    point: Point
    history: History | None
    names: tuple[str, ...]
    low: Theta
    high: Theta
    prior_mean: Theta
    prior_error: Theta
    conditions: dict[str, np.ndarray]
    of: tuple[str, ...]
    values: Values
    errors: Values | None
    labels: np.ndarray
    seed: int

    @property
    def rows(self) -> int:
        return len(self.labels) - (0 if self.history is None else len(self.history.times))

    @property
    def parameters(self) -> int:
        return len(self.names) - (0 if self.history is None else len(self.history.states))

    @property
    def free(self) -> list[int]:
        """Indices of the unknown parameters of the scene."""
        return [k for k, name in enumerate(self.names[: self.parameters]) if name != CONSTANT]

    @property
    def by(self) -> list[str]:
        """Parameters of the scene that are unknown, or differ between rows."""
        return [*(self.names[k] for k in self.free), *self.conditions]

    @property
    def features(self) -> list[str]:
        """Features of orbits from which the observed variables follow."""
        lawful = CONSTANT in self.names
        names = [name for name in self.of if name != VELOCITY and (name != RATE or not lawful)]
        return names + [RELIEF] * (lawful and RELIEF not in names)

    def points(self, thetas: Thetas) -> Float[np.ndarray, "points by"]:
        """Return the parameters `by` of all rows at each row of `thetas`, one row of data after the other."""
        rows = np.stack([*self.conditions.values()], axis=1) if self.conditions else np.zeros((self.rows, 0))
        return np.hstack([np.repeat(thetas[:, self.free], self.rows, axis=0), np.tile(rows, (len(thetas), 1))])

    def shortage(self, used: Rows) -> str:
        """Return why the observations `used` do not determine the unknowns with an error; empty if they do."""
        count = int(np.isfinite(self.values[used]).sum()) + int(np.isfinite(self.prior_error).sum())
        if count >= len(self.names) + (self.errors is None):
            return ""
        needed = counted(len(self.names), "unknown" if self.history else "unknown parameter")
        needed += " and the size of the noise" * (self.errors is None)
        more = "give standard errors in [error], " if self.errors is None else "give a [prior], "
        return f"{counted(count, 'value')} for {needed}; add rows or observed variables, {more}or leave an unknown out"

    def free_of(self, theta: Theta) -> Theta:
        """Return the unknowns as the searches vary them: logarithms of positive ones, whose bounds may span decades."""
        with np.errstate(all="ignore"):
            return np.where(self.low > 0, np.log(theta), theta)

    def theta_of(self, free: np.ndarray) -> np.ndarray:
        """Return theta inside the bounds; the inverse of `free_of`."""
        with np.errstate(all="ignore"):
            return np.clip(np.where(self.low > 0, np.exp(free), free), self.low, self.high)

    def errors_at(self, values: Values) -> Values:
        """Return the standard errors of the observations, or else the sizes of `values`, to which noise is relative.

        For samples of a history, the size is the root mean square of all samples.
        """
        if self.errors is not None:
            return self.errors
        if self.history is not None:
            return np.full_like(values, np.sqrt(np.nanmean(self.values**2)) or 1.0)
        floor = SMALLEST_SHARE * np.nanmean(np.abs(self.values), axis=0)
        return np.fmax(np.abs(values), np.where(floor > 0, floor, 1.0))

    def weights(self, used: Rows, sizes: Values) -> Values:
        """Return the inverse standard errors of the observations `used`, 0 for the others.

        Without standard errors, they are relative to an unknown noise, and follow from `sizes`.
        """
        known = np.isfinite(self.values) & used[:, None]
        return np.where(known, 1 / np.where(known, self.errors_at(sizes), 1.0), 0.0)

    def residuals(self, weight: Values, prediction: "Prediction", theta: Theta) -> Float[np.ndarray, " residuals"]:
        """Return the residuals in standard errors, first of the observations and then of the prior."""
        known = np.where(weight > 0, prediction.values - self.values, 0.0)
        return np.concatenate([(weight * known).ravel(), (theta - self.prior_mean) / self.prior_error])

    def jacobian(self, weight: Values, prediction: "Prediction") -> Float[np.ndarray, "residuals unknown"]:
        slopes = np.where(weight[..., None] > 0, prediction.slopes, 0.0) * weight[..., None]
        return np.concatenate([slopes.reshape(-1, len(self.names)), np.diag(1 / self.prior_error)])


class Prediction(NamedTuple):
    """Predictions at one theta, their derivatives, and a mask of the observations with a stable orbit.

    An observation without an orbit has the values of the nearest orbit.
    """

    values: Values
    slopes: Float[np.ndarray, "observations of unknown"]
    valid: Rows


class Fit(NamedTuple):
    """The end of one search: theta, its prediction, and the weights of the observations, 0 without an orbit there.

    - `cost`: sum of squares; `freedom`: number of values and priors minus number of unknowns.
    - `score`: the least score is the best, also among fits to different observations.
    """

    theta: Theta
    prediction: Prediction
    weight: Values
    cost: float
    freedom: int
    score: float

    @property
    def used(self) -> Rows:
        return np.asarray((self.weight > 0).any(axis=1))


class Model:
    """Predictions of all observations on one branch of orbits, as functions of the unknowns theta."""

    def __init__(self, problem: Problem, theta: Theta, row: int) -> None:
        """Begin the branch at the orbit on which the motion settles at `theta` and the observation `row`."""
        self._problem = problem
        self._last: tuple[bytes, list[Prediction]] | None = None
        if problem.rows:
            self._branch = Branch(problem.point, problem.features, problem.by)
            self._branch.evaluate(problem.points(theta[None])[[row]])

    def predict(self, theta: Theta) -> Prediction:
        return self.predict_all(theta[None])[0]

    def predict_all(self, thetas: Thetas) -> list[Prediction]:
        if self._last is not None and self._last[0] == thetas.tobytes():
            return self._last[1]
        problem, rows, history = self._problem, self._problem.rows, self._problem.history
        values = np.zeros((len(thetas), *problem.values.shape))
        slopes, valid = np.zeros((*values.shape, thetas.shape[1])), np.zeros(values.shape[:2], bool)
        if rows:
            orbits = self._branch.evaluate(problem.points(thetas))
            shape = len(thetas), rows, len(self._branch.of)
            features = orbits.values.reshape(shape)
            changes = np.zeros((*shape, thetas.shape[1]))
            changes[..., problem.free] = orbits.derivatives.reshape(*shape, -1)[..., : len(problem.free)]
            columns = {name: (features[..., k], changes[..., k, :]) for k, name in enumerate(problem.features)}
            if CONSTANT in problem.names:
                place = problem.names.index(CONSTANT)
                relief, change = columns[RELIEF]
                with np.errstate(all="ignore"):
                    slope = thetas[:, place, None, None] * change / relief[..., None]
                    slope[..., place] = np.log(relief)
                    columns[RATE] = thetas[:, [place]] * np.log(relief), slope
            valid[:, :rows] = orbits.valid.reshape(shape[:2])
            for k, name in enumerate(name for name in problem.of if name != VELOCITY):
                values[:, :rows, k], slopes[:, :rows, k] = columns[name]
                valid[:, :rows] &= np.isfinite(columns[name][0])
        if history is not None:
            own = [*problem.free, *range(problem.parameters, len(problem.names))]
            by = [problem.names[k] for k in problem.free]
            velocity, derivatives = history.predict(by, thetas[:, own])
            values[:, rows:, -1], valid[:, rows:] = velocity, np.isfinite(velocity)
            slopes[:, rows:, -1, own] = derivatives
        predictions = [*map(Prediction, np.nan_to_num(values), np.nan_to_num(slopes), valid)]
        self._last = thetas.tobytes(), predictions
        return predictions


def starts(problem: Problem) -> list[tuple[Theta, int]]:
    """Return the points of the box at which searches begin, best first, each with an observation that has an orbit.

    The motions of a sample of points are simulated from the start, or over the history if there is nothing else.
    Different points may lead to different kinds of orbits, so that each search follows a branch of its own.

    **Raises:** `InputError` if the observations of a variable are in another unit.
    """
    unit = qmc.Sobol(problem.parameters, seed=problem.seed).random(SCREENED)
    unit[0] = 0.5
    low, high = (problem.free_of(end)[: problem.parameters] for end in (problem.low, problem.high))
    guess = np.zeros(0) if problem.history is None else problem.history.guess
    thetas = problem.theta_of(np.hstack([low + (high - low) * unit, np.tile(guess, (SCREENED, 1))]))
    if not problem.rows:
        predictions = Model(problem, thetas[0], 0).predict_all(thetas)
        off = [np.where(x.valid, np.abs(x.values[:, -1] - problem.values[:, -1]), np.inf).sum() for x in predictions]
        return [(thetas[k], 0) for k in np.argsort(off, kind="stable")]
    rows = np.unique(np.linspace(0, problem.rows - 1, SCREENED_ROWS).round().astype(int))
    columns = problem.points(thetas).reshape(SCREENED, problem.rows, -1)[:, rows]
    found = settled_at(problem.point, problem.by, columns.reshape(SCREENED * len(rows), -1))
    lanes = {name: found[name].reshape(SCREENED, -1) for name in (*problem.features, "stable") if name in found}
    stable = lanes["stable"] == 1
    cost = np.zeros(stable.shape)
    for k, name in enumerate(problem.of):
        with np.errstate(all="ignore"):
            if name == RATE and CONSTANT in problem.names:
                lanes[name] = thetas[:, [problem.names.index(CONSTANT)]] * np.log(lanes[RELIEF])
            if name in lanes:  # lanes do not have all features of orbits
                about = (VARIABLES | measured_besides(problem.point.system)).get(name)
                _check_unit(name, None if about is None else about.units, problem.values[:, k], lanes[name][stable])
                off = np.abs(lanes[name] / problem.values[rows, k] - 1)
                cost += np.where(stable & (off < 1), off, 1.0)
    order = np.argsort(cost.sum(axis=1), kind="stable")
    return [(thetas[k], int(rows[stable[k].argmax()])) for k in order if stable[k].any()]


def _check_unit(name: str, unit: str | None, observed: np.ndarray, predicted: np.ndarray) -> None:
    """Raise `InputError` if another unit brings the observations of a variable into the range of the motions."""
    value, sizes = float(np.nanmedian(np.abs(observed))), np.abs(predicted[np.isfinite(predicted)])
    if unit is None or not sizes.size or sizes.min() == 0:  # a user's own measure may have any unit
        return
    if sizes.min() / OTHER_UNIT <= value <= sizes.max() * OTHER_UNIT:
        return
    if likely := [*likely_units(value, unit, (sizes.min() / 2, 2 * sizes.max()))]:
        own = UNITS[unit][0]
        raise InputError(
            f"calibrate: column {name}: values such as {value:.6g} {own} are far from those of the motions inside the "
            f"bounds ({sizes.min():.4g} to {sizes.max():.4g} {own}); if they are in {likely[0]}, write "
            f'"{name} ({likely[0]})"'
        )


def fit_from(problem: Problem, model: Model, theta: Theta) -> Fit:
    """Return the end of the search that begins at `theta`.

    Each fit has the observations with an orbit at the end of the fit before. At a trial point at which some of them
    have none, these count as off by their whole size: the point is not excluded, but has to be better for the others.
    """
    low, high = problem.free_of(problem.low), problem.free_of(problem.high)
    prediction = model.predict(theta)
    weight = problem.weights(prediction.valid, problem.values)
    for number in range(MAX_ROUNDS):
        if not (weight > 0).any():
            break

        def residuals(free: np.ndarray, weight: Values = weight) -> np.ndarray:
            theta = problem.theta_of(free)
            trial = model.predict(theta)
            lost = np.where(~trial.valid[:, None] & (weight > 0), weight * np.abs(problem.values), 0.0)
            return np.concatenate([problem.residuals(weight, trial, theta), lost.ravel()])

        def jacobian(free: np.ndarray, weight: Values = weight) -> np.ndarray:
            theta = problem.theta_of(free)
            slopes = problem.jacobian(weight, model.predict(theta)) * np.where(problem.low > 0, theta, 1.0)
            return np.concatenate([slopes, np.zeros((weight.size, len(theta)))])

        with np.errstate(all="ignore"):  # no derivative is different from 0 if, say, the bit never slides
            solution = least_squares(
                residuals, np.clip(problem.free_of(theta), low, high), jacobian, (low, high), x_scale="jac",
                ftol=None, xtol=TOLERANCE, gtol=None, max_nfev=MAX_EVALUATIONS,
            )  # fmt: skip
        theta = problem.theta_of(solution.x)
        prediction = model.predict(theta)
        # Observations come back in the first rounds only, so that the rounds end.
        back = prediction.valid if number < MAX_ROUNDS // 2 else prediction.valid & (weight > 0).any(axis=1)
        new = problem.weights(back, prediction.values)
        if np.allclose(new, weight, rtol=SAME_WEIGHTS, atol=0):
            if problem.history is None or not (along := best_along_step(problem, model, weight, theta))[1] > 0:
                break
            theta = along[0]  # the search stalled at a kink
            prediction = model.predict(theta)
        weight = new
    weight = np.where(prediction.valid[:, None], weight, 0.0)
    cost = float(np.sum(problem.residuals(weight, prediction, theta) ** 2))
    values = int((weight > 0).sum())
    freedom = values + int(np.isfinite(problem.prior_error).sum()) - len(theta)
    # Twice the negative log-likelihood, relative to values that have no orbit and may be anywhere within their size.
    if problem.errors is not None:
        score = cost - 2 * float(np.log(np.fmax(np.abs(weight * problem.values), 1.0)).sum())
    else:
        score = 2 * freedom * np.log(max(np.sqrt(cost / freedom), ORBIT_ERROR)) if freedom > 0 else np.inf
    return Fit(theta, prediction, weight, cost, freedom, score)


def best_along_step(problem: Problem, model: Model, weight: Values, theta: Theta) -> tuple[Theta, float]:
    """Return the best point on the step of Gauss and Newton, and by how much the sum of squares falls there.

    The sum of squares of a history has kinks, where an event passes a sample, at which a search may stall.
    """
    prediction = model.predict(theta)
    residuals, used = problem.residuals(weight, prediction, theta), (weight > 0).any(axis=1)
    step = -np.linalg.lstsq(problem.jacobian(weight, prediction), residuals)[0]
    thetas = np.clip(theta + np.array(STEP_SHARES)[:, None] * step, problem.low, problem.high)
    pairs = zip(thetas, model.predict_all(thetas), strict=True)
    costs = [float(np.sum(problem.residuals(weight, x, at) ** 2)) if x.valid[used].all() else np.inf for at, x in pairs]
    best = int(np.argmin(costs))
    return thetas[best], float(np.sum(residuals**2)) - costs[best]

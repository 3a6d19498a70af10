"""The model of a calibration: predictions on a branch of orbits, the start of the searches, and their least squares."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import least_squares
from scipy.stats import qmc

from vibrojax.studies.calibration_history import VELOCITY
from vibrojax.studies.calibration_spec import CONSTANT, RATE, RELIEF, CalibrationSpec
from vibrojax.studies.sensitivity_branch import Branch, settled_at

MAX_EVALUATIONS = 60
"""Limit of the evaluations of one search; a search from a point of the box takes 5 to 20."""

TOLERANCE = 1e-8
"""Relative tolerance of a search, far below every standard error."""

ORBIT_ERROR = 1e-10
"""Relative error of the features of orbits; residuals cannot show a smaller error of the observations."""

SCREENED = 32
"""Number of points of the box whose motions are simulated, to begin the searches at the best of them."""

SCREENED_ROWS = 4
"""Largest number of observations that are simulated at each of these points."""

MAX_ROUNDS = 8
"""Number of fits from one point. Each has the observations and the weights that follow from the fit before."""

SAME_WEIGHTS = 1e-3
"""Relative change of the weights, far below any error of an estimated noise, at which the rounds end."""

STEP_SHARES = (1.0, 0.3, 0.1, 0.03, 0.01)
"""Shares of a step of Gauss and Newton that are tried where a search ends."""

SMALLEST_SHARE = 1e-2
"""Share of its variable's mean size below which a value has no smaller error: values near 0 are not exact."""

Theta = Float[np.ndarray, " unknown"]
Rows = Bool[np.ndarray, " observations"]
Values = Float[np.ndarray, "observations of"]


class Prediction(NamedTuple):
    """Predictions at one theta, their derivatives, and a mask of the observations with a stable orbit.

    An observation without an orbit has the values of the nearest orbit.
    """

    values: Values
    slopes: Float[np.ndarray, "observations of unknown"]
    valid: Rows


class Target(NamedTuple):
    """Values to be fitted with their inverse standard errors `weight`, 0 where they are left out, and the prior.

    Without standard errors, the weights are relative to an unknown noise.
    """

    values: Values
    weight: Values
    mean: Theta
    width: Theta

    @property
    def used(self) -> Rows:
        """Mask of the observations that are fitted."""
        return np.asarray((self.weight > 0).any(axis=1))

    def residuals(self, prediction: Prediction, theta: Theta) -> Float[np.ndarray, " residuals"]:
        """Return the residuals in standard errors, first of the observations and then of the prior."""
        known = np.where(self.weight > 0, prediction.values - self.values, 0.0)
        return np.concatenate([(self.weight * known).ravel(), (theta - self.mean) / self.width])

    def jacobian(self, prediction: Prediction) -> Float[np.ndarray, "residuals unknown"]:
        """Return the derivatives of the residuals."""
        slopes = np.where(self.weight[..., None] > 0, prediction.slopes, 0.0) * self.weight[..., None]
        return np.concatenate([slopes.reshape(-1, len(self.mean)), np.diag(1 / self.width)])

    def losses(self, valid: Rows) -> Float[np.ndarray, " values"]:
        """Return further residuals: an observation without an orbit is off by its whole size."""
        return np.where(valid[:, None], 0.0, self.weight * np.abs(self.values)).ravel()


class Fit(NamedTuple):
    """The end of one search: theta, its prediction, the target with the observations that have an orbit there.

    - `cost`: sum of squares; `freedom`: number of values and priors minus number of unknowns.
    - `score`: the least score is the best, also among fits to different observations.
    """

    theta: Theta
    prediction: Prediction
    target: Target
    cost: float
    freedom: int
    score: float


class Model:
    """Predictions of all observations on one branch of orbits, as functions of the unknowns theta."""

    def __init__(self, spec: CalibrationSpec, theta: Theta, row: int) -> None:
        """Begin the branch at the orbit on which the motion settles at `theta` and the observation `row`."""
        self._spec = spec
        self._free = [name for name in spec.of_parameters.names if name != CONSTANT]
        self._places = [k for k, name in enumerate(spec.names) if name != CONSTANT]
        self._of = _features(spec)
        self._last: tuple[bytes, list[Prediction]] | None = None
        if spec.rows:
            self._branch = Branch(spec.point, self._of, _parameters(spec))
            self._branch.evaluate(_points(spec, theta[None])[[row]])

    def predict(self, theta: Theta) -> Prediction:
        """Return the predictions at theta."""
        return self.predict_all(theta[None])[0]

    def predict_all(self, thetas: Float[np.ndarray, "draws unknown"]) -> list[Prediction]:
        """Return the predictions at each row of `thetas`."""
        if self._last is not None and self._last[0] == thetas.tobytes():
            return self._last[1]
        rows, history = self._spec.rows, self._spec.history
        values = np.zeros((len(thetas), *self._spec.values.shape))
        slopes, valid = np.zeros((*values.shape, thetas.shape[1])), np.zeros(values.shape[:2], bool)
        if rows:
            own = np.s_[:, :rows, : values.shape[2] - (history is not None)]
            values[own], slopes[own], has_orbit = self._of_rows(thetas)
            valid[:, :rows] = has_orbit & np.isfinite(values[own]).all(axis=2)
        if history is not None:
            velocity, derivatives = history.predict(self._free, thetas[:, self._places])
            values[:, rows:, -1], valid[:, rows:] = velocity, np.isfinite(velocity)
            slopes[:, rows:, -1, self._places] = derivatives
        predictions = [
            Prediction(np.nan_to_num(x), np.nan_to_num(d), ok) for x, d, ok in zip(values, slopes, valid, strict=True)
        ]
        self._last = thetas.tobytes(), predictions
        return predictions

    def _of_rows(self, thetas: Float[np.ndarray, "draws unknown"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the observed variables of the rows, their derivatives, and a mask of the rows with a stable orbit."""
        orbits = self._branch.evaluate(_points(self._spec, thetas))
        shape = len(thetas), self._spec.rows, len(self._branch.of)
        values, places = orbits.values.reshape(shape), self._places[: len(self._free)]
        own = np.zeros((*shape, thetas.shape[1]))  # the first features are `_of`
        own[..., places] = orbits.derivatives.reshape(*shape, -1)[..., : len(places)]
        parts = [self._observed(theta, x, d) for theta, x, d in zip(thetas, values, own, strict=True)]
        return np.stack([x for x, _ in parts]), np.stack([d for _, d in parts]), orbits.valid.reshape(shape[:2])

    def _observed(self, theta: Theta, values: np.ndarray, slopes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the observed variables and their derivatives, from those of the features of the orbits."""
        columns = {name: (values[:, k], slopes[:, k]) for k, name in enumerate(self._of)}
        if CONSTANT in self._spec.names:
            place = self._spec.names.index(CONSTANT)
            relief, change = columns[RELIEF]
            with np.errstate(all="ignore"):
                slope = theta[place] * change / relief[:, None]
                slope[:, place] = np.log(relief)
                columns[RATE] = theta[place] * np.log(relief), slope
        pairs = [columns[name] for name in self._spec.observed if name != VELOCITY]
        return np.stack([x for x, _ in pairs], axis=1), np.stack([x for _, x in pairs], axis=1)


def _features(spec: CalibrationSpec) -> list[str]:
    """Return the features of orbits from which the observed variables follow."""
    lawful = CONSTANT in spec.names
    names = [name for name in spec.observed if name != VELOCITY and (name != RATE or not lawful)]
    return names + [RELIEF] * (lawful and RELIEF not in names)


def _parameters(spec: CalibrationSpec) -> list[str]:
    return [*(name for name in spec.of_parameters.names if name != CONSTANT), *spec.conditions]


def _points(spec: CalibrationSpec, thetas: Float[np.ndarray, "draws unknown"]) -> Float[np.ndarray, "points by"]:
    """Return the parameters of all rows at each row of `thetas`, one row of data after the other."""
    rows = spec.rows
    free = thetas[:, [k for k, name in enumerate(spec.of_parameters.names) if name != CONSTANT]]
    conditions = np.stack([*spec.conditions.values()], axis=1) if spec.conditions else np.zeros((rows, 0))
    return np.concatenate([np.repeat(free, rows, axis=0), np.tile(conditions, (len(thetas), 1))], axis=1)


def free_of(spec: CalibrationSpec, theta: np.ndarray) -> np.ndarray:
    """Return the unknowns as the searches vary them: logarithms of positive ones, whose bounds may span decades."""
    with np.errstate(all="ignore"):
        return np.where(spec.low > 0, np.log(theta), theta)


def theta_of(spec: CalibrationSpec, free: np.ndarray) -> np.ndarray:
    """Return theta inside the bounds; the inverse of `free_of`."""
    with np.errstate(all="ignore"):
        return np.clip(np.where(spec.low > 0, np.exp(free), free), spec.low, spec.high)


def errors_at(spec: CalibrationSpec, values: Values) -> Values:
    """Return the standard errors of the observations, or else the sizes of `values`, to which the noise is relative.

    For samples of a history, the size is the root mean square of all samples.
    """
    if spec.errors is not None:
        return np.stack([spec.errors[name] for name in spec.observed], axis=1)
    if spec.history is not None:
        return np.full_like(values, np.sqrt(np.nanmean(spec.values**2)) or 1.0)
    floor = SMALLEST_SHARE * np.nanmean(np.abs(spec.values), axis=0)
    return np.fmax(np.abs(values), np.where(floor > 0, floor, 1.0))


def starts(spec: CalibrationSpec) -> list[tuple[Theta, int]]:
    """Return the points of the box at which searches begin, best first, each with an observation that has an orbit.

    The motions of a sample of points are simulated from the start, or over the history if there is nothing else.
    Different points may lead to different kinds of orbits, so that each search follows a branch of its own.
    """
    own, history = spec.of_parameters, spec.history
    unit = qmc.Sobol(len(own.names), seed=spec.seed).random(SCREENED)
    unit[0] = 0.5
    low, high = free_of(own, own.low), free_of(own, own.high)
    thetas = theta_of(own, low + (high - low) * unit)
    if history is not None:
        thetas = np.concatenate([thetas, np.tile(history.guess, (SCREENED, 1))], axis=1)
    if not spec.rows:
        predictions = Model(spec, thetas[0], 0).predict_all(thetas)
        off = [np.where(x.valid, np.abs(x.values[:, -1] - spec.values[:, -1]), np.inf).sum() for x in predictions]
        return [(thetas[k], 0) for k in np.argsort(off, kind="stable")]
    rows = np.unique(np.linspace(0, spec.rows - 1, SCREENED_ROWS).round().astype(int))
    by = _parameters(spec)
    columns = _points(spec, thetas).reshape(SCREENED, -1, len(by))[:, rows]
    found = settled_at(spec.point, by, columns.reshape(-1, len(by)))
    lanes = {name: found[name].reshape(SCREENED, -1) for name in (*_features(spec), "stable") if name in found}
    stable = lanes["stable"] == 1
    cost = np.zeros(stable.shape)
    for k, name in enumerate(spec.observed):
        with np.errstate(all="ignore"):
            if name == RATE and CONSTANT in spec.names:
                lanes[name] = thetas[:, [spec.names.index(CONSTANT)]] * np.log(lanes[RELIEF])
            if name in lanes:  # lanes do not have all features of orbits
                off = np.abs(lanes[name] / spec.values[rows, k] - 1)
                cost += np.where(stable & (off < 1), off, 1.0)
    order = np.argsort(cost.sum(axis=1), kind="stable")
    return [(thetas[k], int(rows[stable[k].argmax()])) for k in order if stable[k].any()]


def fit_from(spec: CalibrationSpec, model: Model, theta: Theta) -> Fit:
    """Return the end of the search that begins at `theta`.

    Each fit has the observations with an orbit at the end of the fit before. At a trial point at which some of them
    have none, these count as off by their whole size: the point is not excluded, but has to be better for the others.
    """
    low, high = free_of(spec, spec.low), free_of(spec, spec.high)
    prediction = model.predict(theta)
    target = _target(spec, prediction.valid, spec.values)
    for number in range(MAX_ROUNDS):
        if not target.used.any():
            break

        def residuals(free: np.ndarray, target: Target = target) -> np.ndarray:
            at = theta_of(spec, free)
            trial = model.predict(at)
            return np.concatenate([target.residuals(trial, at), target.losses(trial.valid)])

        def jacobian(free: np.ndarray, target: Target = target) -> np.ndarray:
            at = theta_of(spec, free)
            slopes = target.jacobian(model.predict(at)) * np.where(spec.low > 0, at, 1.0)
            return np.concatenate([slopes, np.zeros((target.values.size, len(at)))])

        with np.errstate(all="ignore"):  # no derivative is different from 0 if, say, the bit never slides
            found = least_squares(
                residuals, np.clip(free_of(spec, theta), low, high), jacobian, (low, high), x_scale="jac",
                ftol=None, xtol=TOLERANCE, gtol=None, max_nfev=MAX_EVALUATIONS,
            )  # fmt: skip
        theta = theta_of(spec, found.x)
        prediction = model.predict(theta)
        # Observations come back in the first rounds only, so that the rounds end.
        back = prediction.valid if number < MAX_ROUNDS // 2 else prediction.valid & target.used
        new = _target(spec, back, prediction.values)
        if np.allclose(new.weight, target.weight, rtol=SAME_WEIGHTS, atol=0):
            if spec.history is None or not (along := best_along_step(spec, model, target, theta))[1] > 0:
                break
            theta = along[0]  # the search stalled at a kink
            prediction = model.predict(theta)
        target = new
    target = target._replace(weight=np.where(prediction.valid[:, None], target.weight, 0.0))
    cost = float(np.sum(target.residuals(prediction, theta) ** 2))
    values = int((target.weight > 0).sum())
    freedom = values + int(np.isfinite(spec.prior_error).sum()) - len(theta)
    # Twice the negative log-likelihood, relative to values that have no orbit and may be anywhere within their size.
    if spec.errors is not None:
        score = cost - 2 * float(np.log(np.fmax(np.abs(target.weight * target.values), 1.0)).sum())
    else:
        score = 2 * freedom * np.log(max(np.sqrt(cost / freedom), ORBIT_ERROR)) if freedom > 0 else np.inf
    return Fit(theta, prediction, target, cost, freedom, score)


def best_along_step(spec: CalibrationSpec, model: Model, target: Target, theta: Theta) -> tuple[Theta, float]:
    """Return the best point on the step of Gauss and Newton, and by how much the sum of squares falls there.

    The sum of squares of a history has kinks, where an event passes a sample, at which a search may stall.
    """
    prediction = model.predict(theta)
    residuals = target.residuals(prediction, theta)
    step = -np.linalg.lstsq(target.jacobian(prediction), residuals)[0]
    thetas = np.clip(theta + np.array(STEP_SHARES)[:, None] * step, spec.low, spec.high)
    pairs = zip(thetas, model.predict_all(thetas), strict=True)
    costs = [float(np.sum(target.residuals(x, at) ** 2)) if x.valid[target.used].all() else np.inf for at, x in pairs]
    best = int(np.argmin(costs))
    return thetas[best], float(np.sum(residuals**2)) - costs[best]


def _target(spec: CalibrationSpec, used: Rows, sizes: Values) -> Target:
    """Return the target of a fit to the observations `used`; without standard errors, with weights at `sizes`."""
    known = np.isfinite(spec.values) & used[:, None]
    weight = np.where(known, 1 / np.where(known, errors_at(spec, sizes), 1.0), 0.0)
    return Target(np.where(known, spec.values, 0.0), weight, spec.prior_mean, spec.prior_error)

"""The function `calibrate`: the searches, the uncertainty of the best estimate, and the dataset."""

from collections.abc import Mapping
from os import PathLike
from typing import Any

import numpy as np
import scipy.stats
import xarray as xr
from jaxtyping import Float

from vibrojax.compile.xla import precision
from vibrojax.errors import InputError, counted
from vibrojax.io.kinds import dataset_attributes
from vibrojax.io.variables import VARIABLES, Variable, described
from vibrojax.progress import Progress
from vibrojax.studies.calibration_file import LAW, Calibration, read_calibration
from vibrojax.studies.calibration_model import (
    CONSTANT,
    ORBIT_ERROR,
    SCREENED,
    TOLERANCE,
    VELOCITY,
    Fit,
    Model,
    best_along_step,
    fit_from,
    starts,
)

CHECKED_DRAWS = 32
"""Draws of the posterior at which the motion is computed again, to check the linear approximation."""

REASONS = ("identified", "confounded", "at-bound")
"""Whether the data determine a parameter."""

USES = ("no", "yes")
"""Whether an observation is used: it is not where the followed orbit does not exist, or is not stable."""

INTERVAL = 0.95
"""Probability with which an interval covers the true value."""

VAGUE = 0.5
"""Relative standard error from which on a parameter is not identified."""

AT_BOUND = 1e-2
"""Distance from a bound, relative to the interval, within which an estimate whose next step leads beyond the bound is
at the bound: a search approaches it slowly."""

LARGEST_OFFSET = 0.05
"""Length of the residuals along the tangent plane, in standard errors, up to which a search has reached a minimum
(Bates and Watts 1981)."""

LARGEST_FALL = 0.1
"""Variances by which the sum of squares of a history may fall along a step, where its minimum is at a kink: the
estimate is then within a third of a standard error of it."""

ERROR_MODELS = {
    "history": "all samples have the same error (normal), which the residuals give; 95 % intervals by Student's t with "
    "{freedom} degrees of freedom",
    "relative": "all values have the same relative error (normal, proportional to the predicted value), which the "
    "residuals give; 95 % intervals by Student's t with {freedom} degrees of freedom",
    "given": "normal errors with the standard errors given; 95 % intervals by the normal distribution",
}
"""Error models without standard errors of the observations, for a history and for rows, and with them."""

_OF, _PARAMETER = ("observation", "of"), ("parameter",)

SCHEMA: dict[str, tuple[tuple[str, ...], Variable]] = {
    "estimate": (_PARAMETER, Variable("", "estimate, in the parameter's own unit")),
    "estimate_stderr": (_PARAMETER, Variable("", "standard error of the estimate, in the parameter's own unit")),
    "estimate_low": (_PARAMETER, Variable("", "lower end of the 95 % interval, not below the bound")),
    "estimate_high": (_PARAMETER, Variable("", "upper end of the 95 % interval, not above the bound")),
    "low": (_PARAMETER, Variable("", "lower bound, in the parameter's own unit")),
    "high": (_PARAMETER, Variable("", "upper bound, in the parameter's own unit")),
    "reason": (_PARAMETER, Variable("1", "whether the data determine the parameter", np.int8, REASONS)),
    "correlation": (("parameter", "other"), Variable("1", "correlation of two estimates")),
    "direction": (("combination", "parameter"), Variable("1", "exponent of the parameter in a combination")),
    "direction_error": (("combination",), Variable("1", "relative standard error of a combination, best known first")),
    "posterior": (("draw", "parameter"), Variable("", "draws of the posterior, in the parameter's own unit")),
    "observed": (_OF, Variable("", "observation, in the variable's own unit")),
    "predicted": (_OF, Variable("", "value of the orbit at the estimate, in the variable's own unit")),
    "residual": (_OF, Variable("1", "predicted minus observed, in standard errors of the observation")),
    "used": (("observation",), Variable("1", "whether the observation is used", np.int8, USES)),
    "chi_squared": ((), Variable("1", "sum of the squared residuals")),
    "freedom": ((), Variable("1", "number of used values minus number of unknowns", np.int32)),
    "noise": ((), Variable("1", "relative error of the observations that the residuals give; NaN if it was given")),
    "nonlinearity": (
        (),
        Variable("1", "error of the linear prediction over draws of the posterior, relative to their spread"),
    ),
}


def calibrate(source: str | PathLike[str] | Mapping[str, object], progress: bool = True) -> xr.Dataset:
    """Estimate parameters of a drill from observations of its motion, by gradients through all events.

        runs = {"v": [1.2, 1.5, 1.8], "period": [...], "impact_velocity": [...]}
        fit = vj.calibrate({"scene": "vibro-impact", "start": "stuck", "data": runs, "unknown": {"mu": [0.2, 0.6]}})

    Each observation is one row of a table: operating conditions, which are parameters of the scene, and observed values
    of variables of the orbit (period, forces, velocities, powers, rates). At a sample of points inside the bounds, the
    motions from `start` are simulated. From the best of these points, the orbit is continued to all rows, and SciPy's
    `least_squares` minimises the residuals with the derivatives of the orbits. Rows without a stable orbit at the end
    of a search are left out. The best end has many rows and small residuals, by their likelihood. Attractors coexist:
    observations of another motion are fitted by the wrong orbit, and their residuals show it.

    A recorded velocity of the bit over time, beside the rows or in place of them, is compared with the motion itself:
    over a few returns it determines the friction (`mu`, `v_cr`). The state at its first sample is fitted too, unless it
    is given.

        vj.calibrate({"scene": "rotary", "history": "bit.csv", "unknown": {"mu": [0.1, 0.8], "v_cr": [1.0, 6.0]}})

    The Fisher information J'J of the residuals, in logarithms of positive parameters, has eigenvectors: combinations of
    powers of the parameters that the data determine, each with its relative error. The posterior is the normal
    approximation around the estimate (Laplace), in the same logarithms, or Student's t if the residuals give the error
    of the observations. `nonlinearity` checks it: at draws of the posterior the motion is computed again and compared
    with the linear prediction.

    **Arguments:** `source`: path of a TOML file, or a dict, with

    - `scene`, `start`, `[parameters]`: as in `simulate`.
    - `data`: path of a CSV file or, in a dict, a table. Headers are names of parameters and variables, with units as in
      `peak_impact_force (kN)`; columns `NAME_error` hold standard errors. In `drilling`, `C` [m/s] may be unknown too:
      then `rate_of_penetration` is C ln(relief).
    - `history`: dataset of `simulate`, table, or path of a CSV or NetCDF file with the columns `time` [s] and `v1`
      [m/s], the velocity of the bit relative to the drive, with other units as in `v1 (mm/s)`; `x1`, `x2`, `v2` begin
      the search for the first state. Or a table `[history]` with this as `data`, `columns` (NAME = COLUMN, if columns
      have other names), `window` (begin and end [s], by default all), `start` (the state at the first sample, as in
      `simulate`), and the operating conditions that are columns of the rows. `[error]` v1 is the standard error [m/s]
      of a sample.
    - `[unknown]` NAME = [low, high]; `[error]` NAME = standard error of a variable (without errors, all values have
      the same relative error, which the residuals give; a value below a hundredth of its variable's mean size has the
      error of that hundredth); `[prior]` NAME = [mean, standard deviation].
    - `searches` (3), `draws` (1000), `seed` (0), `title`.

    **Returns:** a dataset with `estimate`, `estimate_stderr`, the 95 % interval from `estimate_low` to `estimate_high`,
    and `reason` along `parameter`; `correlation`, `direction` and `direction_error` along `combination`, `posterior`
    along `draw`; `observed`, `predicted`, `residual` and `used` (1 or 0) along `observation`, with `time` for samples
    of a history; `first_state` along `state`, if it is fitted; attribute `error_model`.

    **Raises:** `InputError` for invalid input, too few observations with an orbit, or if no search reaches a minimum.

    **Example:**

    >>> runs = {"v": [1.2, 1.5, 1.8], "period": [0.230586, 0.229602, 0.228930]}  # of the orbits at beta = 0.4
    >>> about = {"scene": "vibro-impact", "start": "stuck", "parameters": {"delta": 0.005, "gamma": 0.75}}
    >>> fit = vj.calibrate({**about, "data": runs, "unknown": {"beta": [0.3, 0.5]}, "searches": 1}, progress=False)
    >>> f"{float(fit.estimate[0]):.2f}"
    '0.40'
    """
    return find_calibration(read_calibration(source), progress)


def find_calibration(asked: Calibration, progress: bool = True) -> xr.Dataset:
    """Return the dataset of a checked calibration."""
    problem, searches, name = asked.problem, asked.file.searches, asked.origin.file
    with precision("float64"), Progress(searches, "searches", progress) as bar:
        begins = starts(problem)
        if not begins:
            raise InputError(
                f"{name}: no observation has a stable orbit from the start at any of {SCREENED} points inside the "
                "bounds; choose narrower bounds around plausible values, or another start"
            )
        fits = []
        for theta, row in begins[:searches]:
            model = Model(problem, theta, row)
            fits.append((fit_from(problem, model, theta), model))
            bar.add(1)
        fit, model = min(fits, key=lambda pair: pair[0].score)
        used = fit.target.used
        if fault := problem.shortage(used):
            orbits = f"{used.sum()} of {counted(len(used), 'observation')} {'has' if used.sum() == 1 else 'have'}"
            raise InputError(
                f"{name}: {orbits} an orbit of one kind inside the bounds: {fault}; narrower bounds, another "
                "start or more searches may find others"
            )
        return _dataset(asked, model, fit)


def _dataset(asked: Calibration, model: Model, fit: Fit) -> xr.Dataset:
    problem, (theta, prediction, target, cost, freedom, _) = asked.problem, fit
    residuals, jacobian = target.residuals(prediction, theta), target.jacobian(prediction)
    given, count, history = problem.errors is not None, problem.parameters, problem.history
    names, low, high, estimate = problem.names[:count], problem.low[:count], problem.high[:count], theta[:count]
    variance = 1.0 if given else max(cost / freedom, ORBIT_ERROR**2)
    noise = np.nan if given else float(np.sqrt(variance))
    step = -np.linalg.lstsq(jacobian, residuals)[0]
    margin = AT_BOUND * (problem.high - problem.low)
    beyond = (theta < problem.low + margin) & (theta + step < problem.low)
    beyond |= (theta > problem.high - margin) & (theta + step > problem.high)
    free = jacobian * ~beyond
    offset = np.linalg.norm(free @ np.linalg.lstsq(free, residuals)[0])
    far = offset > LARGEST_OFFSET * np.sqrt(variance * len(theta)) + TOLERANCE
    if far and (history is None or best_along_step(problem, model, target, theta)[1] > LARGEST_FALL * variance):
        where = ", ".join(f"{name} = {x:.4g}" for name, x in zip(problem.names, theta, strict=True))
        raise InputError(
            f"{asked.origin.file}: no search has reached a minimum of the residuals; the best one ended at {where}, "
            f"where {target.used.sum()} of {counted(len(problem.labels), 'observation')} have an orbit; give other "
            "bounds, another start, more searches, or leave out observations of other motions"
        )
    # Unknown states follow the parameters: what they cannot compensate determines the parameters.
    along = jacobian[:, count:]
    follow = -np.linalg.pinv(along) @ jacobian[:, :count]
    scale = np.where(low > 0, np.abs(estimate), high - low)
    covariance, directions, direction_error = _uncertainty((jacobian[:, :count] + along @ follow) * scale, variance)
    width = np.sqrt(np.diag(covariance))

    def moved(steps: np.ndarray) -> np.ndarray:
        """Return estimates changed by `steps` in units of `scale`, in logarithms of positive parameters, in bounds."""
        with np.errstate(over="ignore"):
            return np.clip(np.where(low > 0, estimate * np.exp(steps), estimate + scale * steps), low, high)

    rng = np.random.default_rng(problem.seed)
    finite = np.where(np.isfinite(direction_error), direction_error, 1e3)
    steps = (rng.standard_normal((asked.file.draws, count)) * finite) @ directions
    if not given and freedom > 0:  # the error of the observations is uncertain itself: Student's t
        steps /= np.sqrt(rng.chisquare(freedom, (len(steps), 1)) / freedom)
    draws = moved(steps)
    reason = np.where(width < VAGUE, REASONS.index("identified"), REASONS.index("confounded"))
    reason = np.where(beyond[:count], REASONS.index("at-bound"), reason)
    nonlinearity = np.nan
    if not reason.any():
        checked = draws[:CHECKED_DRAWS]
        nonlinearity = _nonlinearity(
            model, fit, jacobian, np.hstack([checked, theta[count:] + (checked - estimate) @ follow.T])
        )
    quantile = scipy.stats.norm.ppf(0.5 + INTERVAL / 2) if given else scipy.stats.t.ppf(0.5 + INTERVAL / 2, freedom)
    error = problem.errors_at(prediction.values) * (1.0 if given else noise)
    predicted = prediction.values.copy()
    if history is not None:  # rows have no samples, and samples no variables of orbits
        predicted[: problem.rows, -1] = predicted[problem.rows :, :-1] = np.nan
    table: dict[str, Any] = {
        "estimate": estimate,
        "estimate_stderr": scale * width,
        "estimate_low": moved(-quantile * width),
        "estimate_high": moved(quantile * width),
        "low": low,
        "high": high,
        "reason": reason,
        "correlation": covariance / width / width[:, None],
        "direction": directions,
        "direction_error": direction_error,
        "posterior": draws,
        "observed": problem.values,
        "predicted": predicted,
        "residual": np.where(target.weight > 0, (prediction.values - problem.values) / error, np.nan),
        "used": target.used,
        "chi_squared": cost / variance,
        "freedom": freedom,
        "noise": noise,
        "nonlinearity": nonlinearity,
    }
    parameters = {**problem.point.system.parameters(), CONSTANT: LAW}
    units = {name: about.units for name, about in VARIABLES.items()} | {VELOCITY: "m s-1"}
    coordinates: dict[str, Any] = {
        "parameter": [*names],
        "other": [*names],
        "of": [*problem.of],
        "observation": problem.labels,
        "parameter_unit": ("parameter", [parameters[name].unit for name in names]),
        "parameter_long_name": ("parameter", [parameters[name].long_name for name in names]),
        "of_unit": ("of", [units[name] for name in problem.of]),
    }
    for name, x in problem.conditions.items():
        meaning = {"units": parameters[name].unit, "long_name": parameters[name].long_name}
        if history is not None:
            x = np.append(x, np.full(len(history.times), history.point.parameters[name]))
        coordinates[name] = ("observation", x, meaning)
    variables = described(
        {name: (SCHEMA[name][0], x) for name, x in table.items()}, {n: v for n, (_, v) in SCHEMA.items()}
    )
    if history is not None:
        times = np.append(np.full(problem.rows, np.nan), history.begin + history.times)
        coordinates["time"] = ("observation", times, {"units": "s", "long_name": "time of a sample of the history"})
        if history.states:
            system = problem.point.system
            coordinates["state"] = [*history.states]
            coordinates["state_unit"] = ("state", [system.states[system.place(name)].unit for name in history.states])
            meaning = {"long_name": "state at the first sample of the history, in its own unit"}
            variables["first_state"] = ("state", theta[count:], meaning)
    about = problem.point.system.parameters()
    symbols = ", ".join(about[name].symbol if name in about else name for name in names)
    title = str(asked.file.title or f"Calibration of {symbols}")
    attributes = dataset_attributes("calibration", title, "calibrate", scene=problem.point.scene)
    kind = "given" if given else "relative" if history is None else "history"
    more = {"specification": asked.origin.text, "searches": asked.file.searches}
    return xr.Dataset(
        variables, coordinates, attributes | more | {"error_model": ERROR_MODELS[kind].format(freedom=freedom)}
    )


def _uncertainty(
    scaled: Float[np.ndarray, "residuals unknown"], variance: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the covariance from the Fisher information J'J, and combinations of the unknowns with their errors.

    The covariance is very large, but finite, where the data do not determine a parameter. The combinations are
    orthonormal rows, the best known first.
    """
    values, vectors = np.linalg.eigh(scaled.T @ scaled)
    values, vectors = values[::-1], vectors[:, ::-1]
    floor = np.finfo(float).eps * max(values[0], 0.0) * len(values)
    with np.errstate(divide="ignore"):
        errors = np.sqrt(variance / np.where(values > floor, values, 0.0))
    finite = np.where(np.isfinite(errors), errors, 1e9)  # products with infinities would be NaN
    signs = np.sign(vectors[np.abs(vectors).argmax(axis=0), np.arange(len(values))])
    return (vectors * finite**2) @ vectors.T, (vectors * signs).T, errors


def _nonlinearity(model: Model, fit: Fit, jacobian: np.ndarray, draws: np.ndarray) -> float:
    """Return the error of the linear prediction at draws of the posterior, relative to the spread of the prediction."""
    rows, width = slice(0, fit.target.values.size), fit.target.values.shape[1]
    centre = fit.target.residuals(fit.prediction, fit.theta)
    off, spread = [], []
    for draw, prediction in zip(draws, model.predict_all(draws), strict=True):
        valid = np.repeat(prediction.valid, width)
        linear = jacobian @ (draw - fit.theta)
        off.append((fit.target.residuals(prediction, draw) - centre - linear)[rows][valid])
        spread.append(linear[rows][valid])
    total = np.sum(np.concatenate(spread) ** 2)
    return float(np.sqrt(np.sum(np.concatenate(off) ** 2) / total)) if total > 0 else np.nan

"""Calibration of a drill's parameters: least squares through periodic orbits, identifiability, and a posterior."""

import json
from collections.abc import Callable, Mapping
from os import PathLike
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optimistix
import xarray as xr
from jaxtyping import Bool, Float
from scipy.stats import qmc

from vibrojax.analyses.calibration.spec import CONSTANT, RATE, RELIEF, CalibrationSpec, read_calibration
from vibrojax.analyses.sensitivity.gradients import VALID, as_jax
from vibrojax.compile.xla import precision
from vibrojax.errors import InputError
from vibrojax.io.kinds import dataset_attributes
from vibrojax.io.variables import VARIABLES, Variable
from vibrojax.progress import Progress

REASONS = ("identified", "confounded", "at-bound", "not-converged", "too-few-observations")
"""Why an estimate holds or does not."""

USES = ("used", "no-orbit")
"""Use of an observation: it is left out where the followed orbit does not exist, or is not stable."""

VAGUE = 0.5
"""Relative standard error from which on a parameter is not identified."""

AT_BOUND = 1e-3
"""Distance from a bound, relative to the interval, within which an estimate is at the bound."""

MAX_STEPS = 60
"""Limit of the steps of one search; a search from a point of the box takes 5 to 20."""

LARGEST_OFFSET = 0.05
"""Length of the residuals along the tangent plane, in standard errors, up to which a search has reached a minimum
(Bates and Watts 1981)."""

TOLERANCE = 1e-8
"""Relative and absolute tolerance of a search, far below every standard error."""

SCREENED = 64
"""Number of points of the box at which the residuals are computed, to begin the searches at the best ones."""

MAX_ROUNDS = 3
"""Number of fits, each without the observations for which the fit before found no orbit."""

MAX_MODELS = 4
"""Number of drills with operating conditions whose compiled functions are kept."""

CHECKED_DRAWS = 32
"""Draws of the posterior at which the motion is computed again, to check the linear approximation."""

_OF, _PARAMETER = ("observation", "of"), ("parameter",)

SCHEMA: dict[str, tuple[tuple[str, ...], Variable]] = {
    "estimate": (_PARAMETER, Variable("", "estimate, in the parameter's own unit")),
    "estimate_stderr": (_PARAMETER, Variable("", "standard error of the estimate, in the parameter's own unit")),
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
    "used": (("observation",), Variable("1", "use of the observation", np.int8, USES)),
    "chi_squared": ((), Variable("1", "sum of the squared residuals")),
    "freedom": ((), Variable("1", "number of used values minus number of unknowns", np.int32)),
    "noise": ((), Variable("1", "relative error of the observations that the residuals give; NaN if it was given")),
    "nonlinearity": (
        (),
        Variable("1", "error of the linear prediction over draws of the posterior, relative to their spread"),
    ),
}

Theta = Float[np.ndarray, " unknown"]


def calibrate(source: str | PathLike[str] | Mapping[str, object], progress: bool = True) -> xr.Dataset:
    """Estimate parameters of a drill from observations of its periodic motion, by gradients through the orbits.

        runs = {"v": [1.2, 1.5, 1.8], "period": [...], "impact_velocity": [...]}
        fit = vj.calibrate({"scene": "vibro-impact", "start": "stuck", "data": runs, "unknown": {"mu": [0.2, 0.6]}})

    Each observation is one row of a table: operating conditions, which are parameters of the scene, and observed values
    of variables of the orbit (period, forces, velocities, powers, rates). The residuals are differentiated by
    [vibrojax.as_jax][] and minimised by optimistix's Levenberg-Marquardt method inside the bounds, from several points.
    The orbit is the one on which the motion from `start` settles at the first row, and its continuation: attractors
    coexist, so observations of another motion are fitted by the wrong orbit, and their residuals show it. To fit
    friction to the velocity of the bit over time, use [vibrojax.fit_friction][].

    The Fisher information J'J of the residuals, in logarithms of positive parameters, has eigenvectors: combinations of
    powers of the parameters that the data determine, each with its relative error. The posterior is the normal
    approximation around the estimate (Laplace), in the same logarithms. `nonlinearity` checks it: at draws of the
    posterior the motion is computed again and compared with the linear prediction.

    **Arguments:** `source`: path of a TOML file, or a dict, with

    - `scene`, `start`, `[parameters]`: as in `simulate`.
    - `data`: path of a CSV file or, in a dict, a table. Headers are names of parameters and variables, with units as in
      `peak_impact_force (kN)`; columns `NAME_error` hold standard errors. In `drilling`, `C` [m/s] may be unknown too:
      then `rate_of_penetration` is C ln(relief).
    - `[unknown]` NAME = [low, high]; `[error]` NAME = standard error of a variable (without errors, all variables have
      the same relative error, which the residuals give); `[prior]` NAME = [mean, standard deviation].
    - `searches` (3), `draws` (1000), `seed` (0), `title`.

    **Returns:** a dataset with `estimate`, `estimate_stderr` and `reason` along `parameter`, `correlation`, `direction`
    and `direction_error` along `combination`, `posterior` along `draw`; `observed`, `predicted`, `residual` and `used`
    along `observation`.

    **Raises:** `InputError`.

    **Example:**

    >>> runs = {"v": [1.2, 1.5, 1.8], "period": [0.230586, 0.229602, 0.228930]}  # of the orbits at beta = 0.4
    >>> about = {"scene": "vibro-impact", "start": "stuck", "parameters": {"delta": 0.005, "gamma": 0.75}}
    >>> fit = vj.calibrate({**about, "data": runs, "unknown": {"beta": [0.3, 0.5]}, "searches": 1}, progress=False)
    >>> f"{float(fit.estimate[0]):.2f}"
    '0.40'
    """
    return find_calibration(read_calibration(source), progress)


class Search(NamedTuple):
    """The result of a search: unknowns and sum of squares."""

    theta: Theta
    cost: float


def find_calibration(spec: CalibrationSpec, progress: bool = True) -> xr.Dataset:
    """Return the dataset of a checked calibration."""
    with precision("float64"), Progress(spec.searches, "searches", progress) as bar:
        model = _model(spec)
        theta = (spec.low + spec.high) / 2
        predicted, valid = map(np.asarray, model.predict(jnp.asarray(theta)))
        if not valid.any():
            where = ", ".join(f"{name} = {x:g}" for name, x in zip(spec.names, theta, strict=True))
            raise InputError(
                f"{spec.file}: no observation has a stable orbit from the start at the centre of the bounds, {where}; "
                "choose other bounds, or another start"
            )
        used = np.ones(len(valid), bool)
        for number in range(MAX_ROUNDS):
            searches = _search(spec, model, used, bar if number == 0 else None)
            best = min(searches, key=lambda search: search.cost)
            predicted, valid = map(np.asarray, model.predict(jnp.asarray(best.theta)))
            if (valid | ~used).all() or not (valid & used).any():
                break
            used &= valid
        return _dataset(spec, model, best, predicted, used & valid)


class Model(NamedTuple):
    """Compiled functions of the unknowns theta.

    - `predict`: predictions (observations, variables), and a mask of the observations that have a stable orbit.
    - `slopes`: derivatives of the predictions (observations, variables, unknowns).
    - `costs`: sums of squares at points of the unit box; `solve`: theta and sum of squares of a search from a point.
      Their other arguments are the bounds and those of `_data`.
    """

    predict: Callable[..., Any]
    slopes: Callable[..., Any]
    costs: Callable[..., Any]
    solve: Callable[..., Any]


def _model(spec: CalibrationSpec) -> Model:
    """Return the functions of a calibration; they are kept for others of the same drill and operating conditions."""
    conditions = {name: x.tolist() for name, x in spec.conditions.items()}
    try:
        key = json.dumps([spec.scene, spec.start, spec.fixed, conditions, spec.names, [*spec.observed]])
    except TypeError:  # a scene or a law is an object
        return _compiled(spec)
    if key not in _MODELS:
        while len(_MODELS) >= MAX_MODELS:
            del _MODELS[next(iter(_MODELS))]
        _MODELS[key] = _compiled(spec)
    return _MODELS[key]


_MODELS: dict[str, Model] = {}


def _compiled(spec: CalibrationSpec) -> Model:
    own = [name for name in spec.names if name != CONSTANT]
    of = [*spec.observed]
    needed = [name for name in of if name != RATE or CONSTANT not in spec.names]
    needed += [RELIEF] if CONSTANT in spec.names and RELIEF not in needed else []
    f = as_jax(spec.scene, of=needed, by=[*own, *spec.conditions], start=spec.start, **spec.fixed)
    rows = len(spec.labels)
    columns = np.stack([*spec.conditions.values()], axis=1) if spec.conditions else np.zeros((rows, 0))
    conditions = jnp.asarray(columns)
    places = [k for k, name in enumerate(spec.names) if name != CONSTANT]

    def predict(theta: Any) -> tuple[Any, Any]:
        free = jnp.broadcast_to(theta[jnp.array(places, int)], (rows, len(places)))
        values = dict(jax.vmap(f)(jnp.concatenate([free, conditions], axis=1)))
        if CONSTANT in spec.names:
            values[RATE] = theta[spec.names.index(CONSTANT)] * jnp.log(values[RELIEF])
        return jnp.stack([values[name] for name in of], axis=1), values[VALID]

    def residuals(theta: Any, target: Any, weight: Any, mean: Any, width: Any) -> Any:
        # An orbit without the variable has NaN, which a weight of 0 does not remove.
        predicted = jnp.where(weight > 0, predict(theta)[0], 0.0)
        return jnp.concatenate([(weight * (predicted - target)).ravel(), (theta - mean) / width])

    def solve(point: Any, low: Any, high: Any, *data: Any) -> Any:
        def inside(free: Any) -> Any:  # stays inside the bounds
            return low + (high - low) * jax.nn.sigmoid(free)

        solver: Any = optimistix.LevenbergMarquardt(TOLERANCE, TOLERANCE)
        solution: Any = optimistix.least_squares(
            lambda free, _: residuals(inside(free), *data), solver, jnp.log(point / (1 - point)),
            max_steps=MAX_STEPS, throw=False,
        )  # fmt: skip
        theta = inside(solution.value)
        return theta, jnp.sum(residuals(theta, *data) ** 2)

    def costs(points: Any, low: Any, high: Any, *data: Any) -> Any:
        return jax.vmap(lambda point: jnp.sum(residuals(low + (high - low) * point, *data) ** 2))(points)

    slopes = jax.jit(jax.jacfwd(lambda theta: predict(theta)[0]))
    return Model(jax.jit(predict), slopes, jax.jit(costs), jax.jit(solve))


def _observations(spec: CalibrationSpec) -> tuple[np.ndarray, np.ndarray]:
    """Return the observations (observations, variables) and their standard errors, or the scales in place of these."""
    observed = np.stack([*spec.observed.values()], axis=1)
    if spec.errors is not None:
        return observed, np.stack([spec.errors[name] for name in spec.observed], axis=1)
    return observed, np.broadcast_to(np.nanmean(np.abs(observed), axis=0), observed.shape)


def _data(spec: CalibrationSpec, used: Bool[np.ndarray, " rows"]) -> tuple[np.ndarray, ...]:
    """Return targets and weights (0 for values that are left out), and mean and standard deviation of the prior."""
    observed, errors = _observations(spec)
    known = np.isfinite(observed) & used[:, None]
    weight = np.where(known, 1 / np.where(known, errors, 1.0), 0.0)
    return np.where(known, observed, 0.0), weight, spec.prior_mean, spec.prior_error


def _search(spec: CalibrationSpec, model: Model, used: Bool[np.ndarray, " rows"], bar: Progress | None) -> list[Search]:
    """Return the results of searches from the best points of a sample of the box."""
    arguments = [jnp.asarray(x) for x in (spec.low, spec.high, *_data(spec, used))]
    points = qmc.Sobol(len(spec.names), seed=spec.seed).random(SCREENED)
    points = np.clip(np.concatenate([np.full((1, len(spec.names)), 0.5), points[1:]]), 0.02, 0.98)
    costs = np.asarray(model.costs(jnp.asarray(points), *arguments))
    searches = []
    for point in points[np.argsort(np.where(np.isfinite(costs), costs, np.inf), kind="stable")][: spec.searches]:
        theta, cost = map(np.asarray, model.solve(jnp.asarray(point), *arguments))
        searches.append(Search(theta, float(cost) if np.isfinite(cost) else np.inf))
        if bar is not None:
            bar.add(1)
    return searches


class Uncertainty(NamedTuple):
    """What the data say of the unknowns near the estimate, in units of `scale`.

    - `covariance`: infinite where the data do not determine a parameter.
    - `directions`: orthonormal combinations as rows, with their standard errors `errors`, the best known first.
    """

    scale: Theta
    covariance: Float[np.ndarray, "unknown unknown"]
    directions: Float[np.ndarray, "unknown unknown"]
    errors: Theta


def _uncertainty(spec: CalibrationSpec, theta: Theta, jacobian: np.ndarray, variance: float) -> Uncertainty:
    """Return covariance and combinations from the Fisher information J'J; logarithms of positive parameters."""
    scale = np.where(spec.low > 0, np.abs(theta), spec.high - spec.low)
    scaled = jacobian * scale
    values, vectors = np.linalg.eigh(scaled.T @ scaled)
    values, vectors = values[::-1], vectors[:, ::-1]
    floor = np.finfo(float).eps * max(values[0], 0.0) * len(theta)
    with np.errstate(divide="ignore"):
        errors = np.sqrt(variance / np.where(values > floor, values, 0.0))
    finite = np.where(np.isfinite(errors), errors, 1e9)  # products with infinities would be NaN
    covariance = (vectors * finite**2) @ vectors.T
    signs = np.sign(vectors[np.abs(vectors).argmax(axis=0), np.arange(len(theta))])
    return Uncertainty(scale, covariance, (vectors * signs).T, errors)


def _dataset(
    spec: CalibrationSpec, model: Model, best: Search, predicted: np.ndarray, used: Bool[np.ndarray, " rows"]
) -> xr.Dataset:
    observed, errors = _observations(spec)
    values = np.isfinite(observed) & used[:, None]
    freedom = int(values.sum()) + int(np.isfinite(spec.prior_error).sum()) - len(spec.names)
    slopes, weight = np.asarray(model.slopes(jnp.asarray(best.theta))), _data(spec, used)[1]
    weighted = np.where(weight[..., None] > 0, weight[..., None] * slopes, 0.0).reshape(-1, len(spec.names))
    jacobian = np.concatenate([weighted, np.diag(1 / spec.prior_error)])
    variance = 1.0 if spec.errors is not None else best.cost / freedom if freedom > 0 else np.nan
    noise = np.nan if spec.errors is not None else float(np.sqrt(variance))
    known = _uncertainty(spec, best.theta, jacobian, variance if np.isfinite(variance) else 1.0)
    stderr = known.scale * np.sqrt(np.diag(known.covariance))
    place = (best.theta - spec.low) / (spec.high - spec.low)
    reason = np.where(stderr < VAGUE * known.scale, REASONS.index("identified"), REASONS.index("confounded"))
    reason = np.where(np.minimum(place, 1 - place) < AT_BOUND, REASONS.index("at-bound"), reason)
    left = np.concatenate(
        [
            (weight * (np.where(weight > 0, predicted, 0.0) - _data(spec, used)[0])).ravel(),
            (best.theta - spec.prior_mean) / spec.prior_error,
        ]
    )
    along = jacobian @ np.linalg.lstsq(jacobian, left)[0]
    if not np.linalg.norm(along) <= LARGEST_OFFSET * np.sqrt(variance * len(spec.names)) + TOLERANCE:
        reason[reason == REASONS.index("identified")] = REASONS.index("not-converged")
    if freedom < 0 or (freedom == 0 and spec.errors is None):
        reason[:], stderr = REASONS.index("too-few-observations"), np.full_like(stderr, np.nan)
    draws = _draws(spec, best.theta, known)
    width = np.sqrt(np.diag(known.covariance))
    error = noise * errors if spec.errors is None else errors
    table: dict[str, Any] = {
        "estimate": best.theta,
        "estimate_stderr": stderr,
        "low": spec.low,
        "high": spec.high,
        "reason": reason,
        "correlation": known.covariance / width / width[:, None],
        "direction": known.directions,
        "direction_error": known.errors,
        "posterior": draws,
        "observed": observed,
        "predicted": predicted,
        "residual": np.where(values, (predicted - observed) / error, np.nan),
        "used": np.where(used, USES.index("used"), USES.index("no-orbit")),
        "chi_squared": best.cost / variance if freedom > 0 else best.cost,
        "freedom": freedom,
        "noise": noise,
        "nonlinearity": _nonlinearity(model, best.theta, slopes, draws, values, error) if reason.max() == 0 else np.nan,
    }
    parameters = spec.point.system.parameters()
    about = {name: (parameters[name].unit, parameters[name].long_name) for name in spec.names if name != CONSTANT}
    about |= {CONSTANT: ("m s-1", "coefficient of the law, rate = C ln(P/D)")}
    of = [*spec.observed]
    coordinates: dict[str, Any] = {
        "parameter": [*spec.names],
        "other": [*spec.names],
        "of": of,
        "observation": spec.labels,
        "parameter_unit": ("parameter", [about[name][0] for name in spec.names]),
        "parameter_long_name": ("parameter", [about[name][1] for name in spec.names]),
        "of_unit": ("of", [VARIABLES[name].units for name in of]),
    }
    for name, x in spec.conditions.items():
        meaning = {"units": parameters[name].unit, "long_name": parameters[name].long_name}
        coordinates[name] = ("observation", x, meaning)
    variables = {
        name: (dims, np.asarray(table[name], schema.dtype), schema.attributes())
        for name, (dims, schema) in SCHEMA.items()
    }
    attributes = dataset_attributes("calibration", spec.title, "calibrate", scene=spec.point.scene)
    fixed = {"specification": spec.text, "searches": spec.searches}
    return xr.Dataset(variables, coordinates, attributes | fixed)


def _draws(spec: CalibrationSpec, theta: Theta, known: Uncertainty) -> Float[np.ndarray, "draws unknown"]:
    """Return draws of the posterior, normal in logarithms of positive parameters, and inside the bounds."""
    rng = np.random.default_rng(spec.seed)
    finite = np.where(np.isfinite(known.errors), known.errors, 1e3)
    steps = (rng.standard_normal((spec.draws, len(theta))) * finite) @ known.directions
    with np.errstate(over="ignore"):
        draws = np.where(spec.low > 0, theta * np.exp(steps), theta + known.scale * steps)
    return np.clip(draws, spec.low, spec.high)


def _nonlinearity(
    model: Model,
    theta: Theta,
    slopes: np.ndarray,
    draws: np.ndarray,
    values: Bool[np.ndarray, "rows of"],
    error: np.ndarray,
) -> float:
    """Return the error of the linear prediction at draws of the posterior, relative to the spread of the prediction."""
    centre = np.asarray(model.predict(jnp.asarray(theta))[0])
    off, spread = [], []
    for draw in draws[:CHECKED_DRAWS]:
        exact, valid = map(np.asarray, model.predict(jnp.asarray(draw)))
        linear = slopes @ (draw - theta)
        mask = values & valid[:, None]
        off.append(((exact - centre - linear) / error)[mask])
        spread.append((linear / error)[mask])
    return float(np.sqrt(np.mean(np.concatenate(off) ** 2) / np.mean(np.concatenate(spread) ** 2)))

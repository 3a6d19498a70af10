"""The model of a calibration: residuals as compiled functions of the unknowns, and their least squares.

The least squares are those of optimistix: they differentiate and compile together with the model, so that all searches
and fits of one drill share a program.
"""

import json
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optimistix
from jaxtyping import Bool, Float
from scipy.stats import qmc

from vibrojax.analyses.calibration.spec import CONSTANT, RATE, RELIEF, CalibrationSpec
from vibrojax.analyses.sensitivity.gradients import VALID, as_jax
from vibrojax.progress import Progress

MAX_STEPS = 60
"""Limit of the steps of one search; a search from a point of the box takes 5 to 20."""

TOLERANCE = 1e-8
"""Relative and absolute tolerance of a search, far below every standard error."""

SCREENED = 64
"""Number of points of the box at which the residuals are computed, to begin the searches at the best ones."""

MAX_MODELS = 4
"""Number of drills with operating conditions whose compiled functions are kept."""

Theta = Float[np.ndarray, " unknown"]


class Model(NamedTuple):
    """Compiled functions of the unknowns theta.

    - `predict`: predictions (observations, variables), and a mask of the observations that have a stable orbit.
    - `residuals`, `jacobian`: residuals in standard errors, first of the observations and then of the prior, and their
      derivatives. Their other arguments are the parts of a `Target`.
    - `costs`: sums of squares at points of the unit box; `solve`: theta and sum of squares of a search from a point.
      Their other arguments are the bounds and the parts of a `Target`.
    """

    predict: Callable[..., Any]
    residuals: Callable[..., Any]
    jacobian: Callable[..., Any]
    costs: Callable[..., Any]
    solve: Callable[..., Any]


class Target(NamedTuple):
    """The observations with their inverse standard errors `weight`, 0 where they are left out, and the prior."""

    values: Float[np.ndarray, "observations of"]
    weight: Float[np.ndarray, "observations of"]
    mean: Theta
    width: Theta


def target_of(spec: CalibrationSpec, used: Bool[np.ndarray, " observations"]) -> Target:
    """Return the target of a fit to the `used` observations."""
    known = np.isfinite(spec.values) & used[:, None]
    weight = np.where(known, 1 / np.where(known, spec.scales, 1.0), 0.0)
    return Target(np.where(known, spec.values, 0.0), weight, spec.prior_mean, spec.prior_error)


def model_of(spec: CalibrationSpec) -> Model:
    """Return the model of a calibration, which is kept for others of the same drill and operating conditions."""
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
    places = [k for k, name in enumerate(spec.names) if name != CONSTANT]
    of = [*spec.observed]
    needed = [name for name in of if name != RATE or CONSTANT not in spec.names]
    needed += [RELIEF] if CONSTANT in spec.names and RELIEF not in needed else []
    by = [*(spec.names[k] for k in places), *spec.conditions]
    f = as_jax(spec.scene, of=needed, by=by, start=spec.start, **spec.fixed)
    rows = len(spec.labels)
    conditions = jnp.asarray(np.stack([*spec.conditions.values()], axis=1) if spec.conditions else np.zeros((rows, 0)))

    def predict(theta: Any) -> tuple[Any, Any]:
        free = jnp.broadcast_to(theta[jnp.array(places, int)], (rows, len(places)))
        values = dict(jax.vmap(f)(jnp.concatenate([free, conditions], axis=1)))
        if CONSTANT in spec.names:
            values[RATE] = theta[spec.names.index(CONSTANT)] * jnp.log(values[RELIEF])
        return jnp.stack([values[name] for name in of], axis=1), values[VALID]

    def residuals(theta: Any, values: Any, weight: Any, mean: Any, width: Any) -> Any:
        # An orbit without the variable has NaN, which a weight of 0 does not remove.
        predicted = jnp.where(weight > 0, predict(theta)[0], 0.0)
        return jnp.concatenate([(weight * (predicted - values)).ravel(), (theta - mean) / width])

    def solve(point: Any, low: Any, high: Any, *target: Any) -> Any:
        def inside(free: Any) -> Any:  # stays inside the bounds
            return low + (high - low) * jax.nn.sigmoid(free)

        solver: Any = optimistix.LevenbergMarquardt(TOLERANCE, TOLERANCE)
        solution: Any = optimistix.least_squares(
            lambda free, _: residuals(inside(free), *target), solver, jnp.log(point / (1 - point)),
            max_steps=MAX_STEPS, throw=False,
        )  # fmt: skip
        theta = inside(solution.value)
        return theta, jnp.sum(residuals(theta, *target) ** 2)

    def costs(points: Any, low: Any, high: Any, *target: Any) -> Any:
        return jax.vmap(lambda point: jnp.sum(residuals(low + (high - low) * point, *target) ** 2))(points)

    return Model(*(jax.jit(function) for function in (predict, residuals, jax.jacfwd(residuals), costs, solve)))


def search(spec: CalibrationSpec, model: Model, target: Target, bar: Progress | None) -> tuple[Theta, float]:
    """Return the unknowns with the least sum of squares, and this sum, of searches from the best points of a sample."""
    arguments = [jnp.asarray(x) for x in (spec.low, spec.high, *target)]
    points = qmc.Sobol(len(spec.names), seed=spec.seed).random(SCREENED)
    points = np.clip(np.concatenate([np.full((1, len(spec.names)), 0.5), points[1:]]), 0.02, 0.98)
    costs = np.asarray(model.costs(jnp.asarray(points), *arguments))
    best, least = (spec.low + spec.high) / 2, np.inf
    for point in points[np.argsort(np.where(np.isfinite(costs), costs, np.inf), kind="stable")][: spec.searches]:
        theta, cost = map(np.asarray, model.solve(jnp.asarray(point), *arguments))
        if cost < least:
            best, least = theta, float(cost)
        if bar is not None:
            bar.add(1)
    return best, least

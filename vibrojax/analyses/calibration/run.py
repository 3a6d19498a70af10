"""Calibration of a drill's parameters: the function `calibrate`, and its dataset."""

from collections.abc import Mapping
from os import PathLike
from typing import Any

import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Bool, Float

from vibrojax.analyses.calibration.model import TOLERANCE, Model, Theta, model_of, search, target_of
from vibrojax.analyses.calibration.spec import CONSTANT, CalibrationSpec, read_calibration
from vibrojax.analyses.calibration.uncertainty import nonlinearity, posterior_draws, uncertainty_of
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

AT_BOUND = 1e-2
"""Distance from a bound, relative to the interval, within which an estimate whose next step leads beyond the bound is
at the bound: a search approaches it slowly."""

LARGEST_OFFSET = 0.05
"""Length of the residuals along the tangent plane, in standard errors, up to which a search has reached a minimum
(Bates and Watts 1981)."""

MAX_ROUNDS = 3
"""Number of fits, each without the observations for which the fit before found no orbit."""

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


def calibrate(source: str | PathLike[str] | Mapping[str, object], progress: bool = True) -> xr.Dataset:
    """Estimate parameters of a drill from observations of its periodic motion, by gradients through the orbits.

        runs = {"v": [1.2, 1.5, 1.8], "period": [...], "impact_velocity": [...]}
        fit = vj.calibrate({"scene": "vibro-impact", "start": "stuck", "data": runs, "unknown": {"mu": [0.2, 0.6]}})

    Each observation is one row of a table: operating conditions, which are parameters of the scene, and observed values
    of variables of the orbit (period, forces, velocities, powers, rates). The residuals are differentiated by
    [vibrojax.as_jax][] and minimised by optimistix's Levenberg-Marquardt method inside the bounds, from several points.
    The motion from `start` settles on an orbit at the first row, which is continued to the other rows. Attractors
    coexist: observations of another motion are fitted by the wrong orbit, and their residuals show it. To fit
    friction to the velocity of the bit over time, use [vibrojax.fit_friction][].

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


def find_calibration(spec: CalibrationSpec, progress: bool = True) -> xr.Dataset:
    """Return the dataset of a checked calibration."""
    with precision("float64"), Progress(spec.searches, "searches", progress) as bar:
        model = model_of(spec)
        theta = (spec.low + spec.high) / 2
        valid = np.asarray(model.predict(jnp.asarray(theta))[1])
        if not valid.any():
            where = ", ".join(f"{name} = {x:g}" for name, x in zip(spec.names, theta, strict=True))
            raise InputError(
                f"{spec.file}: no observation has a stable orbit from the start at the centre of the bounds, {where}; "
                "choose other bounds, or another start"
            )
        used = np.ones(len(valid), bool)
        for number in range(MAX_ROUNDS):
            theta, cost = search(spec, model, target_of(spec, used), bar if number == 0 else None)
            predicted, valid = map(np.asarray, model.predict(jnp.asarray(theta)))
            if (valid | ~used).all() or not (valid & used).any():
                break
            used &= valid
        return _dataset(spec, model, theta, cost, predicted, used & valid)


def _dataset(
    spec: CalibrationSpec,
    model: Model,
    theta: Theta,
    cost: float,
    predicted: Float[np.ndarray, "observations of"],
    used: Bool[np.ndarray, " observations"],
) -> xr.Dataset:
    target = target_of(spec, used)
    residuals, jacobian = (np.asarray(f(jnp.asarray(theta), *target)) for f in (model.residuals, model.jacobian))
    freedom = int((target.weight > 0).sum()) + int(np.isfinite(spec.prior_error).sum()) - len(theta)
    variance = 1.0 if spec.errors is not None else cost / freedom if freedom > 0 else np.nan
    noise = np.nan if spec.errors is not None else float(np.sqrt(variance))
    known = uncertainty_of(spec, theta, jacobian, variance if np.isfinite(variance) else 1.0)
    width = np.sqrt(np.diag(known.covariance))
    stderr = known.scale * width
    step = -np.linalg.lstsq(jacobian, residuals)[0]
    margin = AT_BOUND * (spec.high - spec.low)
    beyond = ((theta < spec.low + margin) & (theta + step < spec.low)) | (
        (theta > spec.high - margin) & (theta + step > spec.high)
    )
    free = jacobian * ~beyond
    offset = np.linalg.norm(free @ np.linalg.lstsq(free, residuals)[0])
    converged = offset <= LARGEST_OFFSET * np.sqrt(variance * len(theta)) + TOLERANCE
    determined = "identified" if converged else "not-converged"
    reason = np.where(width < VAGUE, REASONS.index(determined), REASONS.index("confounded"))
    reason = np.where(beyond, REASONS.index("at-bound"), reason)
    if freedom < 0 or (freedom == 0 and spec.errors is None):
        reason[:], stderr = REASONS.index("too-few-observations"), np.full_like(stderr, np.nan)
    draws = posterior_draws(spec, theta, known, freedom)
    error = spec.scales if spec.errors is not None else noise * spec.scales
    table: dict[str, Any] = {
        "estimate": theta,
        "estimate_stderr": stderr,
        "low": spec.low,
        "high": spec.high,
        "reason": reason,
        "correlation": known.covariance / width / width[:, None],
        "direction": known.directions,
        "direction_error": known.errors,
        "posterior": draws,
        "observed": spec.values,
        "predicted": predicted,
        "residual": np.where(target.weight > 0, (predicted - spec.values) / error, np.nan),
        "used": np.where(used, USES.index("used"), USES.index("no-orbit")),
        "chi_squared": cost / variance if freedom > 0 else cost,
        "freedom": freedom,
        "noise": noise,
        "nonlinearity": np.nan if reason.any() else nonlinearity(model, target, theta, jacobian, draws),
    }
    parameters = spec.point.system.parameters()
    about = {name: (parameters[name].unit, parameters[name].long_name) for name in spec.names if name != CONSTANT}
    about |= {CONSTANT: ("m s-1", "coefficient of the law, rate = C ln(P/D)")}
    coordinates: dict[str, Any] = {
        "parameter": [*spec.names],
        "other": [*spec.names],
        "of": [*spec.observed],
        "observation": spec.labels,
        "parameter_unit": ("parameter", [about[name][0] for name in spec.names]),
        "parameter_long_name": ("parameter", [about[name][1] for name in spec.names]),
        "of_unit": ("of", [VARIABLES[name].units for name in spec.observed]),
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

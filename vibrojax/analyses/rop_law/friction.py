"""Friction from a measured velocity: mu and v_cr of eq. 5.9, by gradients through the smoothed motion."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Float
from scipy.optimize import least_squares

from vibrojax.analyses.rop_law.data import Data, open_data
from vibrojax.analyses.rop_law.least_squares import Reason, confounded_coefficients
from vibrojax.analyses.rop_law.results import attributes, reason_variable, to_variables
from vibrojax.compile import jitted
from vibrojax.compile.devices import precision
from vibrojax.errors import Place, shown, suggestion
from vibrojax.io.attributes import parameters_of, title_of
from vibrojax.io.variables import Variable
from vibrojax.models.arrays import Array
from vibrojax.models.scenes.rotary import Rotary
from vibrojax.stepping.smoothed import smoothed_trajectory

DEFAULT_WINDOW = 0.5
"""Length [s] of the window that is fitted by default: some two returns of the default drill."""

DEFAULT_SMOOTHING = 0.002
"""Width [m/s] of the friction switch: its effect on mu and v_cr is below 1 %."""

_MAX_STEPS = 200_000  # of a window, whose states and derivatives are in memory together
_TOLERANCE = 1e-12  # relative; the end of the search is then determined by rounding
_MAX_EVALUATIONS = 200
_VAGUE = 0.5  # relative standard error from which a coefficient above zero cannot be distinguished from zero
_UNEVEN = 1e-6  # of the interval between samples
_OFFSET = 0.05  # largest relative offset (Bates and Watts 1981) of a minimum; the motion's kinks keep it from zero
_SCALES = np.array([1.0, 1.0, 0.01, 1.0, 0.01, 1.0])  # positions are small beside velocities

_SCENE = Rotary()
_SCHEMA = {
    "mu": Variable("1", "friction coefficient"),
    "mu_stderr": Variable("1", "standard error of mu"),
    "mu_change": Variable("1", "change of mu when step and smoothing are halved"),
    "v_cr": Variable("m s-1", "Stribeck speed"),
    "v_cr_stderr": Variable("m s-1", "standard error of v_cr"),
    "v_cr_change": Variable("m s-1", "change of v_cr when step and smoothing are halved"),
    "rms": Variable("m s-1", "root mean square of what is left of the velocity"),
    "used": Variable("1", "samples that the fit used", np.int32),
    "left_out": Variable("1", "samples of the window without a value", np.int32),
    "reason": reason_variable("why the coefficients are not numbers"),
    "state": Variable("1", "state of the drill at the beginning of the window, in m and m s-1"),
    "fitted": Variable("m s-1", "velocity of the bit relative to the drive, as fitted"),
}

Samples = Float[np.ndarray, " samples"]
Unknowns = Float[Array, " unknowns"]
"""ln mu, ln v_cr, and the state at the window's beginning if it is not known."""


class _Fit(NamedTuple):
    """The end of a search: the unknowns, the velocity's Jacobian by them over `_SCALES`, and the velocity [m/s]."""

    unknowns: Float[np.ndarray, " unknowns"]
    jacobian: Float[np.ndarray, "samples unknowns"]
    velocity: Samples


def fit_friction(
    data: Data,
    window: tuple[float, float] | None = None,
    start: str | Sequence[float] | None = None,
    smoothing: float = DEFAULT_SMOOTHING,
    **parameters: float,
) -> xr.Dataset:
    """Fit mu and v_cr of eq. 5.9 to the velocity of the bit, measured over a window without impacts.

    The fit is least squares of the velocity, with derivatives through the smoothed motion of the rotary scene. The
    unknowns are ln mu and ln v_cr, which keeps mu and v_cr above zero. The state at the window's beginning is unknown
    too unless `start` gives it; an offset of the friction then hides in that of the springs, and mu is less well known.

    Without impact no event's time is lost in a fixed step. Over a few returns the derivatives therefore equal the sharp
    motion's (see the tests); over many, every change between stick and slip adds its kink. The fit is repeated at half
    the step and half the smoothing, and the second fit is returned. `mu_change` and `v_cr_change` are the effect of
    halving; the remaining effect of the smoothing is of that order.

    **Arguments:**

    - `data`: a dataset with `v1` [m/s], the bit's velocity relative to the drive, along `time` [s], evenly spaced, or
      the path of one; NaN is a sample without a value.
    - `window` (begin, end) [s]: by default the first 0.5 s.
    - `start`: the state at the window's beginning: "drive", "stuck" (a drill at rest whose drive is switched on), or
      x1, x1', x2, x2' [m, m/s]. By default the search for it begins at the values in `data`, or at zeros without them.
    - `smoothing` [m/s]: width of the friction switch; the step follows from it.
    - `parameters`: of the rotary scene, by default the fixed parameters of `data`, else the scene's defaults. The
      search begins at `mu` and `v_cr`, by default the scene's.

    **Returns:** a dataset: mu, v_cr [m/s], each with standard error (from the Jacobian, for independent noise of one
    size) and change; rms [m/s], used, left_out; the `state` at the beginning; `fitted` along `time`. NaN with a
    `reason` if the window does not identify them: a bit that always sticks, a relative error of 1/2 and more.

    **Raises:** `InputError`.

    **Example:**

    >>> motion = vj.simulate("rotary", mu=0.3, start="stuck", duration=1.0, progress=False)
    >>> friction = vj.fit_friction(motion, window=(0.0, 0.4), start="stuck")
    >>> f"{float(friction.mu):.2f}"
    '0.30'
    """
    place, data = open_data(data, "fit_friction")
    time, velocity = _window(place, data, window)
    if not (np.isfinite(smoothing) and smoothing > 0):
        raise place.at("smoothing").error(f"is {smoothing}; it must be above 0")
    p = _parameters(place, data, parameters)
    state = _state(place, data.sel(time=time[0]), start, velocity[0], p)
    interval = (time[-1] - time[0]) / (len(time) - 1)
    substeps = max(1, int(np.ceil(interval * p["g"] / smoothing)))
    steps = 2 * substeps * len(time)
    if steps > _MAX_STEPS:
        raise place.at("smoothing").error(
            f"{smoothing:g} m/s over this window takes {steps} steps; {_MAX_STEPS} are the most: shorten the window"
        )
    unknowns = np.array([np.log(p["mu"]), np.log(p["v_cr"]), *(state if start is None else [])])
    seen = np.isfinite(velocity)
    freedom = int(seen.sum()) - unknowns.size
    values: dict[str, object] = {name: np.nan for name in _SCHEMA}
    values |= {"used": seen.sum(), "left_out": (~seen).sum(), "reason": Reason.TOO_FEW_LANES}
    values |= {"state": np.full(len(state), np.nan), "fitted": np.full(len(time), np.nan)}
    if freedom > 0:
        first = _fit(unknowns, p, state, velocity, interval, substeps, smoothing)
        fit = _fit(first.unknowns, p, state, velocity, interval, 2 * substeps, smoothing / 2)
        residual = (fit.velocity - velocity)[seen]
        relative, values["reason"] = _relative_errors(fit, residual, seen, freedom)
        if values["reason"] == Reason.IDENTIFIED:
            values |= {"rms": np.sqrt(np.mean(residual**2)), "fitted": fit.velocity}
            values["state"] = np.asarray(state if start is not None else fit.unknowns[2:])
            for index, name in enumerate(("mu", "v_cr")):
                value = np.exp(fit.unknowns[index])
                values |= {name: value, f"{name}_stderr": value * relative[index]}
                values[f"{name}_change"] = value - np.exp(first.unknowns[index])
    variables = to_variables(_SCHEMA, values, {"state": ("quantity",), "fitted": ("time",)})
    coordinates = {
        "time": ("time", time, {"units": "s", "long_name": "time"}),
        "quantity": ("quantity", list(_SCENE.state_names), {"units": "1", "long_name": "state"}),
    }
    title = f"friction, eq. 5.9, fitted: {title_of(data, place.file)}"
    return xr.Dataset(variables, coordinates, attributes(place, data, "fit of the friction", title, {}))


def _fit(
    unknowns: Float[np.ndarray, " unknowns"],
    p: Mapping[str, float],
    state: Sequence[float],
    velocity: Samples,
    interval: float,
    substeps: int,
    width: float,
) -> _Fit:
    """Return the end of a search that begins at `unknowns`."""
    seen, scales = np.isfinite(velocity), _SCALES[: unknowns.size]
    with precision("float64"):
        fixed = {name: jnp.asarray(value) for name, value in p.items()} | {"state": jnp.asarray(state)}

        def evaluate(scaled: Float[np.ndarray, " unknowns"]) -> tuple[Samples, Float[np.ndarray, "samples unknowns"]]:
            motion = _velocity_and_jacobian(jnp.asarray(scaled * scales), fixed, interval, substeps, len(seen), width)
            return np.asarray(motion[0]), np.asarray(motion[1]) * scales

        def residual(scaled: Float[np.ndarray, " unknowns"]) -> Samples:
            return (evaluate(scaled)[0] - velocity)[seen]

        scaled = unknowns / scales
        if np.isfinite(residual(scaled)).all():
            tolerances = dict.fromkeys(("ftol", "xtol", "gtol"), _TOLERANCE)
            scaled = least_squares(
                residual, scaled, lambda scaled: evaluate(scaled)[1][seen], max_nfev=_MAX_EVALUATIONS, **tolerances
            ).x
        motion, slopes = evaluate(scaled)
    return _Fit(scaled * scales, slopes, motion)


@jitted(static=("substeps", "samples"))
def _velocity_and_jacobian(
    unknowns: Unknowns,
    fixed: Mapping[str, Array],
    interval: float | Float[Array, ""],
    substeps: int,
    samples: int,
    width: float | Float[Array, ""],
) -> tuple[Float[Array, " samples"], Float[Array, "samples unknowns"]]:
    """Return the velocity [m/s] and its Jacobian by the unknowns."""

    def motion(unknowns: Unknowns) -> tuple[Float[Array, " samples"], Float[Array, " samples"]]:
        velocity = _velocity(unknowns, fixed, interval, substeps, samples, width)
        return velocity, velocity

    jacobian, velocity = jax.jacfwd(motion, has_aux=True)(unknowns)
    return velocity, jacobian


def _velocity(
    unknowns: Unknowns,
    fixed: Mapping[str, Array],
    interval: float | Float[Array, ""],
    substeps: int,
    samples: int,
    width: float | Float[Array, ""],
) -> Float[Array, " samples"]:
    """Return x1' [m/s] at the samples of the smoothed rotary motion."""
    p = _SCENE.constants({**fixed, "mu": jnp.exp(unknowns[0]), "v_cr": jnp.exp(unknowns[1])})
    state = tuple(unknowns[2:] if unknowns.size > 2 else fixed["state"])
    states = smoothed_trajectory(_SCENE, p, state, interval / substeps, substeps * (samples - 1), width)
    return jnp.concatenate([state[1][None], states[1][substeps - 1 :: substeps]])


def _relative_errors(
    fit: _Fit, residual: Samples, seen: np.ndarray, freedom: int
) -> tuple[Float[np.ndarray, " unknowns"], Reason]:
    """Return the standard errors of the unknowns and IDENTIFIED, or the reason if they are not reliable."""
    errors, jacobian = np.full(fit.unknowns.size, np.nan), fit.jacobian[seen]
    if not (np.isfinite(jacobian).all() and np.isfinite(fit.velocity).all()):
        return errors, Reason.NOT_CONVERGED
    if confounded_coefficients(jacobian).any():
        return errors, Reason.CONFOUNDED
    basis = np.linalg.qr(jacobian)[0]
    along = basis @ (basis.T @ residual)
    across = np.linalg.norm(residual - along) / np.sqrt(freedom)
    if np.linalg.norm(along) / np.sqrt(errors.size) > _OFFSET * across + np.finfo(float).eps:
        return errors, Reason.NOT_CONVERGED
    errors = np.sqrt(np.sum(residual**2) / freedom) * np.linalg.norm(np.linalg.pinv(jacobian), axis=1)
    return errors, Reason.IDENTIFIED if (errors[:2] < _VAGUE).all() else Reason.CONFOUNDED


def _window(place: Place, data: xr.Dataset, window: tuple[float, float] | None) -> tuple[Samples, Samples]:
    """Return time [s], evenly spaced, and velocity [m/s] of the bit in the window."""
    if "v1" not in data or data["v1"].dims != ("time",) or "time" not in data.coords:
        raise place.at("v1").error("missing along time; the bit's velocity relative to the drive [m/s] is needed")
    times = data["time"].values.astype(float)
    begin, end = (times[0], times[0] + DEFAULT_WINDOW) if window is None and len(times) else (window or (0.0, 0.0))
    inside = (times >= begin - _UNEVEN) & (times <= end + _UNEVEN)
    if inside.sum() < 2:
        raise place.at("window").error(f"{begin:g} to {end:g} s holds {inside.sum()} samples; two or more are needed")
    steps = np.diff(times[inside])
    if not (np.ptp(steps) <= _UNEVEN * steps.mean() * len(steps) and steps.mean() > 0):
        raise place.at("time").error("is not evenly spaced; resample the velocity")
    if "impact_force" in data and (data["impact_force"].values[inside] > 0).any():
        raise place.at("window").error("holds impacts; choose one between them, the smoothed gradient needs that")
    return times[inside], data["v1"].values[inside].astype(float)


def _parameters(place: Place, data: xr.Dataset, values: Mapping[str, float]) -> dict[str, float]:
    """Return the rotary scene's parameters; mu and v_cr, at which the search begins, never come from the data."""
    table = _SCENE.parameters()
    p = {name: parameter.default for name, parameter in table.items()}
    p |= {name: x for name, x in parameters_of(data).items() if name in table and name not in ("mu", "v_cr")}
    for name, value in values.items():
        if name not in table:
            raise place.at(name).error(f"is not a parameter of the rotary scene; {suggestion(name, table)}")
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise place.at(name).error(f"{shown(value)} is not a number")
        if fault := table[name].problem(value) or ("is 0; it must be above 0" if name == "mu" and value == 0 else None):
            raise place.at(name).error(fault)
        p[name] = float(value)
    return p


def _state(
    place: Place, data: xr.Dataset, start: str | Sequence[float] | None, v1: float, p: Mapping[str, float]
) -> list[float]:
    """Return the state at the window's beginning: known, or where the search for it begins."""
    if isinstance(start, str):
        if start not in _SCENE.starts:
            raise place.at("start").error(f"{shown(start)} is unknown; {suggestion(start, _SCENE.starts)}")
        return [0.0, -p["v"] if start == "stuck" else 0.0, 0.0, 0.0]
    if start is not None:
        values = np.asarray(start, dtype=float)
        if values.shape != (4,) or not np.isfinite(values).all():
            raise place.at("start").error(f"{shown(start)} is not x1, x1', x2, x2' [m, m/s]")
        return values.tolist()
    state = [float(data[name]) if name in data else 0.0 for name in _SCENE.state_names]
    state[1] = float(v1)
    return [value if np.isfinite(value) else 0.0 for value in state]

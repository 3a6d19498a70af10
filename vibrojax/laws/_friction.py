"""Friction from a measured velocity: mu and v_cr of eq. 5.9, by gradients through the smoothed motion."""

import json
from collections.abc import Mapping
from functools import partial
from os import PathLike

import jax
import jax.numpy as jnp
import numpy as np
import optimistix
import xarray as xr
from jax import Array

from vibrojax.devices import precision
from vibrojax.errors import Place, shown, suggestion
from vibrojax.laws._about import described, provenance
from vibrojax.laws._group import CONFOUNDED, IDENTIFIED, NOT_CONVERGED, TOO_FEW_LANES
from vibrojax.laws._lanes import opened
from vibrojax.laws._normal import inverse
from vibrojax.scenes.rotary import Rotary
from vibrojax.stepping.smoothed import smoothed_trajectory

WINDOW = 0.5
"""Length [s] of the window that is fitted by default: some two returns of the default drill."""

SMOOTHING = 0.002
"""Width [m/s] of the friction switch."""

MOST_STEPS = 200_000

_SCENE = Rotary()
_SOUGHT = ("mu", "v_cr")
_TOLERANCE = 1e-6
_MOST_ITERATIONS = 60
_OFFSET = 0.05
_UNTOLD = 0.5  # relative standard error from which a coefficient above zero is not told from zero
_UNEVEN = 1e-6  # of the interval between samples

_ABOUT = {
    "mu": ("1", "friction coefficient"),
    "mu_stderr": ("1", "standard error of mu"),
    "mu_change": ("1", "change of mu when step and smoothing are halved"),
    "v_cr": ("m s-1", "Stribeck speed"),
    "v_cr_stderr": ("m s-1", "standard error of v_cr"),
    "v_cr_change": ("m s-1", "change of v_cr when step and smoothing are halved"),
    "rms": ("m s-1", "root mean square of what is left of the velocity"),
    "used": ("1", "samples that the fit used"),
    "left_out": ("1", "samples of the window without a value"),
    "reason": ("1", "why the coefficients are not numbers"),
    "state": ("1", "state of the drill at the beginning of the window, in m and m s-1"),
    "fitted": ("m s-1", "velocity of the bit relative to the drive, as fitted"),
}


def fit_friction(
    data: xr.Dataset | str | PathLike,
    window: tuple[float, float] | None = None,
    start: str | tuple[float, float, float, float] | None = None,
    smoothing: float = SMOOTHING,
    **parameters: float,
) -> xr.Dataset:
    """mu and v_cr of eq. 5.9 from the velocity of the bit, measured over a window without impacts.

    Least squares of the velocity by Levenberg–Marquardt, with derivatives through the smoothed motion of the rotary
    scene. What is sought is ln mu and ln v_cr, which keeps them above zero, and the state at the window's beginning
    where it is not known; but then an offset of the friction hides in that of the springs, and mu is told less well.
    Without impact there is no event whose time a fixed step would lose, so that over a few returns these derivatives
    are those of the sharp motion (see the tests); over many, every change between stick and slip adds its kink. The
    fit is repeated at half the step and half the smoothing, and that is the one returned; `mu_change` and `v_cr_change`
    say what halving changed; what the smoothing still does is of that order.

    **Arguments:**

    - `data`: a dataset with `v1` [m/s], the bit's velocity relative to the drive, along `time` [s], evenly spaced, or
      the path of one; NaN is a sample without a value.
    - `window` (begin, end) [s]: by default the first `WINDOW`.
    - `start`: the state at the window's beginning, "drive", "stuck" (a drill at rest whose drive is switched on), or
      x1, x1', x2, x2' [m, m/s]; by default it is not known, and sought from what `data` has of it, else from zeros.
    - `smoothing` [m/s]: width of the friction switch; the step follows from it.
    - `parameters`: those of the rotary scene, by default those fixed in `data`, else its own; `mu` and `v_cr` are where
      the search begins, by default the scene's.

    **Returns:** a dataset: mu, v_cr [m/s], each with standard error (from the Jacobian, for independent noise of one
    size) and change; rms [m/s], used, left_out; the `state` at the beginning; `fitted` along `time`. NaN with a
    `reason` where the window cannot tell them: a bit that sticks all the time, a relative error of 1/2 and more.

    **Raises:** `InputError`.
    """
    place, data = opened(data, "fit_friction")
    time, velocity = _history(place, data, window)
    if not (np.isfinite(smoothing) and smoothing > 0):
        raise place.at("smoothing").error(f"is {smoothing}; it must be above 0")
    p = _parameters(place, data, parameters)
    state = _start(place, data, start, time[0], velocity, p)
    interval = (time[-1] - time[0]) / (len(time) - 1)
    substeps = max(1, int(np.ceil(interval * p["g"] / smoothing)))
    if 2 * substeps * len(time) > MOST_STEPS:
        raise place.at("smoothing").error(
            f"{smoothing:g} m/s over this window takes {2 * substeps * len(time)} steps; "
            f"{MOST_STEPS} are the most: shorten the window"
        )
    sought = np.array([np.log(p["mu"]), np.log(p["v_cr"]), *(state if start is None else [])])
    with precision("float64"):
        fixed = {name: jnp.asarray(value) for name, value in p.items()} | {"state": jnp.asarray(state)}
        first, _, _ = _fitted(jnp.asarray(sought), fixed, velocity, interval, substeps, smoothing)
        found, jacobian, predicted = (
            np.asarray(x) for x in _fitted(first, fixed, velocity, interval, 2 * substeps, smoothing / 2)
        )
    return _result(place, data, time, velocity, state, (np.asarray(first), found, jacobian, predicted))


@partial(jax.jit, static_argnames="substeps")
def _fitted(
    theta: Array, fixed: Mapping, velocity: Array, interval, substeps: int, width
) -> tuple[Array, Array, Array]:
    """Where the search from `theta` (ln mu, ln v_cr, state) ends, and there the Jacobian and the velocity.

    The Jacobian's columns are in units of their own.
    """
    seen = jnp.isfinite(velocity)
    target = jnp.where(seen, velocity, 0.0)
    # Positions are small beside velocities: each is sought in units of its own.
    unit = jnp.array([1.0, 1.0, 0.01, 1.0, 0.01, 1.0])[: theta.size]

    def residual(scaled, _=None):
        return jnp.where(seen, _velocity(scaled * unit, fixed, interval, substeps, len(velocity), width) - target, 0.0)

    solver = optimistix.LevenbergMarquardt(rtol=_TOLERANCE, atol=_TOLERANCE)
    solved = optimistix.least_squares(residual, solver, theta / unit, max_steps=_MOST_ITERATIONS, throw=False)
    return solved.value * unit, jax.jacfwd(residual)(solved.value), residual(solved.value) + target


def _velocity(theta: Array, fixed: Mapping, interval, substeps: int, samples: int, width) -> Array:
    """x1' [m/s] at the samples, (samples,), of the smoothed rotary motion."""
    p = _SCENE.constants({**fixed, "mu": jnp.exp(theta[0]), "v_cr": jnp.exp(theta[1])})
    state = tuple(theta[2:] if theta.size > len(_SOUGHT) else fixed["state"])
    states = smoothed_trajectory(_SCENE, p, state, interval / substeps, substeps * (samples - 1), width)
    return jnp.concatenate([state[1][None], states[1][substeps - 1 :: substeps]])


def _history(place: Place, data: xr.Dataset, window: tuple[float, float] | None) -> tuple[np.ndarray, np.ndarray]:
    """Times [s] and velocities [m/s] of the window."""
    if "v1" not in data or data["v1"].dims != ("time",) or "time" not in data.coords:
        raise place.at("v1").error("missing along time; the bit's velocity relative to the drive [m/s] is needed")
    times = data["time"].values.astype(float)
    begin, end = (times[0], times[0] + WINDOW) if window is None and len(times) else (window or (0.0, 0.0))
    inside = (times >= begin - _UNEVEN) & (times <= end + _UNEVEN)
    if inside.sum() < 2:
        raise place.at("window").error(f"{begin:g} to {end:g} s holds {inside.sum()} samples; two or more are needed")
    time, velocity = times[inside], data["v1"].values[inside].astype(float)
    steps = np.diff(time)
    if not (np.ptp(steps) <= _UNEVEN * steps.mean() * len(steps) and steps.mean() > 0):
        raise place.at("time").error("is not evenly spaced; resample the velocity")
    if "impact_force" in data and (data["impact_force"].values[inside] > 0).any():
        raise place.at("window").error("holds impacts; choose one between them, the smoothed gradient needs that")
    return time, velocity


def _parameters(place: Place, data: xr.Dataset, given: Mapping[str, float]) -> dict[str, float]:
    """The rotary scene's parameters; where the search begins is never taken from the data."""
    table = _SCENE.parameters()
    held = json.loads(data.attrs.get("parameters", "{}"))
    p = {name: one.default for name, one in table.items()}
    p |= {name: value for name, value in held.items() if name in table and name not in _SOUGHT}
    for name, value in given.items():
        if name not in table:
            raise place.at(name).error(f"is no parameter of the rotary scene; {suggestion(name, table)}")
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise place.at(name).error(f"{shown(value)} is not a number")
        if fault := table[name].problem(value) or ("is 0; it must be above 0" if name == "mu" and value == 0 else None):
            raise place.at(name).error(fault)
    return p | {name: float(value) for name, value in given.items()}


def _start(place: Place, data: xr.Dataset, start, begin: float, velocity: np.ndarray, p: Mapping) -> list[float]:
    """The state at the window's beginning: known, or where the search for it begins."""
    if isinstance(start, str):
        if start not in _SCENE.starts:
            raise place.at("start").error(f"{shown(start)} is unknown; {suggestion(start, _SCENE.starts)}")
        return [0.0, -p["v"] if start == "stuck" else 0.0, 0.0, 0.0]
    if start is not None:
        values = np.asarray(start, dtype=float)
        if values.shape != (4,) or not np.isfinite(values).all():
            raise place.at("start").error(f"{shown(start)} is not x1, x1', x2, x2' [m, m/s]")
        return values.tolist()
    at = data.sel(time=begin)
    held = [float(at[name]) if name in data else 0.0 for name in _SCENE.states]
    held[1] = velocity[0]
    return [value if np.isfinite(value) else 0.0 for value in held]


def _result(place: Place, data: xr.Dataset, time: np.ndarray, velocity: np.ndarray, state: list, fit: tuple):
    first, theta, jacobian, predicted = fit
    seen = np.isfinite(velocity)
    left = np.where(seen, predicted - velocity, 0.0)
    freedom = int(seen.sum()) - theta.size
    relative, reason = _relative_errors(jacobian, predicted, left, seen, freedom)
    if reason == IDENTIFIED:
        values, changes = np.exp(theta[:2]), np.exp(theta[:2]) - np.exp(first[:2])
        rms = np.sqrt((left**2).sum() / seen.sum())
    else:
        relative, values, changes, rms = np.full(2, np.nan), np.full(2, np.nan), np.full(2, np.nan), np.nan
        state, theta, predicted = (np.full_like(x, np.nan) for x in (np.asarray(state), theta, predicted))
    about = described(_ABOUT)
    found = {"rms": rms, "used": np.int32(seen.sum()), "left_out": np.int32((~seen).sum()), "reason": np.int8(reason)}
    for index, name in enumerate(_SOUGHT):
        found |= {name: values[index], f"{name}_stderr": values[index] * relative[index]}
        found |= {f"{name}_change": changes[index]}
    variables = {name: ((), found[name], about[name]) for name in _ABOUT if name in found}
    variables["state"] = ("quantity", theta[2:] if theta.size > len(_SOUGHT) else state, about["state"])
    variables["fitted"] = ("time", predicted, about["fitted"])
    coordinates = {
        "time": ("time", time, {"units": "s", "long_name": "time"}),
        "quantity": ("quantity", list(_SCENE.states), {"units": "1", "long_name": "state"}),
    }
    title = f"friction, eq. 5.9, fitted: {data.attrs.get('title') or place.file}"
    return xr.Dataset(variables, coordinates, provenance(place, data, "fit of the friction", title, {}))


def _relative_errors(jacobian, predicted, left, seen, freedom: int) -> tuple[np.ndarray | None, int]:
    """Standard errors of ln mu and ln v_cr, and the reason where there are none to rely on."""
    if freedom < 1:
        return None, TOO_FEW_LANES
    if not (np.isfinite(jacobian).all() and np.isfinite(predicted).all()):
        return None, NOT_CONVERGED
    square, _ = inverse(jacobian[seen])
    if square is None:
        return None, CONFOUNDED
    if not _at_minimum(jacobian, left, freedom):
        return None, NOT_CONVERGED
    relative = np.sqrt((left**2).sum() / freedom * np.diag(square))[:2]
    return relative, IDENTIFIED if (relative < _UNTOLD).all() else CONFOUNDED


def _at_minimum(jacobian: np.ndarray, left: np.ndarray, freedom: int) -> bool:
    """Whether what is left has no part along the Jacobian to speak of (the relative offset of Bates and Watts 1981).

    The motion's own kinks keep a search from its last digits; what matters is that another step would be small beside
    the standard errors.
    """
    basis = np.linalg.qr(jacobian)[0]
    along = basis @ (basis.T @ left)
    across = np.linalg.norm(left - along) / np.sqrt(freedom)
    return np.linalg.norm(along) / np.sqrt(jacobian.shape[1]) <= _OFFSET * across + np.finfo(float).eps

"""Friction from a measured velocity: mu and v_cr of eq. 5.9, by gradients through the smoothed motion."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Bool, Float

from vibrojax.analyses.rop_law.data import Data, open_data
from vibrojax.analyses.rop_law.least_squares import Number, levenberg_marquardt
from vibrojax.analyses.rop_law.results import provenance, reason, with_attributes
from vibrojax.analyses.rop_law.uncertainty import (
    CONFOUNDED,
    IDENTIFIED,
    NOT_CONVERGED,
    TOO_FEW_LANES,
    at_minimum,
    normal_inverse,
)
from vibrojax.compile import jitted
from vibrojax.compile.devices import precision
from vibrojax.errors import Place, shown, suggestion
from vibrojax.io.attributes import parameters_of, title_of
from vibrojax.io.variables import Variable
from vibrojax.models.arrays import Array
from vibrojax.models.scenes.rotary import Rotary
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
_VAGUE = 0.5  # relative standard error from which a coefficient above zero cannot be distinguished from zero
_UNEVEN = 1e-6  # of the interval between samples

_VARIABLES = {
    "mu": Variable("1", "friction coefficient"),
    "mu_stderr": Variable("1", "standard error of mu"),
    "mu_change": Variable("1", "change of mu when step and smoothing are halved"),
    "v_cr": Variable("m s-1", "Stribeck speed"),
    "v_cr_stderr": Variable("m s-1", "standard error of v_cr"),
    "v_cr_change": Variable("m s-1", "change of v_cr when step and smoothing are halved"),
    "rms": Variable("m s-1", "root mean square of what is left of the velocity"),
    "used": Variable("1", "samples that the fit used", np.int32),
    "left_out": Variable("1", "samples of the window without a value", np.int32),
    "reason": reason("why the coefficients are not numbers"),
    "state": Variable("1", "state of the drill at the beginning of the window, in m and m s-1"),
    "fitted": Variable("m s-1", "velocity of the bit relative to the drive, as fitted"),
}

Samples = Float[np.ndarray, " samples"]
Sought = Float[Array, " sought"]
"""ln mu, ln v_cr, and the state at the window's beginning where it is not known."""


@dataclass(frozen=True)
class _History:
    """The window that is fitted: `time` [s], evenly spaced, and `velocity` [m/s] of the bit, NaN without a value."""

    time: Samples
    velocity: Samples

    @property
    def interval(self) -> float:
        """Between samples [s]."""
        return (self.time[-1] - self.time[0]) / (len(self.time) - 1)

    @property
    def seen(self) -> Bool[np.ndarray, " samples"]:
        """The samples with a value."""
        return np.isfinite(self.velocity)


class _Fit(NamedTuple):
    """Where a search ends, the residual's Jacobian there (columns in units of their own), and the velocity [m/s]."""

    sought: Sought
    jacobian: Float[Array, "samples sought"]
    velocity: Float[Array, " samples"]


def fit_friction(
    data: Data,
    window: tuple[float, float] | None = None,
    start: str | Sequence[float] | None = None,
    smoothing: float = SMOOTHING,
    **parameters: float,
) -> xr.Dataset:
    """mu and v_cr of eq. 5.9 from the velocity of the bit, measured over a window without impacts.

    Least squares of the velocity by Levenberg–Marquardt, with derivatives through the smoothed motion of the rotary
    scene. What is sought is ln mu and ln v_cr, which keeps them above zero, and the state at the window's beginning
    where it is not known; but then an offset of the friction hides in that of the springs, and mu is less well known.
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
    `reason` where the window does not identify them: a bit that always sticks, a relative error of 1/2 and more.

    **Raises:** `InputError`.

    **Example:**

    >>> motion = vj.simulate("rotary", mu=0.3, start="stuck", duration=1.0, progress=False)
    >>> found = vj.fit_friction(motion, window=(0.0, 0.4), start="stuck")
    >>> f"{float(found.mu):.2f}"
    '0.30'
    """
    place, data = open_data(data, "fit_friction")
    history = _window(place, data, window)
    if not (np.isfinite(smoothing) and smoothing > 0):
        raise place.at("smoothing").error(f"is {smoothing}; it must be above 0")
    p = _parameters(place, data, parameters)
    state = _start(place, data, start, history, p)
    samples, interval = len(history.time), history.interval
    substeps = max(1, int(np.ceil(interval * p["g"] / smoothing)))
    if 2 * substeps * samples > MOST_STEPS:
        raise place.at("smoothing").error(
            f"{smoothing:g} m/s over this window takes {2 * substeps * samples} steps; "
            f"{MOST_STEPS} are the most: shorten the window"
        )
    sought = np.array([np.log(p["mu"]), np.log(p["v_cr"]), *(state if start is None else [])])
    with precision("float64"):
        fixed = {name: jnp.asarray(value) for name, value in p.items()} | {"state": jnp.asarray(state)}
        first = _fit(jnp.asarray(sought), fixed, history.velocity, interval, substeps, smoothing)
        second = _fit(first.sought, fixed, history.velocity, interval, 2 * substeps, smoothing / 2)
        fits = [_Fit(*(np.asarray(x) for x in fit)) for fit in (first, second)]
    return _result(place, data, history, state, *fits)


@jitted(static=("substeps",))
def _fit(
    sought: Sought,
    fixed: Mapping[str, Array],
    velocity: Float[Array, " samples"],
    interval: Number | float,
    substeps: int,
    width: Number | float,
) -> _Fit:
    """The fit from `sought` on."""
    seen = jnp.isfinite(velocity)
    target = jnp.where(seen, velocity, 0.0)
    # Positions are small beside velocities: each is sought in units of its own.
    unit = jnp.array([1.0, 1.0, 0.01, 1.0, 0.01, 1.0])[: sought.size]

    def residual(scaled: Sought, _: object = None) -> Float[Array, " samples"]:
        return jnp.where(seen, _velocity(scaled * unit, fixed, interval, substeps, len(velocity), width) - target, 0.0)

    scaled = levenberg_marquardt(residual, sought / unit, _TOLERANCE, _MOST_ITERATIONS)
    return _Fit(scaled * unit, jax.jacfwd(residual)(scaled), residual(scaled) + target)


def _velocity(
    sought: Sought,
    fixed: Mapping[str, Array],
    interval: Number | float,
    substeps: int,
    samples: int,
    width: Number | float,
) -> Float[Array, " samples"]:
    """x1' [m/s] at the samples of the smoothed rotary motion."""
    p = _SCENE.constants({**fixed, "mu": jnp.exp(sought[0]), "v_cr": jnp.exp(sought[1])})
    state = tuple(sought[2:] if sought.size > len(_SOUGHT) else fixed["state"])
    states = smoothed_trajectory(_SCENE, p, state, interval / substeps, substeps * (samples - 1), width)
    return jnp.concatenate([state[1][None], states[1][substeps - 1 :: substeps]])


def _window(place: Place, data: xr.Dataset, window: tuple[float, float] | None) -> _History:
    """The history in the window."""
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
    return _History(time, velocity)


def _parameters(place: Place, data: xr.Dataset, given: Mapping[str, float]) -> dict[str, float]:
    """The rotary scene's parameters; where the search begins is never taken from the data."""
    table = _SCENE.parameters()
    fixed = parameters_of(data)
    p = {name: one.default for name, one in table.items()}
    p |= {name: value for name, value in fixed.items() if name in table and name not in _SOUGHT}
    for name, value in given.items():
        if name not in table:
            raise place.at(name).error(f"is no parameter of the rotary scene; {suggestion(name, table)}")
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise place.at(name).error(f"{shown(value)} is not a number")
        if fault := table[name].problem(value) or ("is 0; it must be above 0" if name == "mu" and value == 0 else None):
            raise place.at(name).error(fault)
    return p | {name: float(value) for name, value in given.items()}


def _start(
    place: Place, data: xr.Dataset, start: str | Sequence[float] | None, history: _History, p: Mapping[str, float]
) -> list[float]:
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
    at = data.sel(time=history.time[0])
    state = [float(at[name]) if name in data else 0.0 for name in _SCENE.state_names]
    state[1] = float(history.velocity[0])
    return [value if np.isfinite(value) else 0.0 for value in state]


def _result(
    place: Place, data: xr.Dataset, history: _History, state: list[float], first: _Fit, fit: _Fit
) -> xr.Dataset:
    """The dataset of the second fit; the first, at twice the step and smoothing, says what halving changed."""
    left = np.where(history.seen, fit.velocity - history.velocity, 0.0)
    used = int(history.seen.sum())
    relative, why = _relative_errors(fit, left, history.seen)
    mu_v_cr = changes = np.full(2, np.nan)
    rms, state_there, velocity = np.nan, np.full(len(state), np.nan), np.full(len(left), np.nan)
    if why == IDENTIFIED:
        mu_v_cr = np.exp(fit.sought[:2])
        changes = mu_v_cr - np.exp(first.sought[:2])
        rms, velocity = np.sqrt((left**2).sum() / used), np.asarray(fit.velocity)
        state_there = np.asarray(fit.sought[2:] if fit.sought.size > len(_SOUGHT) else state)
    values: dict[str, object] = {
        "rms": rms,
        "used": used,
        "left_out": (~history.seen).sum(),
        "reason": why,
        "state": state_there,
        "fitted": velocity,
    }
    for index, name in enumerate(_SOUGHT):
        values |= {name: mu_v_cr[index], f"{name}_stderr": mu_v_cr[index] * relative[index]}
        values |= {f"{name}_change": changes[index]}
    variables = with_attributes(_VARIABLES, values, {"state": ("quantity",), "fitted": ("time",)})
    coordinates = {
        "time": ("time", history.time, {"units": "s", "long_name": "time"}),
        "quantity": ("quantity", list(_SCENE.state_names), {"units": "1", "long_name": "state"}),
    }
    title = f"friction, eq. 5.9, fitted: {title_of(data, place.file)}"
    return xr.Dataset(variables, coordinates, provenance(place, data, "fit of the friction", title, {}))


def _relative_errors(
    fit: _Fit, left: Samples, seen: Bool[np.ndarray, " samples"]
) -> tuple[Float[np.ndarray, " 2"], int]:
    """Standard errors of ln mu and ln v_cr, and the reason where there are none to rely on (then NaN)."""
    none, freedom = np.full(2, np.nan), int(seen.sum()) - fit.sought.size
    jacobian = np.asarray(fit.jacobian)
    if freedom < 1:
        return none, TOO_FEW_LANES
    if not (np.isfinite(jacobian).all() and np.isfinite(fit.velocity).all()):
        return none, NOT_CONVERGED
    square, _ = normal_inverse(jacobian[seen])
    if square is None:
        return none, CONFOUNDED
    if not at_minimum(jacobian, left, freedom):
        return none, NOT_CONVERGED
    relative = np.sqrt((left**2).sum() / freedom * np.diag(square))[:2]
    return relative, IDENTIFIED if (relative < _VAGUE).all() else CONFOUNDED

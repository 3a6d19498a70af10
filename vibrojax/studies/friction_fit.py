"""Identification of mu and v_cr (eq. 5.9 of the source) from a measured velocity, with gradients of smoothed motion."""

from collections.abc import Mapping, Sequence

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Bool, Float
from scipy.optimize import least_squares

from vibrojax.compile import jitted
from vibrojax.compile.xla import precision
from vibrojax.errors import Place, shown
from vibrojax.io.attributes import parameters_of
from vibrojax.io.variables import Variable
from vibrojax.physics.arrays import Array
from vibrojax.physics.meanings import suggest_parameter
from vibrojax.scenes.rotary import Rotary
from vibrojax.settings.values import choice, quantity
from vibrojax.stepping.smoothed import smoothed_trajectory
from vibrojax.studies.friction_recording import MIN_SAMPLES, Contacts, Recording, contact_free_parts, open_recording
from vibrojax.studies.rop_dataset import fit_dataset, reason_variable
from vibrojax.studies.rop_least_squares import Reason, confounded_coefficients

DEFAULT_WINDOW = 0.5
"""Default length [s] of the fitted window: about two returns to the section of the default drill."""

DEFAULT_SMOOTHING = 0.002
"""Default width [m/s] of the smoothed sign change of friction: its effect on mu and v_cr is below 1 %."""

_MAX_STEPS = 200_000  # per window: the states and derivatives of all its steps are in memory at once
_TOLERANCE = 1e-12  # relative; so tight that rounding error determines where the search stops
_MAX_EVALUATIONS = 200
_VAGUE = 0.5  # relative standard error from which on a positive coefficient cannot be distinguished from zero
_UNEVEN = 1e-6  # tolerance for the window's limits [s] and, relative, for the spacing of samples
_OFFSET = 0.05  # largest relative offset (Bates and Watts 1981) of a minimum; kinks of the motion keep it above zero
_SCALES = np.array([1.0, 1.0, 0.01, 1.0, 0.01, 1.0])  # of the unknowns; positions are smaller numbers than velocities

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
    "left_out": Variable("1", "samples of the window without a value, or during and around contacts", np.int32),
    "reason": reason_variable("why the coefficients are not numbers"),
    "state": Variable("1", "state of the drill at the beginning of each part, in m and m s-1"),
    "fitted": Variable("m s-1", "velocity of the bit relative to the drive, as fitted"),
}

Samples = Float[np.ndarray, " samples"]
Parts = Float[np.ndarray, "parts longest"]
"""Samples of each part of the window, followed by NaN where a part is shorter than the longest."""

Unknowns = Float[Array, " unknowns"]
"""ln mu, ln v_cr and the state at the beginning of a part of the window."""


def fit_friction(
    data: Recording,
    window: tuple[float, float] | None = None,
    start: str | Sequence[float] | None = None,
    smoothing: float = DEFAULT_SMOOTHING,
    contacts: Contacts = (),
    **parameters: float,
) -> xr.Dataset:
    """Fit mu and v_cr of eq. 5.9 of the source to the velocity of the bit, measured over a window.

    The fit minimises the squared residuals of the velocity, with derivatives of the smoothed motion of the rotary
    scene. The unknowns are ln mu and ln v_cr, which keeps mu and v_cr positive. Unless `start` specifies it, the state
    at the beginning of the window is unknown too. A constant part of the friction can then be compensated by an offset
    of the springs, which makes mu less certain.

    Derivatives through fixed steps miss how the times of impacts depend on the unknowns. Where the striker touches the
    bit, the window is therefore divided: the samples between contacts are fitted together, with one mu and v_cr and a
    state at the beginning of each part. Over a few returns to the section, the derivatives therefore equal those of the
    nonsmooth motion (see the tests). Over many returns, each transition between stick and slip adds the error of its
    kink. The fit is repeated with half the step and half the smoothing, and the second fit is returned. `mu_change` and
    `v_cr_change` are the differences between both fits. They indicate the size of the remaining effect of the
    smoothing.

    **Arguments:**

    - `data`: `v1` [m/s], the bit's velocity relative to the drive, along an evenly spaced `time` [s]; NaN marks a
      sample without a value. A dataset or its path; a DataFrame, a dict or the path of a CSV with these columns, which
      may have other units, as in "v1 (mm/s)"; or a pair of arrays (time, v1). Columns `x1`, `x2`, `v2` begin the search
      for the state, and `impact_force` [N] marks contacts.
    - `window`: (begin, end) [s], by default the first 0.5 s.
    - `start`: state at the beginning of the window: "drive", "stuck" (a drill at rest whose drive is switched on), or
      x1, x1', x2, x2' [m, m/s]. None fits the state, from the values in `data` (zeros where there are none). The states
      after contacts are always fitted.
    - `smoothing`: width [m/s] of the smoothed sign change of friction; determines the step size.
    - `contacts`: pairs (begin, end) [s] of times between which striker and bit touch, in addition to those that the
      data state by `impact_force` or by events.
    - `parameters`: parameters of the rotary scene, by default the fixed parameters of `data`, then the scene's
      defaults. `mu` and `v_cr` are initial guesses, by default the scene's.

    **Returns:** a dataset with

    - `mu`, `v_cr` [m/s], each with `_stderr`, the standard error for independent noise of equal variance, and
      `_change`;
    - `rms` [m/s] of the residuals, `used` and `left_out` (numbers of samples), `state` at the beginning of the window
      (with contacts along `part`, whose coordinate is the time at which each part begins), and the `fitted` velocity
      along `time`, NaN at contacts;
    - `reason`: why the values are NaN. A window does not identify them if, for example, the bit always sticks or a
      relative standard error is 1/2 or more.

    **Raises:** `InputError`.

    **Example:**

    >>> motion = vj.simulate("rotary", mu=0.3, start="stuck", duration=1.0, progress=False)
    >>> friction = vj.fit_friction(motion, window=(0.0, 0.4), start="stuck")
    >>> f"{float(friction.mu):.2f}"
    '0.30'
    """
    place, data = open_recording(data, "fit_friction")
    time, velocity, parts = _window(place, data, window, contacts)
    if not (np.isfinite(smoothing) and smoothing > 0):
        raise place.at("smoothing").error(f"is {smoothing}; it must be above 0")
    p = _parameters(place, data, parameters)
    firsts = [part.start for part in parts]
    initial = [_state(place, data.sel(time=time[k]), start if k == 0 else None, velocity[k], p) for k in firsts]
    sought = np.array([k > 0 or start is None for k in firsts])
    longest = max(len(part) for part in parts)
    interval = (time[-1] - time[0]) / (len(time) - 1)
    substeps = max(1, int(np.ceil(interval * p["g"] / smoothing)))
    steps = 2 * substeps * longest * len(parts)
    if steps > _MAX_STEPS:
        raise place.at("smoothing").error(
            f"{smoothing:g} m/s over this window takes {steps} steps; {_MAX_STEPS} are the most: shorten the window"
        )
    measured = np.full((len(parts), longest), np.nan)
    for row, part in zip(measured, parts, strict=True):
        row[: len(part)] = velocity[part]
    states = np.array(initial)
    unknowns = np.concatenate([np.log([p["mu"], p["v_cr"]]), states[sought].ravel()])
    seen = np.isfinite(measured)
    values: dict[str, object] = {name: np.nan for name in _SCHEMA}
    values |= {"used": seen.sum(), "left_out": len(time) - seen.sum(), "reason": Reason.TOO_FEW_LANES}
    values |= {"state": np.full_like(states, np.nan), "fitted": np.full(len(time), np.nan)}
    if seen.sum() > unknowns.size:
        fixed = p | {"interval": interval, "width": smoothing}
        first, *_ = _fit(unknowns, states, sought, fixed, substeps, measured)
        narrow = fixed | {"width": smoothing / 2}
        unknowns, fitted, jacobian = _fit(first, states, sought, narrow, 2 * substeps, measured)
        residual = (fitted - measured)[seen]
        relative, values["reason"] = _relative_errors(fitted, jacobian[seen.ravel()], residual)
        if values["reason"] == Reason.IDENTIFIED:
            along_time = np.full(len(time), np.nan)
            for row, part in zip(fitted, parts, strict=True):
                along_time[part] = row[: len(part)]
            values |= {"rms": np.sqrt(np.mean(residual**2)), "fitted": along_time}
            values["state"] = _all_states(unknowns, states, sought)
            for index, name in enumerate(("mu", "v_cr")):
                value = np.exp(unknowns[index])
                values |= {name: value, f"{name}_stderr": value * relative[index]}
                values[f"{name}_change"] = value - np.exp(first[index])
    coordinates = {
        "time": ("time", time, {"units": "s", "long_name": "time"}),
        "quantity": ("quantity", list(_SCENE.state_names), {"units": "1", "long_name": "state"}),
    }
    dims = {"state": ("part", "quantity"), "fitted": ("time",)}
    if len(parts) == 1 and len(parts[0]) == len(time):
        dims["state"], values["state"] = ("quantity",), np.asarray(values["state"])[0]
    else:
        coordinates["part"] = ("part", time[firsts], {"units": "s", "long_name": "beginning of a part without contact"})
    return fit_dataset(
        place, data, "fit of the friction", "friction, eq. 5.9, fitted", _SCHEMA, values, dims, coordinates
    )


def _fit(
    unknowns: Float[np.ndarray, " unknowns"],
    states: Float[np.ndarray, "parts 4"],
    sought: Bool[np.ndarray, " parts"],
    fixed: Mapping[str, object],
    substeps: int,
    velocity: Parts,
) -> tuple[Float[np.ndarray, " unknowns"], Parts, Float[np.ndarray, "samples unknowns"]]:
    """Return the unknowns at the least squares, searched from `unknowns`, and the fitted velocity with its Jacobian.

    The unknowns are ln mu, ln v_cr and the states at the beginning of the `sought` parts; the other parts begin in
    `states`. The Jacobian is with respect to the unknowns divided by `_SCALES`, with one row for each sample.
    """
    seen = np.isfinite(velocity)
    scales = np.concatenate([_SCALES[:2], np.tile(_SCALES[2:], sought.sum())])
    with precision("float64"):
        arrays = {name: jnp.asarray(value) for name, value in fixed.items()}

        latest: dict[bytes, tuple[Parts, Float[np.ndarray, "samples unknowns"]]] = {}

        def evaluate(scaled: Float[np.ndarray, " unknowns"]) -> tuple[Parts, Float[np.ndarray, "samples unknowns"]]:
            # The search asks for the residual and then for the Jacobian at the same point.
            key = scaled.tobytes()
            if key not in latest:
                latest.clear()
                latest[key] = computed(scaled)
            return latest[key]

        def computed(scaled: Float[np.ndarray, " unknowns"]) -> tuple[Parts, Float[np.ndarray, "samples unknowns"]]:
            theta = scaled * scales
            begins = _all_states(theta, states, sought)
            local = np.concatenate([np.broadcast_to(theta[:2], (len(begins), 2)), begins], axis=1)
            derivatives, motion = _derivatives(
                jnp.asarray(local), arrays, substeps, velocity.shape[1], bool(sought.any())
            )
            jacobian = np.zeros((*velocity.shape, theta.size))
            jacobian[..., :2] = derivatives[..., :2]
            for order, part in enumerate(np.flatnonzero(sought)):
                jacobian[part, :, 2 + 4 * order : 6 + 4 * order] = derivatives[part, :, 2:]
            return np.asarray(motion), jacobian.reshape(-1, theta.size) * scales

        def residual(scaled: Float[np.ndarray, " unknowns"]) -> Samples:
            return (evaluate(scaled)[0] - velocity)[seen]

        scaled = unknowns / scales
        if np.isfinite(residual(scaled)).all():
            tolerances = dict.fromkeys(("ftol", "xtol", "gtol"), _TOLERANCE)
            scaled = least_squares(
                residual,
                scaled,
                lambda scaled: evaluate(scaled)[1][seen.ravel()],
                max_nfev=_MAX_EVALUATIONS,
                **tolerances,
            ).x
        return scaled * scales, *evaluate(scaled)


def _all_states(
    unknowns: Float[np.ndarray, " unknowns"], states: Float[np.ndarray, "parts 4"], sought: Bool[np.ndarray, " parts"]
) -> Float[np.ndarray, "parts 4"]:
    """Return the states at the beginning of all parts: those among the `unknowns`, and the known `states`."""
    states = states.copy()
    states[sought] = unknowns[2:].reshape(-1, states.shape[1])
    return states


@jitted(static=("substeps", "samples", "with_states"))
def _derivatives(
    unknowns: Float[Array, "parts unknowns"],
    fixed: Mapping[str, Array],
    substeps: int,
    samples: int,
    with_states: bool,
) -> tuple[Float[Array, "parts samples sought"], Float[Array, "parts samples"]]:
    """Return the Jacobian of `_velocity` of each part, and the velocities.

    The Jacobian is with respect to ln mu and ln v_cr, and also to the state if `with_states`.
    """

    def of_part(unknowns: Unknowns) -> tuple[Float[Array, "samples sought"], Float[Array, " samples"]]:
        count = unknowns.size if with_states else 2

        def motion(head: Unknowns) -> tuple[Float[Array, " samples"], Float[Array, " samples"]]:
            velocity = _velocity(jnp.concatenate([head, unknowns[count:]]), fixed, substeps, samples)
            return velocity, velocity

        return jax.jacfwd(motion, has_aux=True)(unknowns[:count])

    return jax.vmap(of_part)(unknowns)


def _velocity(unknowns: Unknowns, fixed: Mapping[str, Array], substeps: int, samples: int) -> Float[Array, " samples"]:
    """Return x1' [m/s] of the smoothed rotary motion at the sampling times.

    `fixed`: parameters, `state` unless it is among the unknowns, sampling `interval` [s], and smoothing `width` [m/s].
    """
    p = _SCENE.constants({**fixed, "mu": jnp.exp(unknowns[0]), "v_cr": jnp.exp(unknowns[1])})
    state = tuple(unknowns[2:] if unknowns.size > 2 else fixed["state"])
    step = fixed["interval"] / substeps
    states = smoothed_trajectory(_SCENE, p, state, step, substeps * (samples - 1), fixed["width"])
    return jnp.concatenate([state[1][None], states[1][substeps - 1 :: substeps]])


def _relative_errors(
    fitted: Parts, jacobian: Float[np.ndarray, "samples unknowns"], residual: Samples
) -> tuple[Float[np.ndarray, " unknowns"], Reason]:
    """Return the standard errors of the unknowns, and IDENTIFIED or the reason why the unknowns are not reliable.

    The first two unknowns are logarithms, so their errors are relative errors of mu and v_cr. `jacobian` and `residual`
    are those of the samples with a value.
    """
    size = jacobian.shape[1]
    freedom, errors = residual.size - size, np.full(size, np.nan)
    if not (np.isfinite(jacobian).all() and np.isfinite(fitted).all()):
        return errors, Reason.NOT_CONVERGED
    if confounded_coefficients(jacobian)[: 2 if size > len(_SCALES) else size].any():  # of several parts, mu and v_cr
        return errors, Reason.CONFOUNDED
    basis = np.linalg.qr(jacobian)[0]
    along = basis @ (basis.T @ residual)
    across = np.linalg.norm(residual - along) / np.sqrt(freedom)
    if np.linalg.norm(along) / np.sqrt(size) > _OFFSET * across + np.finfo(float).eps:
        return errors, Reason.NOT_CONVERGED
    errors = np.sqrt(np.sum(residual**2) / freedom) * np.linalg.norm(np.linalg.pinv(jacobian), axis=1)
    return errors, Reason.IDENTIFIED if (errors[:2] < _VAGUE).all() else Reason.CONFOUNDED


def _window(
    place: Place, data: xr.Dataset, window: tuple[float, float] | None, contacts: Contacts
) -> tuple[Samples, Samples, list[range]]:
    """Return the evenly spaced times [s] in the window, the bit's velocity [m/s], and the parts without contact."""
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
    velocity = data["v1"].values[inside].astype(float)
    parts = contact_free_parts(place, data, inside, contacts)
    if len(parts) != 1 or len(parts[0]) < len(velocity):
        parts = [part for part in parts if np.isfinite(velocity[part]).sum() >= MIN_SAMPLES]
    if not parts:
        raise place.at("window").error(
            f"holds impacts; choose one between them: no part without contact has {MIN_SAMPLES} samples"
        )
    return times[inside], velocity, parts


def _parameters(place: Place, data: xr.Dataset, values: Mapping[str, float]) -> dict[str, float]:
    """Return the parameters of the rotary scene. The initial guesses of mu and v_cr are never taken from the data."""
    table = _SCENE.parameters()
    p = {name: parameter.default for name, parameter in table.items()}
    p |= {name: x for name, x in parameters_of(data).items() if name in table and name not in ("mu", "v_cr")}
    for name, value in values.items():
        if name not in table:
            raise place.at(name).error(f"is not a parameter of the rotary scene; {suggest_parameter(name, table)}")
        p[name] = quantity(place.at(name), value, table[name])
    if p["mu"] == 0:
        raise place.at("mu").error("is 0; it must be above 0")
    return p


def _state(
    place: Place, data: xr.Dataset, start: str | Sequence[float] | None, v1: float, p: Mapping[str, float]
) -> list[float]:
    """Return the state at the beginning of the window: specified by `start`, or the initial guess for its search."""
    if isinstance(start, str):
        return [0.0, -p["v"] if choice(place.at("start"), start, _SCENE.starts) == "stuck" else 0.0, 0.0, 0.0]
    if start is not None:
        values = np.asarray(start, dtype=float)
        if values.shape != (4,) or not np.isfinite(values).all():
            raise place.at("start").error(f"{shown(start)} is not x1, x1', x2, x2' [m, m/s]")
        return values.tolist()
    state = [float(data[name]) if name in data else 0.0 for name in _SCENE.state_names]
    state[1] = float(v1)
    return [value if np.isfinite(value) else 0.0 for value in state]

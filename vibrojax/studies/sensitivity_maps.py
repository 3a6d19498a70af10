"""Derivatives at the periodic orbits of a sweep's lanes: the analysis `sensitivity`."""

from collections.abc import Mapping, Sequence
from os import PathLike
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float, Int

from vibrojax.errors import Place
from vibrojax.io.variables import VARIABLES, Variable
from vibrojax.lanes.labels import measured_besides
from vibrojax.maps.dataset import coordinates, shared_attributes
from vibrojax.maps.rerun import orbits, sweep_with_orbits
from vibrojax.maps.sweep import Sweep
from vibrojax.periodic.known_orbits import known_orbits
from vibrojax.periodic.orbit_derivatives import (
    DERIVATIVE_REASONS,
    MODULUS,
    STABILITY,
    orbit_features,
    orbit_variables,
)
from vibrojax.progress import Progress
from vibrojax.scenes import Scene
from vibrojax.studies.sensitivity_run import read_names

KIND = "sensitivity"

LANES_PER_CALL = 256
"""Lanes between two reports of progress."""

ORBIT_VARIABLES = {
    STABILITY: Variable("1", "natural logarithm of the largest modulus of the orbit's multipliers"),
}
"""Variables of orbits that sweeps do not have."""

_VALID = Variable("1", "whether the derivatives of the lane hold", np.int8, ("not-valid", "valid"))
_REASON = Variable("1", "why the derivatives of the lane do not hold", np.int8, DERIVATIVE_REASONS)


def described(scene: Scene[Any], name: str) -> Variable:
    """Return unit and meaning of a feature of a scene's orbits."""
    known = VARIABLES | ORBIT_VARIABLES | measured_besides(scene)
    return known["multiplier_abs" if name.startswith(MODULUS) else name]


OWN_ORBIT = 1e-3
"""Largest distance from the orbit in the dataset, in half swings, of the orbit whose derivatives are computed."""


def at_orbits(sweep: Sweep, lanes: xr.Dataset, by: Sequence[str], progress: bool) -> xr.Dataset:
    """Return the dataset of [vibrojax.sensitivity][]; `lanes`: dataset of the sweep with orbits."""
    scene = sweep.system
    table = scene.parameters()
    by = read_names(Place("sensitivity").at("by"), by, table) if by else [*table]
    of = orbit_variables(scene)
    values = sweep.lane_values(0, sweep.lanes)[0]
    values = {name: values[name].astype(float) for name in table}
    lanes = lanes.transpose(*sweep.dims, ...)
    driving = scene.driving_part()
    known = known_orbits(driving, lanes, {name: values[name] for name in driving.parameters()})
    shape = (sweep.lanes, len(of))
    features, slopes = np.full(shape, np.nan), np.full((*shape, len(by)), np.nan)
    reason = np.full(shape, DERIVATIVE_REASONS.index("no-orbit"))
    reason[lanes["status"].values.ravel() != 0] = DERIVATIVE_REASONS.index("failed")
    cycles = np.array([len(states) for states in known.states], int)
    with Progress(len(cycles), "orbits", progress, pace=False) as report:
        for number in np.unique(cycles):
            alike = np.flatnonzero(cycles == number)
            for part in np.split(alike, range(LANES_PER_CALL, len(alike), LANES_PER_CALL)):
                index = known.lanes[part]
                p = {name: x[index] for name, x in values.items()}
                orbit = orbit_features(scene, of, by, p, np.stack([known.states[k] for k in part]), OWN_ORBIT)
                features[index], slopes[index], reason[index] = orbit.values, orbit.derivatives, orbit.reason
                report.add(len(part))
    points = np.stack([values[name] for name in by], axis=1)
    return _described(sweep, of, by, points, features, slopes, _of_lane(reason))


def sensitivity(
    source: xr.Dataset | str | PathLike[str] | Mapping[str, object] | Sweep,
    *,
    by: str | Sequence[str] = (),
    progress: bool = True,
) -> xr.Dataset:
    """Differentiate the features of a sweep's periodic orbits with respect to the parameters of the scene.

        s = vj.sensitivity(ds)
        s.d_impact_velocity.sel(parameter="beta")  # m/s per unit of beta, in every lane

    The derivatives are those along the family of orbits, by the implicit function theorem at the fixed point of the
    return map: ds/dp = (1 - P_s)^-1 P_p for the state s at the section. Features are then measured over one period of
    the orbit, with tangents along (ds/dp, dp) through all events. Unlike in [vibrojax.derivatives][], nothing depends
    on the time in which the motion settles, and unstable orbits have derivatives, too.

    **Arguments:**

    - `source`: the dataset of a sweep, or a sweep as in `run_sweep`. Unless the dataset has orbits
      (`orbits = true`), its sweep is run again.
    - `by`: parameters of the scene, by default all.
    - `progress`: True to report progress on stderr.

    **Returns:** a dataset over the dimensions of the sweep.

    - The variables of the orbits that vary smoothly, among them `period`, `impact_velocity`, `impact_energy`,
      `impact_power`, `peak_impact_force`, `impact_phase`, `grazing_margin`, `multiplier_abs` along `multiplier`,
      `log_multiplier` (the natural logarithm of the largest modulus), and `rate_of_penetration` with rock.
    - `d_VARIABLE` along `parameter`: their derivatives, in the unit of the variable per unit of the parameter
      (`parameter_unit`). They are NaN where the variable is not defined, as the impact velocity without impacts.
    - `valid` (0 or 1) and `reason`. *no-orbit*: the lane is not periodic, or no orbit was found. *neutral-orbit*: a
      multiplier is 1, so that the orbit does not depend smoothly on the parameters. *near-grazing*, *near-stick*: an
      impact, or a stick phase, is about to appear or vanish; derivatives hold only very close to the point.
      *equal-multipliers*: two multipliers, or their moduli, are almost equal; only the derivatives of multipliers do
      not hold. *failed*: the lane failed, or the derivative cannot be computed.

    **Raises:** `InputError` if the source is not a sweep or the dataset of one, or a parameter is unknown.

    **Example:**

    >>> point = {"beta": 0.4, "gamma": 0.75, "delta": 0.005}
    >>> sweep = {"scene": "vibro-impact", "parameters": point, "starts": ["stuck"]}
    >>> s = vj.sensitivity(sweep, by=["v", "delta"], progress=False)
    >>> s.d_impact_velocity.values.ravel().round(2).tolist()  # per m/s, and per m of the gap
    [1.3, 27.28]
    """
    sweep = sweep_with_orbits(source)
    lanes = orbits(source if isinstance(source, xr.Dataset) else sweep, progress)
    return at_orbits(sweep, lanes, [by] if isinstance(by, str) else by, progress)


def _of_lane(reason: np.ndarray) -> np.ndarray:
    """Return the reason of each lane: the first in order that is not that the variable is undefined."""
    defined = np.where(reason == DERIVATIVE_REASONS.index("undefined"), 0, reason)
    known = np.where(defined > 0, defined, len(DERIVATIVE_REASONS)).min(axis=1)
    return np.where(known == len(DERIVATIVE_REASONS), 0, known)


def _described(
    sweep: Sweep,
    of: Sequence[str],
    by: Sequence[str],
    points: Float[np.ndarray, "lanes by"],
    features: Float[np.ndarray, "lanes of"],
    slopes: Float[np.ndarray, "lanes of by"],
    why: Int[np.ndarray, " lanes"],
) -> xr.Dataset:
    """Return the dataset: the variables of the orbits, their derivatives, and the reason of each lane."""
    scene, table = sweep.system, sweep.system.parameters()
    data: dict[str, Any] = {
        "valid": (sweep.dims, (why == 0).astype(np.int8).reshape(sweep.shape), _VALID.attributes()),
        "reason": (sweep.dims, why.astype(np.int8).reshape(sweep.shape), _REASON.attributes()),
    }
    meaning = {"units": "", "long_name": "value of the parameter, in its own unit"}
    data["parameter_value"] = ((*sweep.dims, "parameter"), points.reshape(*sweep.shape, len(by)), meaning)
    groups: dict[str, list[int]] = {}
    for place, name in enumerate(of):
        groups.setdefault("multiplier_abs" if name.startswith(MODULUS) else name, []).append(place)
    for name, places in groups.items():
        about = described(scene, of[places[0]])
        several = name == "multiplier_abs"
        dims = (*sweep.dims, "multiplier") if several else sweep.dims
        size = (*sweep.shape, len(places)) if several else sweep.shape
        data[name] = (dims, features[:, places].reshape(size), about.attributes())
        meaning = {"units": about.units, "long_name": f"derivative, per unit of the parameter, of: {about.long_name}"}
        data[f"d_{name}"] = ((*dims, "parameter"), slopes[:, places].reshape(*size, len(by)), meaning)
    coords = {
        **coordinates(sweep, {"multiplier": len(sweep.system.driving_part().return_states)}),
        "parameter": ("parameter", list(by), {"long_name": "parameter of the derivative"}),
        "parameter_unit": ("parameter", [table[name].unit for name in by], {"long_name": "unit of the parameter"}),
    }
    title = f"Sensitivities of the orbits: {sweep.title or sweep.name}"
    return xr.Dataset(data, coords, {**shared_attributes(sweep, KIND, title, KIND), "sweep": sweep.text})

"""Derivatives of measured variables with respect to parameters, by forward-mode differentiation of located motions."""

import json
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Bool

from vibrojax.errors import Place, shown, suggestion
from vibrojax.io.kinds import dataset_attributes
from vibrojax.io.variables import VARIABLES, Variable
from vibrojax.lanes.labels import measured_besides, unresolved
from vibrojax.lanes.scene_variables import feature_names
from vibrojax.maps.read import Point, read_point, several_and_single
from vibrojax.periodic.orbit_derivatives import COUNTED
from vibrojax.physics.meanings import suggest_parameter
from vibrojax.physics.parameters import positive
from vibrojax.scenes import HasFriction, Scene
from vibrojax.settings.values import check_distinct, quantity
from vibrojax.studies.analysis import Analysis
from vibrojax.studies.sensitivity_tangents import NEARBY, REASONS, judged, run_and_derive

_POINTWISE = ("point", "variable", "parameter")
_TABLE = {
    "measured": (("point", "variable"), Variable("", "the variable that is differentiated, in its own unit")),
    "value": (("point", "parameter"), Variable("", "value of the parameter, in its own unit")),
    "derivative": (_POINTWISE, Variable("", "derivative of the variable, in its unit per the parameter's")),
    "elasticity": (_POINTWISE, Variable("1", "relative change of the variable per relative change of the parameter")),
    "drift": (_POINTWISE, Variable("1", "relative distance of derivative or variable from its settled value")),
    "central_difference": (
        _POINTWISE,
        Variable("", "slope between the points with the parameter moved by one part in ten thousand either way"),
    ),
    "valid": (_POINTWISE, Variable("1", "whether the derivative holds", np.int8, ("not-valid", "valid"))),
    "reason": (_POINTWISE, Variable("1", "why the derivative does not hold", np.int8, REASONS)),
}
"""Dimensions and meaning of the variables. An empty unit means that units differ along a dimension; coordinates hold
these units."""


class Derivatives(Analysis):
    """Derivatives of the features of a lane with respect to the parameters of the scene."""

    kind = "derivatives"


def derivatives(
    scene: str | Scene[Any],
    *,
    of: str | Sequence[str],
    by: str | Sequence[str],
    start: str | Sequence[float] | None = None,
    settle: float | None = None,
    observe: float | None = None,
    error: float = 1e-3,
    progress: bool = True,
    **parameters: Any,
) -> xr.Dataset:
    """Differentiate period, impact velocity, rate of penetration or other measured variables by parameters.

        vj.derivatives("vibro-impact", of=["period", "impact_velocity"], by=["beta", "gamma"], beta=0.4, start="stuck")

    Derivatives include the events: the time of a located event depends on the parameters (implicit derivative of the
    root). They therefore equal the derivatives of the exact motion to 1e-6 or better, as long as the order of events
    does not change.

    The differentiated value is measured after `settle`, as in a sweep. A derivative settles later than the motion. If
    the distance from the orbit falls as m^k after k returns to the section, the derivative's distance from its settled
    value falls as k m^k, where m is the orbit's largest multiplier. `drift` is the larger of the two relative distances
    of variable and derivative from their settled values.

    Derivatives are computed in forward mode (`jax.jvp`). Reverse mode (`jax.grad`) cannot differentiate the loops of a
    motion, whose number of steps varies. This function rejects `jax.grad` and every other JAX transformation. Use the
    numbers that it returns instead: for a few parameters, they are the complete gradient. To apply `jax.jvp` or
    `jax.jacfwd` yourself, use the underlying pure function [vibrojax.measures.recorder.run_block][].

    **Arguments:**

    - `scene`, `start`, `parameters` (SI): as in `simulate`. Parameters that are lists of equal length define several
      points.
    - `of`: variables of the scene's datasets to differentiate, which must not be counts; `by`: parameters of the scene.
    - `settle`, `observe` [s]: as in a sweep; by default 40 and 8, or 1 and 1 for a scene driven by pulses.
    - `error`: relative error tolerance of a derivative.
    - `progress`: whether to report progress on stderr.

    **Returns:** a dataset over `variable` and `parameter` (and `point`, if there are lists):

    - `measured`: the variable; `value`: the parameter. The coordinates `unit` and `parameter_unit` hold their units.
    - `derivative`, with units in the coordinate `derivative_unit`; `elasticity`: relative change of the variable per
      relative change of the parameter.
    - `valid` (0 or 1), and the `reason` if it is 0: the point cannot be run (refused, failed), the motion is not
      periodic, or the value is undefined or zero. A derivative is also invalid if a parameter change of one part in ten
      thousand changes the number of events or the period in returns (a graze, a border of the regime). The same holds
      if derivative or value are farther than `error` from their settled values (`drift`), or if the derivative differs
      from the slope between the points on both sides (`central_difference`).

    Invalid derivatives are returned, too. If the elasticity is below 1e-3, errors are relative to an elasticity of
    1e-3.

    **Raises:** `InputError` for an unknown name or an invalid value.

    **Example:**

    >>> point = {"rock": "granite", "force": 500e3, "frequency": 20.0, "progress": False}
    >>> found = vj.derivatives("penetration", of="rate_of_penetration", by=["force", "frequency"], **point)
    >>> found.elasticity.sel(variable="rate_of_penetration").round(1).to_pandas().to_dict()
    {'force': 2.2, 'frequency': 1.0}
    >>> bool((found.valid == 1).all())
    True
    """
    place = Place("derivatives")
    points, columns = _read_points(place, scene, parameters, start)
    system = points[0].system

    def setting(name: str, value: object, default: float, unit: str = "s") -> float:
        return default if value is None else quantity(place.at(name), value, positive(name, default, unit, name, name))

    driven = system.section is None
    usual = (1.0, 1.0) if driven else system.usual_times
    settle, observe = setting("settle", settle, usual[0]), setting("observe", observe, usual[1])
    accepted = setting("error", error, 1e-3, "1")
    known = VARIABLES | measured_besides(system)
    measured = feature_names(system)
    smooth = [
        name
        for name, about in known.items()
        if about.dtype == np.float64 and name in measured and name not in COUNTED and not name.startswith("return_")
    ]
    variables = read_names(place.at("of"), of, smooth)
    wrt = read_names(place.at("by"), by, points[0].system.parameters())
    value = np.array([[point.parameters[name] for name in wrt] for point in points])
    # A parameter that is zero is changed relative to its default, or to 1 if the default is zero, too.
    scales = np.array([abs(system.parameters()[name].default) or 1.0 for name in wrt])
    move = NEARBY * np.where(value != 0, np.abs(value), scales)
    features, tangents = run_and_derive(points, wrt, move, settle, observe, progress)
    arrays = judged(features, tangents, variables, value, move, accepted) | {"value": value}
    arrays["reason"] = np.where(_is_refused(points)[:, None, None], REASONS.index("refused"), arrays["reason"])
    arrays["valid"] = arrays["reason"] == 0
    table, first = system.parameters(), points[0]
    units, per = [known[name].units for name in variables], [table[name].unit for name in wrt]
    data = {}
    for name, (dims, about) in _TABLE.items():
        entries = {key: text for key, text in about.attributes().items() if key != "units" or about.units}
        data[name] = (dims, np.asarray(arrays[name], about.dtype), entries)
    quotients = [[f"{unit} ({other})-1" if other != "1" else unit for other in per] for unit in units]
    coordinates: dict[str, tuple[Any, ...]] = {
        "variable": ("variable", variables, {"long_name": "differentiated variable"}),
        "parameter": ("parameter", wrt, {"long_name": "parameter of the derivative"}),
        "unit": ("variable", units, {"long_name": "unit of the variable"}),
        "parameter_unit": ("parameter", per, {"long_name": "unit of the parameter"}),
        "derivative_unit": (("variable", "parameter"), quotients, {"long_name": "unit of the derivative"}),
    }
    for name, column in columns.items():
        meaning = {"units": table[name].unit, "long_name": table[name].long_name} if name in table else {}
        coordinates[name] = ("point", column, meaning)
    title = f"Derivatives of {', '.join(variables)} in {first.scene}"
    fixed = {name: x for name, x in first.parameters.items() if all(p.parameters[name] == x for p in points)}
    attributes = {
        **dataset_attributes("derivatives", title, "derivatives", scene=first.scene),
        **first.options,
        **({} if first.start is None else {"start": json.dumps(first.start)}),
        "parameters": json.dumps(fixed),
        "settle": settle,
        "observe": observe,
    }
    dataset = xr.Dataset(data, coordinates, attributes)
    return dataset if columns else dataset.squeeze("point")


def _read_points(
    place: Place, scene: str | Scene[Any], parameters: Mapping[str, object], start: object
) -> tuple[list[Point], dict[str, list[Any]]]:
    """Return the validated points, and the parameters that are lists by name."""
    columns, fixed = several_and_single(parameters)
    first = next(iter(columns), "")
    count = len(columns[first]) if columns else 1
    for name, column in columns.items():
        if len(column) != count or not column:
            why = f"{first} has {count}" if name != first else "at least one is needed"
            raise place.at(name).error(f"has {len(column)} values; {why}")
    rows = ({name: column[index] for name, column in columns.items()} for index in range(count))
    points = [read_point(place, scene, fixed | row, start) for row in rows]
    if any(point.system != points[0].system for point in points):
        raise place.error("friction law and shape of pulses are the same for all points; call it once for each")
    return points, columns


def read_names(place: Place, value: str | Sequence[str], known: Collection[str]) -> list[str]:
    """Return the validated list of names, which must be in `known`."""
    names = [value] if isinstance(value, str) else list(value)
    if not names:
        raise place.error(f"is empty; choose from {', '.join(known)}")
    for name in names:
        if name not in known:
            hint = suggest_parameter(str(name), known) if isinstance(known, Mapping) else suggestion(str(name), known)
            raise place.error(f"the scene has no {shown(name)} to differentiate; {hint}")
    check_distinct(place, names, "name")
    return names


def _is_refused(points: Sequence[Point]) -> Bool[np.ndarray, " points"]:
    """Return which points cannot be run, by the same rules as in a sweep."""
    scene = points[0].system
    p = {name: np.array([point.parameters[name] for point in points]) for name in points[0].parameters}
    unfit = scene.refused(p)
    refused = np.zeros(len(points), bool) if unfit is None else np.zeros(len(points), bool) | np.asarray(unfit[1])
    return refused | unresolved(scene, p, "float64") if isinstance(scene, HasFriction) else refused

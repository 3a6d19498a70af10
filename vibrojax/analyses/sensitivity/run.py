"""Derivatives of what is measured with respect to the parameters, through the located motion, in forward mode."""

import json
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any, TypeGuard

import jax
import numpy as np
import xarray as xr
from jaxtyping import Float

from vibrojax.errors import Place, shown, suggestion
from vibrojax.io.provenance import provenance
from vibrojax.io.variables import VARIABLES, Variable
from vibrojax.measures import gauge_named
from vibrojax.models.physics.parameters import Parameter, positive
from vibrojax.models.scenes import HasFriction, Scene
from vibrojax.sweep.engine.tangents import NEARBY, REASONS, Times, judged, measured_of, run_and_derive
from vibrojax.sweep.engine.validity import unresolved
from vibrojax.sweep.input.point import Point, read_point
from vibrojax.sweep.input.values import quantity

COUNTED = {"impacts", "striker_turns", "settling_time", "error_estimate", "drift_estimate"}
"""Numbers that do not vary smoothly."""

_TABLE = {
    "measured": Variable("1", "the variable that is differentiated, in its own unit"),
    "value": Variable("1", "value of the parameter, in its own unit"),
    "derivative": Variable("1", "derivative of the variable, in its unit per the parameter's"),
    "elasticity": Variable("1", "relative change of the variable per relative change of the parameter"),
    "drift": Variable("1", "how far the derivative, or the variable, still is from where it settles, relative"),
    "central_difference": Variable("1", "the slope between the parameter moved by one part in ten thousand either way"),
    "valid": Variable("1", "whether the derivative holds", np.int8, ("not-valid", "valid")),
    "reason": Variable("1", "why the derivative does not hold", np.int8, REASONS),
}

_IN_THEIR_OWN = {"measured", "value", "derivative", "central_difference"}
"""Variables whose units differ along a dimension; coordinates say them."""


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
    """Derivatives of period, impact velocity, rate of penetration or any other measure with respect to parameters.

        vj.derivatives("vibro-impact", of=["period", "impact_velocity"], by=["beta", "gamma"], beta=0.4, start="stuck")

    They go through the events: where a switch is located, its time moves with the parameters (the root's implicit
    derivative), so they are those of the exact motion, to 1e-6 and better. They hold while the order of events stays as
    it is.

    What is differentiated is the value measured after `settle`, as a sweep would give it. A derivative settles
    together with the motion, but later: where the distance from the orbit after k returns falls as m^k, m being the
    orbit's greatest multiplier, that of the derivative falls as k m^k. `drift` says how far either still is
    from what it is on the orbit.

    They are made in forward mode (`jax.jvp`). Reverse mode (`jax.grad`) does not pass through the loops of a motion,
    which take as many steps as it needs; it, and every other transformation of jax, is refused over this function. Go
    on with the numbers that it returns: for a handful of parameters they are the whole gradient. The pure function
    beneath, for a `jax.jvp` or `jax.jacfwd` of your own, is [vibrojax.measures.run.run_block][].

    **Arguments:**

    - `scene`, `start`, `parameters` (SI): as of `simulate`. Of numbers in lists of one length, each place is a point.
    - `of`: variables of the scene's datasets that are not counts; `by`: its parameters.
    - `settle`, `observe` [s]: as in a sweep; by default 40 and 8, and 1 and 1 where pulses drive.
    - `error`: the relative error that is accepted of a derivative.
    - `progress`: whether to say on stderr how far it is.

    **Returns:** a dataset over `variable` and `parameter` (and `point`, where there are lists):

    - `measured`, and the parameters' `value`; the coordinates `unit` and `parameter_unit` say in what.
    - `derivative`, in the unit that the coordinate `derivative_unit` says; `elasticity`: the relative change per
      relative change.
    - `valid` (0 or 1) and the `reason` where it is not: the point cannot be run (refused, failed); the motion does not
      repeat; there is no such value, or it is zero; a part in ten thousand away the events come in other numbers or
      the motion repeats otherwise (a graze, a border of the regime); the derivative, or the value, is farther than
      `error` from where it settles (`drift`); or it is not the slope between the points to either side
      (`central_difference`).

    Where it is not valid the numbers are there all the same. An elasticity below 1e-3 counts as insensitive: errors are
    then in proportion to that.

    **Raises:** `InputError` where a name or value is not right.

    **Example:**

    >>> point = {"rock": "granite", "force": 500e3, "frequency": 20.0, "progress": False}
    >>> found = vj.derivatives("penetration", of="rate_of_penetration", by=["force", "frequency"], **point)
    >>> found.elasticity.sel(variable="rate_of_penetration").round(1).to_pandas().to_dict()
    {'force': 2.2, 'frequency': 1.0}
    >>> bool((found.valid == 1).all())
    True
    """
    place = Place("derivatives")
    points, columns = _points(place, scene, parameters, start)
    system = points[0].system
    driven = system.section is None
    times = Times(
        _setting(place, "settle", settle, 1.0 if driven else 40.0),
        _setting(place, "observe", observe, 1.0 if driven else 8.0),
    )
    accepted = _setting(place, "error", error, 1e-3, "1")
    known = _smooth(system)
    variables = _names(place.at("of"), of, known)
    wrt = _names(place.at("by"), by, tuple(points[0].parameters))
    value = np.array([[point.parameters[name] for name in wrt] for point in points])
    move = NEARBY * np.where(value != 0, np.abs(value), _scales(system, wrt))
    found, tangents = run_and_derive(points, wrt, move, times, progress)
    arrays = judged(found, tangents, variables, value, move, accepted) | {"value": value}
    arrays["reason"] = np.where(_refused(points)[:, None, None], REASONS.index("refused"), arrays["reason"])
    arrays["valid"] = arrays["reason"] == 0
    return _dataset(points, columns, variables, wrt, arrays, times)


def _points(
    place: Place, scene: str | Scene[Any], parameters: Mapping[str, object], start: object
) -> tuple[list[Point], dict[str, list[object]]]:
    """The points, and what was given in lists."""
    columns = {name: list(x) for name, x in parameters.items() if _is_list(x)}
    lengths = {name: len(column) for name, column in columns.items()}
    for name, length in lengths.items():
        first = next(iter(lengths))
        if length == 0 or length != lengths[first]:
            other = f"{first} has {lengths[first]}" if name != first else "at least one is needed"
            raise place.at(name).error(f"has {length} values; {other}")
    count = next(iter(lengths.values()), 1)
    rows = ({name: column[index] for name, column in columns.items()} for index in range(count))
    points = [read_point(place, scene, dict(parameters) | row, start) for row in rows]
    for point in points:
        if point.system != points[0].system:
            raise place.error("friction law and shape of pulses are the same for all points; call it once for each")
    return points, columns


def _is_list(value: object) -> TypeGuard[Sequence[object]]:
    return isinstance(value, (list, tuple)) or (isinstance(value, (np.ndarray, jax.Array)) and value.ndim > 0)


def _setting(place: Place, name: str, value: object, default: float, unit: str = "s") -> float:
    kind = positive(name, default, unit, name, name)
    return default if value is None else quantity(place.at(name), value, kind)


def _names(place: Place, wanted: str | Sequence[str], known: Sequence[str]) -> tuple[str, ...]:
    names = (wanted,) if isinstance(wanted, str) else tuple(wanted)
    if not names:
        raise place.error(f"is empty; choose from {', '.join(known)}")
    for name in names:
        if name not in known:
            raise place.error(f"the scene has no {shown(name)} to differentiate; {suggestion(str(name), known)}")
    return names


def _scales(scene: Scene[Any], names: Sequence[str]) -> Float[np.ndarray, " parameters"]:
    """What a parameter that is zero is moved against: its default, or 1 where that is zero too."""
    table = scene.parameters()
    return np.array([abs(table[name].default) or 1.0 for name in names])


def _variables(scene: Scene[Any]) -> dict[str, Variable]:
    """All variables that there are, those of the scene's own gauges among them, by name."""
    own = (gauge_named(gauge) for gauge in scene.measures)
    return VARIABLES | {name: Variable(*about) for gauge in own for name, about in gauge.variables.items()}


def _smooth(scene: Scene[Any]) -> tuple[str, ...]:
    """Names of what is measured of the scene and varies smoothly."""
    found = measured_of(scene)
    smooth = (name for name, x in _variables(scene).items() if x.dtype == np.float64 and name not in COUNTED)
    return tuple(name for name in smooth if name in found and not name.startswith("return_"))


def _refused(points: Sequence[Point]) -> np.ndarray:
    """Which points cannot be run, as in a sweep (points,)."""
    scene = points[0].system
    p = {name: np.array([point.parameters[name] for point in points]) for name in points[0].parameters}
    refused = np.zeros(len(points), bool)
    unfit = scene.refused(p)
    if unfit is not None:
        refused |= np.asarray(unfit[1])
    return refused | unresolved(scene, p, "float64") if isinstance(scene, HasFriction) else refused


def _dataset(
    points: Sequence[Point],
    columns: Mapping[str, list[object]],
    variables: Sequence[str],
    wrt: Sequence[str],
    arrays: Mapping[str, Any],
    times: Times,
) -> xr.Dataset:
    scene = points[0].system
    units = [_variables(scene)[name].units for name in variables]
    table: Mapping[str, Parameter] = scene.parameters()
    per = [table[name].unit for name in wrt]
    dims = {"measured": ("point", "variable"), "value": ("point", "parameter")}
    data = {
        name: (
            dims.get(name, ("point", "variable", "parameter")),
            np.asarray(arrays[name], about.dtype),
            {key: text for key, text in about.attributes().items() if key != "units" or name not in _IN_THEIR_OWN},
        )
        for name, about in _TABLE.items()
    }
    quotients = [[f"{unit} ({other})-1" if other != "1" else unit for other in per] for unit in units]
    coordinates = {
        "variable": ("variable", list(variables), {"long_name": "what is differentiated"}),
        "parameter": ("parameter", list(wrt), {"long_name": "with respect to what"}),
        "unit": ("variable", units, {"long_name": "unit of the variable"}),
        "parameter_unit": ("parameter", per, {"long_name": "unit of the parameter"}),
        "derivative_unit": (("variable", "parameter"), quotients, {"long_name": "unit of the derivative"}),
    }
    for name, column in columns.items():
        known = table.get(name)
        described = {"units": known.unit, "long_name": known.long_name} if known else {}
        coordinates[name] = ("point", column, described)
    varied = {name for name in points[0].parameters if len({point.parameters[name] for point in points}) > 1}
    attributes = {
        "title": f"Derivatives of {', '.join(variables)} in {points[0].scene}",
        "scene": points[0].scene,
        **provenance(),
        "history": f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ} derivatives",
        **points[0].options,
        **({} if points[0].start is None else {"start": json.dumps(points[0].start)}),
        "parameters": json.dumps({name: x for name, x in points[0].parameters.items() if name not in varied}),
        "settle": times.settle,
        "observe": times.observe,
        "Conventions": "CF-1.11",
    }
    dataset = xr.Dataset(data, coordinates, attributes)
    return dataset if columns else dataset.squeeze("point")

"""Two-parameter continuation of special points, `curves`: specification, algorithm and dataset."""

import json
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float

from vibrojax.errors import InputError, Place, shown
from vibrojax.io.attributes import parameters_of, text_of
from vibrojax.io.kinds import OF_CURVES, SPECIAL_KINDS, dataset_attributes, kind_of
from vibrojax.io.variables import VARIABLES, described, orbit_name
from vibrojax.lanes.labels import measured_besides, of_orbits
from vibrojax.maps.dataset import attributes_of_parameters
from vibrojax.maps.read import read_point
from vibrojax.periodic.codim2 import CONTINUED
from vibrojax.periodic.curve_branching import condition_at, with_branches, without_duplicates
from vibrojax.periodic.curve_equations import EVENTS, CurveProblem
from vibrojax.periodic.curve_following import Curve, crossings, follow_curves
from vibrojax.periodic.event_map import conditions_of
from vibrojax.periodic.orbits import Orbits
from vibrojax.periodic.problem import CORRECTOR_RESIDUAL, FAMILY_ACCURACY, UNITS_PER_SPAN, check_changes_orbits
from vibrojax.periodic.return_map import Segments
from vibrojax.physics.meanings import suggest_parameter
from vibrojax.physics.parameters import Parameter
from vibrojax.pictures.branches import (
    along_name,
    branches,
    family_coordinates,
    family_numbers,
    kind_names,
    numbers_of,
    places,
)
from vibrojax.progress import Progress
from vibrojax.scenes import Scene
from vibrojax.settings.names import read_names
from vibrojax.settings.values import UnusualValue, count, quantity
from vibrojax.studies.family_data import check_same_code, columns, read_span

SAME_VALUE = 1e-7
"""Difference of the parameter, relative to its range, up to which special points of one kind on one branch are one."""

ONE_SIDED = "on stick curves, the return map has a kink, and these are the multipliers of one side of it"
"""Comment of the multipliers in a dataset with stick curves."""

SAME_ACROSS = 1e-9
"""Scaled distance between two parts of a curve within which their end points are one point."""


def curves(
    family: xr.Dataset,
    *,
    by: str,
    span: tuple[float, float],
    special: int | Sequence[int] | None = None,
    at: Mapping[str, float] | None = None,
    progress: bool = True,
) -> xr.Dataset:
    """Continue the special points of families of orbits in a second parameter, as curves in a parameter plane.

    Each fold, period doubling, torus, grazing, stick and Hopf point is continued in both directions, until a parameter
    reaches a bound. The bounds of the first parameter are the bounds in the call of `follow`. Points of codimension two
    are located and named. Curves that begin at points of codimension two are continued as well, up to a maximum number
    that `curve_note` states.

    **Arguments:**

    - `family`: result of `follow`, but not a family of equilibria (`cycles=0`).
    - `by`: second parameter; `span`: lower and upper bound of this parameter, which enclose its value in the family.
    - `special`: index of a special point of the family, or several indices; by default, all points that can be
      continued.
    - `at`: a value of either parameter, such as `{"beta": 0.5}`; the points at which curves cross this value are
      located.

    **Returns:** a dataset.

    - Variables along `point`, in order along each curve: `point_curve`, the two parameters, `period` [s] (the mean time
      between section crossings), `cycles`, the state at the section (`orbit_x1` and so on), and the multipliers.
    - Variables along `curve`: `kind`, `special` and `curve_note`. `special` is the index of the special point in the
      family, or -1 if the curve begins at a point of codimension two. `curve_note` describes the first point, the ends
      of the curve, and other special points on the curve.
    - Variables along `codim2`: `codim2_kind` (such as cusp or grazing-fold), `codim2_curve` (number of the curve), and
      `codim2_NAME` (value of each parameter).
    - Variables along `crossing`, if the argument `at` is given: `crossing_curve` (number of the curve), and
      `crossing_NAME` (value of each parameter).

    **Raises:** `InputError` for an invalid name or value.

    **Example:**

    >>> point = dict(start="stuck", beta=0.4, delta=0.005, cycles=2)
    >>> fam = vj.follow("vibro-impact", along="gamma", at=0.75, span=(0.3, 1.3), **point, progress=False)
    >>> ds = vj.curves(fam, by="beta", span=(0.38, 0.42), special=0, at={"beta": 0.41}, progress=False)
    >>> ds.crossing_gamma.values.round(8).tolist()
    [1.16457112]
    """
    return continue_curves(read_curves(family, by, span, special, at), progress)


@dataclass(frozen=True, eq=False)
class CurvesSpec:
    """A checked specification.

    - `family`: dataset of the families; `scene`, `options`: scene with its options by name.
    - `along`, `first_span`: parameter of the families, and its bounds; `by`, `span`: second parameter, and its bounds.
    - `special`: indices of the special points; `at`: parameter and value of the crossings, or None.
    - `parameters`: all parameters of each special point, by name.
    """

    family: xr.Dataset
    scene: Scene[Any]
    options: Mapping[str, str]
    along: str
    first_span: tuple[float, float]
    by: str
    span: tuple[float, float]
    special: list[int]
    at: tuple[str, float] | None
    parameters: Mapping[str, np.ndarray]

    def identity(self) -> dict[str, object]:
        """Return all settings on which the result depends, as flat JSON values."""
        values = {"by": self.by, "from": self.span[0], "to": self.span[1], "special": list(self.special)}
        return {"curves": True, "history": text_of(self.family, "history")} | values | {"at": list(self.at or ())}


def read_curves(family: object, by: object, span: object, special: object, at: object) -> CurvesSpec:
    """Check the arguments of `curves`, and return the specification.

    **Raises:** `InputError` with a one-line message at the first invalid argument.
    """
    place = Place("curves")
    if not isinstance(family, xr.Dataset) or kind_of(family) != "family":
        raise place.at("family").error("is not a family of orbits; give what vj.follow or vibrojax follow has made")
    if "eigenvalue_re" in family:
        raise place.at("family").error("holds equilibria; give a family of orbits, which follow(from_hopf=...) begins")
    along = along_name(family)
    fixed: dict[str, Any] = dict(parameters_of(family))
    options = {name: text_of(family, name) for name in ("friction", "pulse_shape") if name in family.attrs}
    names = read_names(place.at("scene"), text_of(family, "scene"), dict(options), place)
    check_same_code(place.at("family"), family, names)
    with warnings.catch_warnings():  # `follow` has already warned
        warnings.simplefilter("ignore", UnusualValue)
        read_point(place, names.system, fixed, None)
    if not isinstance(by, str) or by not in names.parameters:
        raise place.at("by").error(
            f"{shown(by)} is not a parameter of the scene; {suggest_parameter(str(by), names.parameters)}"
        )
    if by == along:
        raise place.at("by").error(f"{by} is the parameter of the family; give another one")
    several = family_coordinates(family, "special")
    if "rock" in several:
        raise place.at("family").error("holds families of several rocks; follow those of one rock")
    check_changes_orbits(place.at("by"), names.system, by)
    low, high = read_span(place, names, by, span)
    kinds = continued_kinds(family)
    chosen = _special(place, special, family, kinds)
    values = {name: np.full(len(chosen), value) for name, value in fixed.items() if name in names.parameters}
    for name in (name for name in several if name in names.parameters):
        own = several[name][chosen].astype(float)
        if name in fixed and np.any(own != fixed[name]):
            raise place.at("family").error(
                f"its orbits are at {name} = {fixed[name]:g}, not {own[0]:g}; follow it there"
            )
        values[name] = own
    if missing := names.parameters.keys() - values.keys() - {along}:
        raise place.at("family").error(
            f"its value of {min(missing)} is not known; select families with isel, without drop=True"
        )
    values[along] = family["special_value"].values[chosen].astype(float)
    outside = ~((values[by] >= low) & (values[by] <= high))
    if outside.any():
        value = float(values[by][outside][0])
        raise place.at("from").error(f"the family is at {by} = {value:g}, which is not between {low:g} and {high:g}")
    first, last = (float(x) for x in family.attrs["span"])
    line = read_line(place.at("at"), names.parameters, at, {along: (first, last), by: (low, high)})
    return CurvesSpec(
        family, names.system, dict(names.options), along, (first, last), by, (low, high), chosen, line, values
    )


def continued_kinds(family: xr.Dataset) -> list[str]:
    """Return the kind of each special point; events that bear their own name are continued like sticks."""
    return [kind if kind in SPECIAL_KINDS else "stick" for kind in kind_names(family)]


def _special(place: Place, special: object, family: xr.Dataset, kinds: list[str]) -> list[int]:
    """Return the indices of the special points to continue."""
    number = numbers_of(family, "special")
    held = np.flatnonzero(np.isin(number, family_numbers(family))).tolist()
    if special is None:
        values, (first, last) = family["special_value"].values, family.attrs["span"]
        own_branch = list(zip(family["special_kind"].values, number, family["special_branch"].values, strict=True))
        distinct: list[int] = []  # without those that a branch has passed before
        for k in (k for k in held if kinds[k] in CONTINUED):
            own = (values[i] for i in distinct if own_branch[i] == own_branch[k])
            if all(abs(value - values[k]) > SAME_VALUE * (last - first) for value in own):
                distinct.append(k)
        if not distinct:
            raise place.error("the family has no special point that can be continued; follow it further")
        return distinct
    here, given = place.at("special"), special if isinstance(special, list | tuple | np.ndarray) else [special]
    if not len(given):
        raise here.error("is empty; give numbers of special points, or leave it out")
    numbers = [count(here, k, 0, len(kinds) - 1) for k in given]
    for k in numbers:
        if k not in held:
            raise here.error(f"{k} is of a family that the dataset does not hold")
        if kinds[k] not in CONTINUED:
            raise here.error(f"{k} is of the kind {kinds[k]}; continued are {', '.join(CONTINUED)}")
    return numbers


def read_line(
    place: Place, parameters: Mapping[str, Parameter], at: object, spans: Mapping[str, tuple[float, float]]
) -> tuple[str, float] | None:
    """Return the parameter and the value at which crossings are located, or None."""
    if at is None:
        return None
    if not isinstance(at, Mapping) or len(at) != 1 or next(iter(at)) not in spans:
        wrong = " and ".join(map(str, at)) if isinstance(at, Mapping) else at
        raise place.error(f"{shown(wrong)} is not {' or '.join(spans)} with a value; give one of them")
    [(name, given)] = at.items()
    value, (low, high) = quantity(place.at(name), given, parameters[name]), spans[name]
    if not low <= value <= high:
        raise place.at(name).error(f"{value:g} is not between {low:g} and {high:g}, the bounds of the curves")
    return name, value


def continue_curves(spec: CurvesSpec, progress: bool = True) -> xr.Dataset:
    """Return the curves of a specification, as `curves` does."""
    problem, unknowns = problem_of(spec)
    with Progress(2 * len(unknowns), "ends of curves", progress, pace=False) as bar:
        continued = follow_curves(problem, unknowns, bar.reach)
        bar.reach(2 * len(unknowns))
    for curve, special in zip(continued, spec.special, strict=True):
        curve.special = special
    problem, continued = with_branches(problem, without_duplicates(problem, continued))
    return curves_dataset(spec, problem, continued)


def problem_of(spec: CurvesSpec) -> tuple[CurveProblem, list[np.ndarray]]:
    """Return the equations of the curves, and the unknowns at the special points."""
    bounds = {spec.along: spec.first_span, spec.by: spec.span}
    kinds = np.array(continued_kinds(spec.family))[spec.special]
    return problem_through(spec.scene, bounds, spec.parameters, kinds, [_orbit_at(spec, k) for k in spec.special])


def problem_through(
    scene: Scene[Any],
    bounds: Mapping[str, tuple[float, float]],
    parameters: Mapping[str, np.ndarray],
    kinds: np.ndarray,
    orbits: list[tuple[int, Float[np.ndarray, " states"]]],
) -> tuple[CurveProblem, list[np.ndarray]]:
    """Return the equations of curves through orbits, and the unknowns at these orbits.

    **Arguments:** `bounds`: lower and upper bounds of the first and of the second parameter, by name; `parameters`: all
    parameters of each orbit, by name. `kinds`: kind of each curve; `orbits`: for each curve the number of section
    crossings and the state at the section.
    """
    scene, count = scene.driving_part(), len(orbits)
    (first, second), limits = bounds, np.array([*bounds.values()], float)
    parameters = {name: parameters[name] for name in scene.parameters()}
    # The program of the curves serves here, too: another one would have to be compiled.
    go = Segments(scene, (first, second), FAMILY_ACCURACY)
    cycles = np.array([number for number, _ in orbits])
    states, scales = [state[None] for _, state in orbits], np.ones((count, len(scene.return_states)))
    moving = kinds != "hopf"  # an equilibrium does not return to the section
    for repeat in np.unique(cycles[moving]).tolist():
        index = np.flatnonzero(moving & (cycles == repeat))
        own = {name: x[index] for name, x in parameters.items()}
        traced = Orbits.trace(scene, own, np.array([orbits[k][1] for k in index]), repeat, go)
        scales[index] = traced.scales
        for k, whole in zip(index.tolist(), traced.states, strict=True):
            states[k] = whole
    none = np.zeros((count, len(conditions_of(scene))))
    problem = CurveProblem(
        scene=scene,
        along=(first, second),
        parameters=parameters,
        scales=scales,
        unit=np.tile(np.diff(limits).T / UNITS_PER_SPAN, (count, 1)),
        first=np.tile(limits[:, 0], (count, 1)),
        last=np.tile(limits[:, 1], (count, 1)),
        kinds=kinds,
        chosen=none,
    )
    unknowns = []
    for k in range(count):
        values = np.array([[parameters[first][k], parameters[second][k]]])
        unknowns.append(problem.unknowns(np.array([k]), states[k][None], values)[0])
        if kinds[k] in EVENTS:
            none[k] = condition_at(problem, k, unknowns[k])
    return problem, unknowns


def _orbit_at(spec: CurvesSpec, index: int) -> tuple[int, Float[np.ndarray, " states"]]:
    """Return the number of section crossings, and the state at the section, at a special point of the family."""
    family = spec.family
    for branch in branches(family):
        if index in branch.special:
            point = int(places(family, branch)[list(branch.special).index(index)])
            apart = abs(family[spec.along].values[point] - family["special_value"].values[index])
            if apart > SAME_VALUE * (spec.first_span[1] - spec.first_span[0]):
                break
            names = map(orbit_name, spec.scene.driving_part().return_states)
            return int(family["cycles"].values[point]), np.array([float(family[name].values[point]) for name in names])
    raise InputError(f"curves: special: the point of {index} is not in the family; give the whole family")


def curves_dataset(spec: CurvesSpec, problem: CurveProblem, curves: list[Curve]) -> xr.Dataset:
    """Return the dataset of curves."""
    known, kinds = kind_names(spec.family), (*SPECIAL_KINDS, *problem.scene.named_events)
    own = [known[curve.special] if curve.special >= 0 else str(problem.kinds[curve.number]) for curve in curves]
    names, marks = problem.along, [(k, mark) for k, curve in enumerate(curves) for mark in curve.marks]
    table, number = _points(problem, curves)
    variables: dict[str, Any] = {
        "point_curve": ("point", number),
        **{name: (("point", "multiplier")[: x.ndim], x) for name, x in table.items()},
        "kind": ("curve", [kinds.index(name) for name in own]),
        "special": ("curve", [curve.special for curve in curves]),
        "curve_note": ("curve", ["; ".join(curve.notes) for curve in curves]),
        "codim2_kind": ("codim2", [mark.kind for _, mark in marks]),
        "codim2_curve": ("codim2", [k for k, _ in marks]),
    }
    located = {"codim2": ("at the point", [mark.orbit for _, mark in marks])}
    if spec.at is not None:
        which, parts = names.index(spec.at[0]), [(k, part) for k, curve in enumerate(curves) for part in curve.parts]
        with np.errstate(all="ignore"):
            passed = [(k, point) for k, part in parts for point in crossings(problem, part, which, spec.at[1])]
        variables["crossing_curve"] = ("crossing", [k for k, _ in passed])
        located["crossing"] = ("where the curve crosses the line", [point for _, point in passed])
    for name in names:
        variables[name] = (*variables[name], _parameter(problem, name))
    for dimension, (where, points) in located.items():
        values = np.concatenate([problem.values(x.family, x.u) for x in points] or [np.zeros((0, 2))])
        for k, name in enumerate(names):
            if dimension == "crossing" and spec.at is not None and spec.at[0] == name:
                values[:, k] = spec.at[1]
            about = _parameter(problem, name)
            about["long_name"] += f" {where}"
            variables[f"{dimension}_{name}"] = (dimension, values[:, k], about)
    schema = VARIABLES | OF_CURVES | measured_besides(problem.scene) | of_orbits(problem.scene)
    table = described(variables, schema)
    table["kind"][-1].update(flag_values=np.arange(len(kinds), dtype=np.int8), flag_meanings=" ".join(kinds))
    # The parameters in which the families of the curves differ.
    coordinates = {
        name: ("curve", problem.parameters[name][[curve.number for curve in curves]], _parameter(problem, name))
        for name in family_coordinates(spec.family, "special")
        if name in spec.parameters and name != spec.by
    }
    scene, fixed = str(spec.family.attrs["scene"]), parameters_of(spec.family)
    fixed = {name: x for name, x in fixed.items() if name != spec.by}
    orbits = {
        "states": list(problem.scene.return_states),
        "tolerance": FAMILY_ACCURACY.tolerance,
        "accepted_residual": CORRECTOR_RESIDUAL,
    }
    symbols = " and ".join(_parameter(problem, name)["symbol"] for name in (spec.along, spec.by))
    title = f"Curves of special points of {scene} over {symbols}"
    attributes = {
        **dataset_attributes("curves", title, "curves", scene=scene),
        **spec.options,
        **attributes_of_parameters(spec.scene, fixed),
        "axes": [spec.along, spec.by],
        "bounds": [*spec.first_span, *spec.span],
        "orbits": json.dumps(orbits),
    }
    ds = xr.Dataset(table, coordinates, attributes)
    if any(problem.kinds[curve.number] == "stick" for curve in curves):
        for name in ("multiplier_abs", "multiplier_arg"):
            ds[name].attrs["comment"] = ONE_SIDED
    return ds


def _points(problem: CurveProblem, curves: list[Curve]) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Return the columns of the points of all curves, and the curve of each point."""
    none = problem.evaluate(np.zeros(1, int), np.zeros((1, problem.rows + 2))).of(slice(0))
    parts, number = [none], [np.zeros(0, int)]
    for index, curve in enumerate(curves):
        before = none
        for part in (part for part in curve.parts if len(part.u)):
            joins = len(before.u) > 0 and before.u.shape[1] == part.u.shape[1]
            part = part.of(slice(joins and bool(np.abs(before.u[-1] - part.u[0]).max() < SAME_ACROSS), None))
            before = part if len(part.u) else before
            parts.append(part)
            number.append(np.full(len(part.u), index))
    return columns(problem, parts), np.concatenate(number)


def _parameter(problem: CurveProblem, name: str) -> dict[str, str]:
    parameter = problem.scene.parameters()[name]
    return {"units": parameter.unit, "long_name": parameter.long_name, "symbol": parameter.symbol}

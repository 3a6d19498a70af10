"""Continuation of families of periodic orbits along one parameter: `follow`."""

import json
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from vibrojax.analyses.continuation.families import FamilyContinuation
from vibrojax.analyses.continuation.problem import CORRECTOR_RESIDUAL, FAMILY_ACCURACY, Problem
from vibrojax.analyses.continuation.segments import FamilyPoint, columns, in_order, measured
from vibrojax.analyses.sweep.run import run_sweep
from vibrojax.errors import Place, shown
from vibrojax.io.kinds import OF_FAMILIES, SPECIAL_KINDS
from vibrojax.io.variables import ORBIT_REASONS, REASONS, VARIABLES
from vibrojax.measures.labels import REGIMES
from vibrojax.measures.ledger import MOST_CYCLES
from vibrojax.models.physics.meanings import suggest_parameter
from vibrojax.models.physics.parameters import FREQUENCIES, REPLACED, ROTATION, not_negative, positive
from vibrojax.models.scenes import HasImpacts, Scene
from vibrojax.periodic.lane_orbits import known_orbits
from vibrojax.periodic.margin import HOW
from vibrojax.sweep.engine.labelled import measured_besides, of_orbits, parameter_attributes, shared_attributes
from vibrojax.sweep.input.definition import Sweep, resolved
from vibrojax.sweep.input.names import Names, read_names
from vibrojax.sweep.input.read import read_point, read_sweep, several_and_single
from vibrojax.sweep.input.values import UnusualValue, quantity, warn_if_far

UNITS_PER_SPAN = 8
"""Number of units of the scaled parameter between its bounds, which weights parameter steps against state steps."""

SETTLE = not_negative("settle", 40.0, "s", "time for which motions settle", "settle")
OBSERVE = positive("observe", 8.0, "s", "time for which they are then observed", "observe")


def follow(
    scene: str | Scene[Any],
    *,
    along: str,
    at: float,
    span: tuple[float, float],
    start: str | Sequence[float] | None = None,
    settle: float | None = None,
    observe: float | None = None,
    cycles: int = MOST_CYCLES,
    progress: bool = True,
    **parameters: Any,
) -> xr.Dataset:
    """Continue a family of stable and unstable periodic orbits along one parameter, and locate its special points.

        fam = vj.follow("vibro-impact", along="gamma", at=0.75, span=(0.3, 1.6), start="stuck", beta=0.4)

    The family begins with the orbit on which the motion at `along` = `at` settles. Pseudo-arclength continuation
    follows the family in both directions. It passes folds, and corners where an impact or a stick phase begins or
    vanishes. At period doublings it also follows the branches with twice the period. Changes in the order of events are
    handled automatically.

    **Arguments:**

    - `scene`: name of a scene, or a scene; `parameters`: any of its parameters (SI), as in `simulate`. One or several
      may be sequences of the same length; then one family per element is continued, along the dimension `family`.
    - `along`: name of the continuation parameter; `at`: its value at the first orbit; `span`: its lower and upper
      bound, which enclose `at`.
    - `start`: initial condition of the motion that settles on the first orbit, by default the scene's first.
    - `settle` [s]: settling time; `observe` [s]: duration of the observation, which must cover nine section crossings.
      The defaults are the scene's, as in a sweep.
    - `cycles`: largest number of section crossings per period of doubled branches, 1 to 8; 1 excludes such branches.
    - `progress`: True to report progress on stderr.

    **Returns:** a dataset.

    - Along `point`: the parameter, `branch` (0 is the first branch), `stable`, `multiplier_abs` and `multiplier_arg`
      [rad] along `multiplier`, and `grazing_margin`. `cycles` is the number of section crossings per period of the
      motion, `period` [s] the mean time between crossings, and `impacts` the number of impacts per period of the
      motion. Further variables are the state at the section (`orbit_x1` and so on) and the scene's measures.
    - Along `special`: `special_kind` (fold, period-doubling, torus, grazing, stick, section, hopf, end),
      `special_value` (the parameter's value), `special_branch`, and `special_note`.

    At a *grazing* point, an impact or another event that is not a stick begins or vanishes. For other events than
    impacts, the note contains the name of the mode that changes, for example where rock begins to yield. Multipliers at
    a special point are those on the side from which the point was reached, or of the side without the impact where only
    that side has orbits next to it; next to a grazing impact they are valid over a very small distance only. At a
    *hopf* point the amplitude is zero: the branch ends at an equilibrium, whose linear stability locates the point. A
    doubled branch that connects two period doublings is listed once.

    **Raises:** `InputError` for invalid names or values, or if the motion does not settle on a periodic orbit.

    **Example:**

    >>> point = {"beta": 0.4, "delta": 0.005, "start": "stuck"}
    >>> fam = vj.follow("vibro-impact", along="gamma", at=0.75, span=(0.7, 0.9), **point, progress=False)
    >>> kinds = fam.special_kind.attrs["flag_meanings"].split()
    >>> [(kinds[int(kind)], round(float(value), 3)) for kind, value in zip(fam.special_kind, fam.special_value)]
    [('end', 0.7), ('end', 0.9)]
    >>> bool((fam.stable == 1).all())
    True
    """
    return continue_families(family_spec(scene, along, at, span, start, settle, observe, cycles, parameters), progress)


@dataclass(frozen=True, eq=False)
class FamilySpec:
    """Families of one scene.

    - `sweep`: sweep with one initial parameter point for each family.
    - `along`: name of the continuation parameter; `low`, `high`: its bounds.
    - `cycles`: largest number of section crossings per period of doubled branches.
    """

    sweep: Sweep
    along: str
    low: float
    high: float
    cycles: int

    def identity(self) -> dict[str, object]:
        """Return all settings on which the result depends, as flat JSON values."""
        bounds = {"along": self.along, "from": self.low, "to": self.high, "cycles": self.cycles}
        return self.sweep.identity() | bounds


def family_spec(
    scene: str | Scene[Any],
    along: object,
    at: object,
    span: object,
    start: object,
    settle: object,
    observe: object,
    cycles: object,
    parameters: Mapping[str, object],
) -> FamilySpec:
    """Check the arguments of `follow` and return the specification.

    **Raises:** `InputError` with a one-line message at the first invalid argument.
    """
    place = Place("follow")
    several, fixed = several_and_single(parameters)
    names = read_names(place.at("scene"), scene, dict(fixed), place)
    if not isinstance(along, str) or along not in names.parameters:
        instead = suggest_parameter(str(along), names.parameters)
        if along in names.writable:  # rpm, bit_radius or a frequency
            given, replaced = "rpm and bit_radius" if along in ROTATION else along, REPLACED[along]
            instead = f"{replaced} follows from {given}: give {replaced}, and follow along {replaced}"
            if along in FREQUENCIES and isinstance(at, (int, float)):
                values = {name: parameter.default for name, parameter in names.parameters.items()}
                values |= {name: x for name, x in fixed.items() if isinstance(x, (int, float))}
                values = resolved(resolved(values) | {along: at})
                instead += f"; {at:g} Hz is {replaced}={values[replaced]:.6g}"
        raise place.at("along").error(f"{shown(along)} is not a parameter of the scene; {instead}")
    if along in parameters:
        hint = f"say where it begins by at={shown(fixed.get(along, 'VALUE'))}"
        raise place.at(along).error(f"is the parameter of the continuation; {hint}")
    for name in (name for name in FREQUENCIES if name in parameters and name not in names.parameters):
        if along in ("m1", "k1"):
            fault = f"fixes {REPLACED[name]} only at one {along}, and {along} varies along the family"
            raise place.at(name).error(f"{fault}; give {REPLACED[name]}")
    if isinstance(cycles, bool) or not isinstance(cycles, int) or not 1 <= cycles <= MOST_CYCLES:
        raise place.at("cycles").error(f"{shown(cycles)} is not a whole number from 1 to {MOST_CYCLES}")
    if not isinstance(span, Sequence | np.ndarray) or isinstance(span, str) or len(span) != 2:
        raise place.at("span").error(f"{shown(span)} is not a pair of numbers; give the bounds of {along}")
    low, high = sorted(names.quantity(place.at(name), along, span[k]) for k, name in enumerate(("from", "to")))
    if not low < high:
        raise place.at("to").error(f"{high:g} is the same as from; give the two bounds of {along}")
    begin = names.quantity(place.at("at"), along, at)
    if not low <= begin <= high:
        raise place.at("at").error(f"{begin:g} is not between from = {low:g} and to = {high:g}")
    usual = names.system.usual_times
    settled = quantity(place.at("settle"), usual[0] if settle is None else settle, SETTLE)
    observed = quantity(place.at("observe"), usual[1] if observe is None else observe, OBSERVE)
    families = _count_families(place, names, several)
    first = {name: column[0] for name, column in several.items()}
    with warnings.catch_warnings():  # all values are checked below
        warnings.simplefilter("ignore", UnusualValue)
        point = read_point(place, scene, {**fixed, **first, along: begin}, start)
    for name, value in {**fixed, **several, along: begin}.items():
        if name in names.writable:
            warn_if_far(place.at("at" if name == along else name), names.writable[name], value)
    tables: dict[str, Any] = {
        "scene": scene,
        "points": {along: [begin] * families} | several,
        "parameters": fixed,
        "run": {"orbits": True, "settle": settled, "observe": observed},
        "unusual": True,
    }
    if point.start is not None:
        tables["starts"] = [point.start if isinstance(point.start, str) else list(point.start)]
    return FamilySpec(read_sweep(tables), along, low, high, cycles)


def _count_families(place: Place, names: Names, several: Mapping[str, list[Any]]) -> int:
    """Check the values that differ between families, and return the number of families."""
    for name, column in several.items():
        if name in names.options:
            raise place.at(name).error(f"{shown(column)} is a list; it is chosen once for all families")
        if not column:
            raise place.at(name).error("is empty; give a value")
        for index, value in enumerate(column):
            item = place.at(name).item(index)
            if name in names.presets:
                names.preset(item, name, value)
            else:
                names.quantity(item, name, value)
    sizes = {name: len(column) for name, column in several.items()}
    if len(set(sizes.values())) > 1:
        lengths = ", ".join(f"{name} {size}" for name, size in sizes.items())
        raise place.error(f"lists of different lengths ({lengths}); give one family's values at the same place of each")
    return next(iter(sizes.values()), 1)


def continue_families(spec: FamilySpec, progress: bool = True) -> xr.Dataset:
    """Return the families of a specification, as `follow` does; raise `InputError` if there is no initial orbit."""
    dataset = run_sweep(spec.sweep, progress=progress)
    problem, families, first = problem_of(spec, dataset)
    points, special = in_order(FamilyContinuation(problem, cycles=spec.cycles)(families, first))
    return _dataset(spec.sweep, problem, points, special)


def problem_of(spec: FamilySpec, dataset: xr.Dataset) -> tuple[Problem, np.ndarray, list[np.ndarray]]:
    """Return the equations, the indices of families with an initial orbit, and the unknowns of these orbits.

    **Arguments:** `dataset`: result of the specified sweep.

    **Raises:** `InputError` if no family has an initial orbit.
    """
    sweep, along = spec.sweep, spec.along
    dataset = dataset.isel(start=0) if "start" in dataset.dims else dataset
    system = sweep.system.driving_part()
    values, _ = sweep.lane_values(0, sweep.lanes)
    parameters = {name: values[name].astype(float) for name in system.parameters()}
    known = known_orbits(system, dataset, parameters)
    families = known.lanes
    if not len(families):
        lane = dataset.isel(point=0)
        raise Place("follow").at("at").error(_no_orbit(lane, f"{along} = {float(lane[along]):g}"))
    scale = np.ones((sweep.lanes, len(system.return_states)))
    scale[families] = known.scales
    bounds = ((spec.high - spec.low) / UNITS_PER_SPAN, spec.low, spec.high)
    unit, first, last = (np.full(sweep.lanes, x) for x in bounds)
    problem = Problem(system, along, parameters, scale, unit, first, last, known.most_steps)
    unknowns = [
        problem.unknowns(families[[k]], states[None], parameters[along][families[[k]]])[0]
        for k, states in enumerate(known.states)
    ]
    return problem, families, unknowns


def _no_orbit(lane: xr.Dataset, where: str) -> str:
    """Return a message with the reason why there is no initial orbit, and a remedy."""
    reason = ORBIT_REASONS[int(lane["orbit_reason"])]
    if reason == "not-repeating":
        regime, settle = REGIMES[int(lane["regime"])], json.loads(str(lane.attrs["run"]))["settle"]
        return f"the motion at {where} does not repeat ({regime} after {settle:g} s); begin where it does"
    if reason == "refused":
        words = REASONS[int(lane["reason"])].replace("-", " ")
        return f"the motion at {where} cannot be run ({words}); begin elsewhere"
    words = reason.replace("-", " ")
    return f"the motion at {where} repeats, but its orbit is not known ({words}); begin elsewhere"


def _dataset(sweep: Sweep, problem: Problem, points: list[FamilyPoint], special: list[FamilyPoint]) -> xr.Dataset:
    table, at_special = columns(problem, points), columns(problem, special)
    along, system = problem.along, problem.scene
    schema = VARIABLES | OF_FAMILIES | measured_besides(sweep.system) | of_orbits(sweep.system)
    measures = {name: x for name, x in measured(sweep, problem, points, table).items() if name in schema}
    multipliers = {name: table.pop(name) for name in ("multiplier_abs", "multiplier_arg")}
    family, value = table.pop("family"), table.pop(along)
    values = table | measures | multipliers
    if not isinstance(system, HasImpacts):
        del values["impacts"]
    described = parameter_attributes(sweep, along)
    values |= {
        "special_kind": np.array([SPECIAL_KINDS.index(point.kind) for point in special], np.int8),
        "special_value": at_special[along],
        "special_branch": at_special["branch"],
        "special_note": np.array([point.note for point in special], str),
    }
    several = {name: x for name, x in (sweep.points or {}).items() if name != along}
    coordinates: dict[str, Any] = {}
    if several:
        values |= {"point_family": family, "special_family": at_special["family"]}
        coordinates["family"] = ("family", np.arange(sweep.lanes), schema["point_family"].attributes())
        for name, x in several.items():
            about = {"long_name": "rock"} if name == "rock" else parameter_attributes(sweep, name)
            coordinates[name] = ("family", x, about)
    variables: dict[str, Any] = {along: ("point", value, described)}
    for name, x in values.items():
        dims = ("special" if name.startswith("special_") else "point", "multiplier")[: x.ndim]
        variables[name] = (dims, np.asarray(x, schema[name].dtype), schema[name].attributes())
    at_point = {"long_name": f"{described['long_name']} at the special point"}
    variables["special_value"][-1].update(described | at_point)
    del variables["special_note"][-1]["units"]
    orbits = {
        "states": list(system.return_states),
        "tolerance": FAMILY_ACCURACY.tolerance,
        "accepted_residual": CORRECTOR_RESIDUAL,
        "grazing_margin": HOW,
    }
    title = f"Families of periodic orbits of {sweep.scene} over {along}"
    attributes = {
        **shared_attributes(sweep, "family", title, "follow"),
        "along": along,
        "span": [float(problem.first[0]), float(problem.last[0])],
        "parameters": json.dumps({name: x for name, x in sweep.parameters.items() if name != along}),
        "orbits": json.dumps(orbits),
    }
    if sweep.starts is not None:
        start = sweep.starts[0]
        attributes["start"] = start if isinstance(start, str) else json.dumps(start)
    return xr.Dataset(variables, coordinates, attributes)

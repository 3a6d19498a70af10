"""Input of `follow` (scene, parameter, bounds, and where families begin), and the dataset of families."""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from vibrojax.errors import Place, shown
from vibrojax.io.attributes import parameters_of, table_of, text_of
from vibrojax.io.dataset import open_dataset
from vibrojax.io.identity import IDENTITY, changes, identity_text
from vibrojax.io.kinds import OF_FAMILIES, SPECIAL_KINDS, kind_of
from vibrojax.io.variables import VARIABLES, Variable, described, orbit_name
from vibrojax.lanes.labels import measured_besides, of_orbits
from vibrojax.maps.dataset import parameter_attributes, shared_attributes
from vibrojax.maps.machines import read_machines, several_and_single
from vibrojax.maps.sweep import Sweep
from vibrojax.measures.ledger import MOST_CYCLES
from vibrojax.periodic.equilibrium_families import EquilibriumProblem
from vibrojax.periodic.flow_map import moving_names
from vibrojax.periodic.margin import HOW
from vibrojax.periodic.measuring import Measuring
from vibrojax.periodic.newton import multipliers
from vibrojax.periodic.problem import CORRECTOR_RESIDUAL, FAMILY_ACCURACY, Points, Problem, check_changes_orbits
from vibrojax.periodic.segments import Mark
from vibrojax.physics.meanings import suggest_parameter
from vibrojax.physics.parameters import FREQUENCIES, REPLACED, ROTATION, positive, resolved
from vibrojax.scenes import HasImpacts
from vibrojax.settings.code_identity import code_identity, is_code
from vibrojax.settings.names import Names, read_names
from vibrojax.settings.toml import plain
from vibrojax.settings.values import STATE, count, quantity, warn_if_far

TRACED_PERIODS = 2.5
"""Duration of the motion in which an orbit that is given is traced to the section, in its periods."""

SAME_HOPF = 1e-6
"""Difference of the parameter, relative to its span, up to which Hopf points are at the same value."""

_PERIOD = positive("period", 1.0, "s", "period of an orbit", "T")


class HopfPoint(NamedTuple):
    """A Hopf point of a family of equilibria: the parameter's `value`, the `states` there, and their `scales`."""

    value: float
    states: tuple[float, ...]
    scales: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class FamilySpec:
    """Families of one scene.

    - `sweep`: sweep with one initial parameter point for each family.
    - `along`: name of the continuation parameter; `low`, `high`: its bounds.
    - `cycles`: largest number of section crossings per period of doubled branches; 0 for equilibria.
    - `orbit`: states on the first orbit, in the order of a start, and its period [s]; None: it is not given.
    - `hopf`: points at which branches begin, if they are given.
    """

    sweep: Sweep
    along: str
    low: float
    high: float
    cycles: int
    orbit: tuple[list[float], float] | None = None
    hopf: tuple[HopfPoint, ...] = ()

    def identity(self) -> dict[str, object]:
        """Return all settings on which the result depends, as flat JSON values."""
        bounds: dict[str, object] = {"along": self.along, "from": self.low, "to": self.high, "cycles": self.cycles}
        if self.orbit is not None:
            bounds |= {"orbit": self.orbit[0], "orbit_period": self.orbit[1]}
        if self.hopf:
            bounds["from_hopf"] = [x for point in self.hopf for x in (point.value, *point.states)]
        return self.sweep.identity() | bounds


def family_spec(
    scene: object,
    along: object,
    at: object,
    span: object,
    begin: Mapping[str, object],
    settle: object,
    observe: object,
    cycles: object,
    parameters: Mapping[str, object],
) -> FamilySpec:
    """Check the arguments of `follow` and return the specification; `begin`: `start`, `orbit` and `from_hopf`.

    **Raises:** `InputError` with a one-line message at the first invalid argument.
    """
    place, start = Place("follow"), begin.get("start")
    hopf: tuple[HopfPoint, ...] = ()
    ways = [name for name in ("start", "orbit", "from_hopf") if begin.get(name) is not None]
    if len(ways) > 1:
        raise place.at(ways[1]).error(f"and {ways[0]} both say where the family begins; give one of them")
    if ways == ["from_hopf"]:
        family, points = read_hopf(place.at("from_hopf"), begin["from_hopf"])
        hopf, own = tuple(points), family_arguments(place.at("from_hopf"), family, scene, parameters)
        parameters, along = own | dict(parameters), family.attrs["along"] if along is None else along
        if along != family.attrs["along"]:
            raise place.at("along").error(f"{shown(along)} is not {family.attrs['along']}, along which the family is")
        span = family.attrs["span"] if span is None else span
    for name, value in (("along", along), ("at", at), ("span", span)):
        if value is None and not (hopf and name == "at"):
            raise place.error(f"{name} is missing")
    fixed = several_and_single(parameters)[1]
    names = read_names(place.at("scene"), scene, dict(fixed), place)
    if hopf:
        check_same_code(place.at("from_hopf"), family, names)
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
    check_changes_orbits(place.at("along"), names.system, along)
    if along in parameters:
        hint = f"say where it begins by at={shown(fixed.get(along, 'VALUE'))}"
        raise place.at(along).error(f"is the parameter of the continuation; {hint}")
    for name in (name for name in FREQUENCIES if name in parameters and name not in names.parameters):
        if along in ("m1", "k1"):
            fault = f"fixes {REPLACED[name]} only at one {along}, and {along} varies along the family"
            raise place.at(name).error(f"{fault}; give {REPLACED[name]}")
    low, high = read_span(place, names, along, span)
    if hopf:
        near = SAME_HOPF * (high - low)
        inside = tuple(point for point in hopf if low - near <= point.value <= high + near)
        if not inside:
            known = ", ".join(f"{point.value:.9g}" for point in hopf)
            raise place.at("from_hopf").error(f"the hopf points, at {along} = {known}, are outside the span")
        hopf, at = inside, float(np.clip(inside[0].value, low, high))
    first = names.quantity(place.at("at"), along, at)
    if not low <= first <= high:
        raise place.at("at").error(f"{first:g} is not between from = {low:g} and to = {high:g}")
    warn_if_far(place.at("at"), names.writable[along], first)
    most = count(place.at("cycles"), cycles, 0, MOST_CYCLES)
    has_orbits = most > 0 and bool(names.system.driving_part().return_states)
    run: dict[str, object] = {"orbits": has_orbits, "settle": settle, "observe": observe}
    orbit = read_orbit(place.at("orbit"), names, begin["orbit"]) if ways == ["orbit"] else None
    if orbit is not None:
        start, period = orbit
        run |= {"settle": 0.0, "observe": TRACED_PERIODS * period, "keep_returns": MOST_CYCLES}
    if ways in (["orbit"], ["from_hopf"]):
        if most == 0:
            raise place.at("cycles").error(f"0 stands for equilibria, which {ways[0]} does not begin; give start")
        if several_and_single(parameters)[0]:
            raise place.at(ways[0]).error("begins one family; give single values")
    machines = read_machines(place, scene, parameters, start, run, {along: first})
    return FamilySpec(machines.sweep, along, low, high, most, orbit, hopf)


def read_span(place: Place, names: Names, name: str, span: object) -> tuple[float, float]:
    """Return the lower and the upper bound of a parameter, in order."""
    ends = list(span) if isinstance(span, Iterable) and not isinstance(span, str | Mapping) else []
    if len(ends) != 2:
        raise place.at("span").error(f"{shown(span)} is not a pair of numbers; give the bounds of {name}")
    low, high = sorted(names.quantity(place.at(end), name, x) for end, x in zip(("from", "to"), ends, strict=True))
    if not low < high:
        raise place.at("to").error(f"{high:g} is the same as from; give the two bounds of {name}")
    return low, high


def read_orbit(place: Place, names: Names, orbit: object) -> tuple[list[float], float]:
    """Check the argument `orbit` of `follow`; return states and period."""
    if not isinstance(orbit, Mapping) or set(orbit) != {"states", "period"}:
        raise place.error(f'{shown(orbit)} is not {{"states": [...], "period": ...}}')
    here, there, order = place.at("states"), place.at("period"), list(names.system.start_states)
    given = plain(here, orbit["states"])
    if isinstance(given, dict):
        if set(given) != set(order):
            raise here.error(f"names {', '.join(given)}; the states are {', '.join(order)}")
        given = [given[name] for name in order]
    if not isinstance(given, list) or len(given) != len(order):
        raise here.error(f"{shown(given)} is not {len(order)} numbers: {', '.join(order)}")
    states = [quantity(here.item(k), value, STATE) for k, value in enumerate(given)]
    return states, quantity(there, plain(there, orbit["period"]), _PERIOD)


def read_hopf(place: Place, family: object) -> tuple[xr.Dataset, list[HopfPoint]]:
    """Check the argument `from_hopf` of `follow`; return the family of equilibria, and its Hopf points."""
    if isinstance(family, str | PathLike):
        family = open_dataset(Path(family))
    if not isinstance(family, xr.Dataset) or kind_of(family) != "family" or "eigenvalue_re" not in family:
        raise place.error("is not a family of equilibria; give what follow(..., cycles=0) has made")
    if "family" in family.dims:
        raise place.error("holds several families; select one with isel(family=...)")
    along = text_of(family, "along")
    states = [str(name) for name in family.data_vars if str(name).startswith("orbit_")]
    columns = np.column_stack([family[name].values for name in states])
    size = np.maximum(np.abs(columns).max(axis=0), np.ptp(columns, axis=0))
    size = np.where(size > 1e-3 * size.max(), size, size.max() or 1.0)
    kinds = str(family["special_kind"].attrs["flag_meanings"]).split()
    hopf = family["special_kind"].values == kinds.index("hopf") if "hopf" in kinds else np.zeros(0, bool)
    eigenvalues = family["eigenvalue_re"].values + 1j * family["eigenvalue_im"].values
    growth = np.where(eigenvalues.imag > 0, np.abs(eigenvalues.real), np.inf).min(axis=1)
    points, taken = [], np.zeros(len(growth), bool)
    for value, branch in zip(family["special_value"].values[hopf], family["special_branch"].values[hopf], strict=True):
        off = np.where((family["branch"].values == branch) & ~taken, np.abs(family[along].values - value), np.inf)
        # Mirror images have hopf points at the same value.
        nearest = min(np.flatnonzero(off == off.min()).tolist(), key=growth.__getitem__)
        taken[nearest] = True
        points.append(HopfPoint(float(value), tuple(columns[nearest].tolist()), tuple(size.tolist())))
    if not points:
        raise place.error("the family has no hopf point; follow it further")
    return family, points


def check_same_code(place: Place, family: xr.Dataset, names: Names) -> None:
    """Raise `InputError` if the scene of the user's own to which a family belongs is now defined in another way."""
    before = {name: x for name, x in table_of(family, IDENTITY).items() if is_code(name) and name != "code.method"}
    if before and (differing := changes(before, code_identity(names.system, names.options))):
        raise place.error(f"the scene of the family has changed: {differing}; follow the family again")


def family_arguments(place: Place, family: xr.Dataset, scene: object, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arguments of `follow` that a family of equilibria fixes: the parameters, `along` and `span`."""
    name = scene if isinstance(scene, str) else getattr(scene, "name", scene)
    if name != text_of(family, "scene"):
        raise place.error(f"is a family of {text_of(family, 'scene')}, not of {name}")
    fixed = dict(parameters_of(family))
    for parameter, value in given.items():
        if parameter in fixed and value != fixed[parameter]:
            raise place.at(parameter).error(f"the family is at {fixed[parameter]:g}, not {value}; leave it out")
    return fixed


STEPS_PER_RETURN = 60.0
"""Approximate number of steps between two section crossings; lanes with similar numbers of steps are batched."""

ORBIT_FEATURES = frozenset({"period", "cycles", "impacts", "returns", "settling_time", "trend", "steps"})
"""Features that follow from the orbit itself, or that have no meaning for an orbit."""

Table = dict[str, np.ndarray]


def columns(problem: Problem, parts: Sequence[Points]) -> Table:
    """Return the values of the orbits of all parts by variable name, each (points,) or (points, multipliers)."""
    tables = []
    for points in parts:
        values, cycles = multipliers(points.product), points.times.shape[1]
        varied = problem.values(points.family, points.u).T
        states = problem.states(points.family, points.u)[:, 0].T
        tables.append(
            {
                **dict(zip(problem.along, varied, strict=True)),
                "period": points.period / cycles,
                "cycles": np.full(len(values), cycles),
                "impacts": points.impacts,
                **dict(zip(map(orbit_name, problem.scene.return_states), states, strict=True)),
                "multiplier_abs": np.abs(values),
                "multiplier_arg": np.abs(np.angle(values)),
            }
        )
    return {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}


def equilibrium_columns(problem: EquilibriumProblem, parts: Sequence[Points]) -> dict[str, np.ndarray]:
    """Return the values of equilibria by variable name."""
    points = Points.join(parts)
    eigenvalues, states = problem.eigenvalues(points), problem.states(points.family, points.u)[:, 0]
    return {
        problem.along[0]: problem.values(points.family, points.u)[:, 0],
        "period": np.full(len(states), np.nan),
        "cycles": np.zeros(len(states), int),
        **dict(zip(map(orbit_name, moving_names(problem.scene)), states.T, strict=True)),
        "eigenvalue_re": eigenvalues.real,
        "eigenvalue_im": eigenvalues.imag,
        "stable": (eigenvalues.real < 0).all(axis=1).astype(int),
    }


def families_dataset(sweep: Sweep, problem: Problem, points: list[Mark], special: list[Mark]) -> xr.Dataset:
    """Return the dataset of families from their points and special points."""
    [along], system = problem.along, problem.scene
    schema = VARIABLES | OF_FAMILIES | measured_besides(sweep.system) | of_orbits(sweep.system)
    family = np.array([point.orbit.family[0] for point in points], int)
    standing = isinstance(problem, EquilibriumProblem)
    if standing:
        rest = {orbit_name(x.name): Variable(x.unit, f"{x.long_name}, at the equilibrium") for x in sweep.system.states}
        stable = replace(schema["stable"], long_name="whether all eigenvalues have negative real parts")
        schema |= rest | {"stable": stable}
    orbits = [point.orbit for point in points]
    branch = np.array([point.branch for point in points], int)
    if isinstance(problem, EquilibriumProblem):
        values = equilibrium_columns(problem, orbits)
    else:
        values = columns(problem, orbits)
        modulus = values["multiplier_abs"]
        values |= {
            "branch": branch,
            "stable": np.where(np.isfinite(modulus).all(axis=1), modulus[:, 0] < 1, -1),
            "grazing_margin": np.array([point.orbit.margin[0] for point in points]),
        }
        measures = measured(sweep, problem, points, family, values)
        values |= {name: x for name, x in measures.items() if name in schema}
        if not isinstance(system, HasImpacts):
            del values["impacts"]
    kinds = (*SPECIAL_KINDS, *system.named_events)
    values |= {
        "branch": branch,
        "special_kind": np.array([kinds.index(point.event or point.kind) for point in special]),
        "special_value": np.array([problem.values(x.orbit.family, x.orbit.u)[0, 0] for x in special]),
        "special_branch": np.array([point.branch for point in special]),
        "special_note": np.array([point.note for point in special], str),
    }
    several = {name: x for name, x in (sweep.points or {}).items() if name != along}
    coordinates: dict[str, Any] = {}
    if several:
        values |= {"point_family": family, "special_family": np.array([x.orbit.family[0] for x in special])}
        coordinates["family"] = ("family", np.arange(sweep.lanes), schema["point_family"].attributes())
        for name, x in several.items():
            about = {"long_name": "rock"} if name == "rock" else parameter_attributes(sweep, name)
            coordinates[name] = ("family", x, about)
    about = parameter_attributes(sweep, along)
    table: dict[str, Any] = {along: ("point", values.pop(along), about)}
    for name, x in values.items():
        every = "eigenvalue" if standing else "multiplier"
        table[name] = (("special" if name.startswith("special_") else "point", every)[: x.ndim], x)
    variables = described(table, schema)
    flags = {"flag_values": np.arange(len(kinds), dtype=np.int8), "flag_meanings": " ".join(kinds)}
    variables["special_kind"][-1].update(flags)
    variables["special_value"][-1].update(about | {"long_name": f"{about['long_name']} at the special point"})
    about_orbits = {
        "states": moving_names(system) if standing else list(system.return_states),
        "tolerance": FAMILY_ACCURACY.tolerance,
    }
    about_orbits |= {"accepted_residual": CORRECTOR_RESIDUAL, "grazing_margin": HOW}
    what = "equilibria" if standing else "periodic orbits"
    title = f"Families of {what} of {sweep.scene} over {about.get('symbol', along)}"
    attributes = {
        **shared_attributes(sweep, "family", title, "follow"),
        **({IDENTITY: identity_text(sweep.identity())} if code_identity(sweep.system, sweep.options) else {}),
        "along": along,
        "span": [float(problem.first[0, 0]), float(problem.last[0, 0])],
        "parameters": json.dumps({name: x for name, x in sweep.parameters.items() if name != along}),
        "orbits": json.dumps(about_orbits),
    }
    if sweep.starts is not None:
        start = sweep.starts[0]
        attributes["start"] = start if isinstance(start, str) else json.dumps(start)
    return xr.Dataset(variables, coordinates, attributes)


def measured(sweep: Sweep, problem: Problem, points: list[Mark], family: np.ndarray, table: Table) -> Table:
    """Return the measured features of the points by name, each (points,); NaN where the measurement failed.

    **Arguments:** `sweep`: sweep with one point for each family, with all parameters except the continuation parameter;
    `family`: family of each point; `table`: see `columns`.
    """
    [along] = problem.along
    fixed = {name: x[family] for name, x in (sweep.points or {}).items()}
    run = replace(sweep.run, orbits=False, keep_returns=0)
    lanes = replace(sweep, points=fixed | {along: table[along]}, run=run)
    measure, inputs = Measuring(lanes.system, lanes.run, lanes.start_names), lanes.inputs()
    measures: Table = {}
    for cycles in sorted(set(table["cycles"].tolist())):
        own = (k for k, point in enumerate(points) if table["cycles"][k] == cycles and point.kind != "hopf")
        subset = np.array([k for k in own if np.isfinite(points[k].orbit.u).all()], int)
        if not len(subset):
            continue
        states = problem.states(family[subset], np.concatenate([points[k].orbit.u for k in subset]))
        times = np.concatenate([points[k].orbit.times for k in subset])
        steps = np.full(len(subset), float(STEPS_PER_RETURN * cycles))
        features, whole = measure(inputs, subset, states, times, steps)
        for name, x in features.items():
            if x.ndim == 1 and x.dtype.kind == "f" and name not in ORBIT_FEATURES:
                measures.setdefault(name, np.full(len(points), np.nan))[subset] = np.where(whole, x, np.nan)
    swings = {swing.amplitude for swing in problem.scene.section.swings} if problem.scene.section else set()
    for name in swings & set(measures):
        measures[name][[point.kind == "hopf" for point in points]] = 0.0
    return measures

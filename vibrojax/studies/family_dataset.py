"""The dataset of families: columns of their points, measures on the orbits, and attributes."""

import json
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr

from vibrojax.io.kinds import OF_FAMILIES, SPECIAL_KINDS
from vibrojax.io.variables import VARIABLES, Variable, described, orbit_name
from vibrojax.lanes.labels import measured_besides, of_orbits
from vibrojax.maps.dataset import parameter_attributes, shared_attributes
from vibrojax.maps.sweep import Sweep
from vibrojax.periodic.equilibrium_families import EquilibriumProblem
from vibrojax.periodic.flow_map import moving_names
from vibrojax.periodic.margin import HOW
from vibrojax.periodic.measuring import Measuring
from vibrojax.periodic.newton import multipliers
from vibrojax.periodic.problem import CORRECTOR_RESIDUAL, FAMILY_ACCURACY, Points, Problem
from vibrojax.periodic.segments import Mark
from vibrojax.scenes import HasImpacts

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

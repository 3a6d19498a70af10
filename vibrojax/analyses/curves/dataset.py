"""The dataset of curves: its variables with units and meanings, and its attributes."""

import json
from typing import Any

import numpy as np
import xarray as xr

from vibrojax.analyses.continuation.problem import CORRECTOR_RESIDUAL, FAMILY_ACCURACY, Points
from vibrojax.analyses.curves.extended import CurveProblem
from vibrojax.analyses.curves.following import Curve, crossings
from vibrojax.analyses.curves.spec import CurvesSpec
from vibrojax.io.attributes import parameters_of
from vibrojax.io.kinds import OF_CURVES, SPECIAL_KINDS, dataset_attributes
from vibrojax.io.variables import VARIABLES, orbit_name
from vibrojax.models.physics.parameters import differing
from vibrojax.periodic.newton import multipliers
from vibrojax.sweep.engine.labelled import of_orbits

SAME_ACROSS = 1e-9
"""Scaled distance between two parts of a curve within which their end points are one point."""


def curves_dataset(spec: CurvesSpec, problem: CurveProblem, curves: list[Curve]) -> xr.Dataset:
    """Return the dataset of curves."""
    names = (spec.along, spec.by)
    table, number = _points(problem, curves)
    schema = VARIABLES | OF_CURVES | of_orbits(problem.scene)
    variables: dict[str, Any] = {
        "point_curve": ("point", number),
        **{name: (("point", "multiplier")[: x.ndim], x) for name, x in table.items()},
        "kind": ("curve", np.array([SPECIAL_KINDS.index(problem.kinds[curve.number]) for curve in curves], int)),
        "special": ("curve", np.array([curve.special for curve in curves], int)),
        "curve_note": ("curve", np.array(["; ".join(curve.notes) for curve in curves], str)),
        "codim2_kind": ("codim2", np.array([mark.name for curve in curves for mark in curve.marks], str)),
        "codim2_curve": ("codim2", np.array([k for k, curve in enumerate(curves) for _ in curve.marks], int)),
    }
    located = {"codim2": [mark.point for curve in curves for mark in curve.marks]}
    if spec.at is not None:
        passed = [(k, point) for k, curve in enumerate(curves) for point in _crossings(problem, curve, spec.at, names)]
        variables["crossing_curve"] = ("crossing", np.array([k for k, _ in passed], int))
        located["crossing"] = [point for _, point in passed]
    described = {
        name: (dims, np.asarray(x, schema[name].dtype), schema[name].attributes()) if name in schema else (dims, x)
        for name, (dims, x) in variables.items()
    }
    about = {name: _parameter(problem, name) for name in names}
    for name in names:
        described[name] = ("point", variables[name][1], about[name])
    for dimension, points in located.items():
        values = _values(problem, points)
        for k, name in enumerate(names):
            if dimension == "crossing" and spec.at is not None and spec.at[0] == name:
                values[:, k] = spec.at[1]
            where = "where the curve crosses the line" if dimension == "crossing" else "at the point"
            meaning = {"long_name": f"{about[name]['long_name']} {where}"}
            described[f"{dimension}_{name}"] = (dimension, values[:, k], about[name] | meaning)
    for name in ("curve_note", "codim2_kind"):
        described[name][-1].pop("units")
    return xr.Dataset(described, _coordinates(spec, problem, curves), _attributes(spec, problem))


def _coordinates(spec: CurvesSpec, problem: CurveProblem, curves: list[Curve]) -> dict[str, Any]:
    """Return the parameters in which the families of the curves differ."""
    number = [curve.number for curve in curves]
    several = [str(name) for name, data in spec.family.coords.items() if data.dims == ("family",) and name != "family"]
    return {
        name: ("curve", problem.parameters[name][number], _parameter(problem, name))
        for name in several
        if name in spec.parameters and name != spec.by
    }


def _values(problem: CurveProblem, points: list[Points]) -> np.ndarray:
    return np.concatenate([problem.values(x.family, x.u) for x in points] or [np.zeros((0, 2))])


def _points(problem: CurveProblem, curves: list[Curve]) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Return the columns of the points of all curves, and the curve of each point."""
    columns: dict[str, list[np.ndarray]] = {}
    number = []
    for index, curve in enumerate(curves):
        before: Points | None = None
        for part in curve.parts:
            joins = before is not None and len(part.u) > 0 and before.u.shape[1] == part.u.shape[1]
            same = joins and np.abs(before.u[-1] - part.u[0]).max() < SAME_ACROSS if before is not None else False
            part = part.of(slice(1, None)) if same else part
            before = part if len(part.u) else before
            number += [index] * len(part.u)
            for name, x in _columns(problem, part).items():
                columns.setdefault(name, []).append(x)
    if not columns:
        return {name: x[:0] for name, x in _columns(problem, _none(problem)).items()}, np.zeros(0, int)
    return {name: np.concatenate(x) for name, x in columns.items()}, np.array(number, int)


def _none(problem: CurveProblem) -> Points:
    u = np.zeros((1, problem.rows + 2))
    return problem.evaluate(np.zeros(1, int), u)


def _columns(problem: CurveProblem, points: Points) -> dict[str, np.ndarray]:
    values = multipliers(points.product)
    states = problem.states(points.family, points.u)[:, 0]
    parameters = problem.values(points.family, points.u).T
    return {
        problem.other: parameters[0],
        problem.along: parameters[1],
        "cycles": np.full(len(points.u), points.times.shape[1]),
        "period": points.period / points.times.shape[1],
        "impacts": points.impacts,
        **dict(zip(map(orbit_name, problem.scene.return_states), states.T, strict=True)),
        "multiplier_abs": np.abs(values),
        "multiplier_arg": np.abs(np.angle(values)),
    }


def _crossings(problem: CurveProblem, curve: Curve, at: tuple[str, float], names: tuple[str, str]) -> list[Points]:
    with np.errstate(all="ignore"):
        return [x for part in curve.parts for x in crossings(problem, part, names.index(at[0]), at[1])]


def _parameter(problem: CurveProblem, name: str) -> dict[str, str]:
    parameter = problem.scene.parameters()[name]
    return {"units": parameter.unit, "long_name": parameter.long_name}


def _attributes(spec: CurvesSpec, problem: CurveProblem) -> dict[str, Any]:
    scene = str(spec.family.attrs["scene"])
    fixed = {name: x for name, x in parameters_of(spec.family).items() if name != spec.by}
    title = f"Curves of special points of {scene} over {spec.along} and {spec.by}"
    orbits = {
        "states": list(problem.scene.return_states),
        "tolerance": FAMILY_ACCURACY.tolerance,
        "accepted_residual": CORRECTOR_RESIDUAL,
    }
    return {
        **dataset_attributes("curves", title, "curves", scene=scene),
        **spec.options,
        "parameters": json.dumps(fixed),
        "differing": json.dumps(differing(spec.scene.parameters(), fixed)),
        "axes": [spec.along, spec.by],
        "bounds": [*spec.first_span, *spec.span],
        "orbits": json.dumps(orbits),
    }

"""The dataset of curves: its variables with units and meanings, and its attributes."""

import json
from typing import Any

import numpy as np
import xarray as xr

from vibrojax.io.attributes import parameters_of
from vibrojax.io.kinds import OF_CURVES, SPECIAL_KINDS, dataset_attributes
from vibrojax.io.variables import VARIABLES, described
from vibrojax.lanes.labels import measured_besides, of_orbits
from vibrojax.periodic.curve_equations import CurveProblem
from vibrojax.periodic.curve_following import Curve, crossings
from vibrojax.periodic.problem import CORRECTOR_RESIDUAL, FAMILY_ACCURACY, Points
from vibrojax.physics.parameters import differing
from vibrojax.pictures.branches import family_coordinates, kind_names
from vibrojax.studies.curve_spec import CurvesSpec
from vibrojax.studies.family_dataset import columns

ONE_SIDED = "on stick curves, the return map has a kink, and these are the multipliers of one side of it"
"""Comment of the multipliers in a dataset with stick curves."""

SAME_ACROSS = 1e-9
"""Scaled distance between two parts of a curve within which their end points are one point."""


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
        passed = [(k, point) for k, curve in enumerate(curves) for point in _crossings(problem, curve, spec.at)]
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
    ds = xr.Dataset(table, _coordinates(spec, problem, curves), _attributes(spec, problem))
    if any(problem.kinds[curve.number] == "stick" for curve in curves):
        for name in ("multiplier_abs", "multiplier_arg"):
            ds[name].attrs["comment"] = ONE_SIDED
    return ds


def _coordinates(spec: CurvesSpec, problem: CurveProblem, curves: list[Curve]) -> dict[str, Any]:
    """Return the parameters in which the families of the curves differ."""
    number = [curve.number for curve in curves]
    return {
        name: ("curve", problem.parameters[name][number], _parameter(problem, name))
        for name in family_coordinates(spec.family, "special")
        if name in spec.parameters and name != spec.by
    }


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


def _crossings(problem: CurveProblem, curve: Curve, at: tuple[str, float]) -> list[Points]:
    with np.errstate(all="ignore"):
        return [x for part in curve.parts for x in crossings(problem, part, problem.along.index(at[0]), at[1])]


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

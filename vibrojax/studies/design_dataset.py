"""The dataset of a design."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from vibrojax.io.kinds import dataset_attributes
from vibrojax.io.variables import VARIABLES, Variable
from vibrojax.measures.labels import REGIMES, UNBOUNDED
from vibrojax.studies.design_conditions import Conditions, limit_names, limit_values
from vibrojax.studies.design_evaluation import Assessment, CoarseMap, Simulator, extreme
from vibrojax.studies.design_search import Candidate
from vibrojax.studies.design_spec import DesignSpec

_YES_NO = ("no", "yes")

DESIGN_VARIABLES = {
    "share": Variable("1", "share of the starts from which all requirements hold at the nominal point"),
    "share_worst": Variable("1", "least such share at the samples of the tolerances"),
    "feasible": Variable("1", "whether all requirements hold at the samples of the tolerances", np.int8, _YES_NO),
    "irregular_share": Variable("1", "share of the lanes of the samples that are irregular, undecided or failed"),
    "gradient": Variable("", "derivative of the objective at the nominal orbit, in its unit per the parameter's"),
    "limit_value": Variable("", "value of the limit, in the unit of its variable"),
    "slack": Variable("", "least distance to the limit at the samples of the tolerances, in its unit"),
    "binds": Variable("1", "whether the limit binds", np.int8, _YES_NO),
    "relaxation": Variable("", "gain of the objective per unit by which the limit is relaxed"),
    "unexplained": Variable("1", "share of the gradient that no limit balances; a border of the regime does"),
    "map_feasible": Variable("1", "whether all requirements hold at the nominal point", np.int8, _YES_NO),
    "front_feasible": Variable("1", "whether a feasible point was found", np.int8, _YES_NO),
}
"""Variables whose units do not depend on the design, unlike objective, subject, map and front."""


class Result(NamedTuple):
    """A verified candidate, assessed over all samples, and the conditions at its nominal point."""

    candidate: Candidate
    conditions: Conditions
    gradient: np.ndarray


class FrontPoint(NamedTuple):
    """A point of a front: its limit, the candidate, and its verification."""

    limit: float
    candidate: Candidate
    checked: Assessment


def _described(variable: Variable, values: Any, dims: Any) -> tuple[Any, ...]:
    attributes = {key: x for key, x in variable.attributes().items() if key != "units" or variable.units}
    return dims, np.asarray(values, variable.dtype), attributes


def _own(spec: DesignSpec, name: str, words: str = "{}") -> Variable:
    """Return the schema of a variable of the scene with another long name."""
    about = spec.variables[name]
    return Variable(about.units, words.format(about.long_name))


def _parameter(spec: DesignSpec, name: str) -> Variable:
    about = {**spec.template.system.parameters()}.get(name)
    return Variable("1", name) if about is None else Variable(about.unit, about.long_name)


def design_dataset(
    spec: DesignSpec, simulator: Simulator, coarse: CoarseMap, results: Sequence[Result], front: Sequence[FrontPoint]
) -> xr.Dataset:
    """Return the dataset of the candidates, best first, with the map and the front."""
    objective = spec.variables[spec.maximise]
    ends = {c.variable: c.end for c in spec.constraints}
    checked = [result.candidate.result for result in results]
    data: dict[str, Any] = {
        "objective": _described(
            Variable(objective.units, f"{objective.long_name} at the nominal point, worst over the starts"),
            [a.objective for a in checked], "candidate"),
        "objective_worst": _described(
            Variable(objective.units, f"least {objective.long_name} of the samples of the tolerances, from all starts"),
            [extreme(held(a, spec.maximise), "least") for a in checked], "candidate"),
    }  # fmt: skip
    for name, end in ends.items():
        extremes = {
            "": "at the nominal point, worst over the starts",
            "_worst": "worst of the samples of the tolerances",
        }
        for suffix, words in extremes.items():
            rows = slice(0, 1) if not suffix else slice(None)
            values = [extreme(held(a, name, rows), end) for a in checked]
            data[name + suffix] = _described(_own(spec, name, f"{{}}, {words}"), values, "candidate")
    if spec.regime is not None:
        flags = [a.lanes.dataset["regime"].values for a in checked]
        data["regime"] = _described(VARIABLES["regime"], [_other(spec, x[:1]) for x in flags], "candidate")
        about = Variable(
            "1", "first other regime at the samples of the tolerances, else that asked for", np.int8, REGIMES
        )
        data["regime_worst"] = _described(about, [_other(spec, x) for x in flags], "candidate")
    shares = np.array([[a.good[0].mean(), a.good.mean(axis=1).min()] for a in checked])
    limits = [result.conditions for result in results]
    table = {
        "share": ("candidate", shares[:, 0]),
        "share_worst": ("candidate", shares[:, 1]),
        "feasible": ("candidate", [a.feasible for a in checked]),
        "irregular_share": ("candidate", [_irregular(a) for a in checked]),
        "gradient": (("candidate", "parameter"), [result.gradient for result in results]),
        "limit_value": ("limit", limit_values(spec)),
        "slack": (("candidate", "limit"), [c.slack for c in limits]),
        "binds": (("candidate", "limit"), [c.binds for c in limits]),
        "relaxation": (("candidate", "limit"), [c.relaxation for c in limits]),
        "unexplained": ("candidate", [c.unexplained for c in limits]),
        "map_feasible": ("map", [a.feasible for a in coarse.assessments]),
    }
    data |= {name: _described(DESIGN_VARIABLES[name], values, dims) for name, (dims, values) in table.items()}
    data["map_objective"] = _described(
        Variable(objective.units, f"{objective.long_name} on the map, worst over the starts; NaN: not feasible"),
        [a.objective if a.feasible else np.nan for a in coarse.assessments], "map")  # fmt: skip
    coords: dict[str, Any] = {
        "parameter": ("parameter", list(spec.varied), {"long_name": "varied parameter"}),
        "limit": ("limit", limit_names(spec), {"long_name": "constraint, or bound of a varied parameter"}),
    }
    unit = np.array([result.candidate.point for result in results])
    for k, name in enumerate(spec.varied):
        about = _parameter(spec, name)
        coords[name] = _described(about, (spec.low + unit * (spec.high - spec.low))[:, k], "candidate")
        column = (spec.low + coarse.unit * (spec.high - spec.low))[:, k]
        coords[f"map_{name}"] = _described(about, column, "map")
    data |= _front_variables(spec, front)
    title = str(spec.tables.get("title") or f"Design of {spec.template.scene}: most {objective.long_name}")
    attributes = dataset_attributes(
        "design", title, "design", scene=spec.template.scene, design=spec.text,
        lanes=simulator.lanes, orbit_solves=simulator.orbits,
        maximise=spec.maximise, requirements=requirements(spec),
    )  # fmt: skip
    attributes |= {f"tolerance_{name}": width for name, width in spec.tolerances.items()}
    if spec.front is not None:
        attributes["against"] = spec.front.against
    return xr.Dataset(data, coords, attributes)


def requirements(spec: DesignSpec) -> str:
    """Return the subject of a design in one line of text."""
    words = [f"regime {spec.regime}"] if spec.regime else []
    words += [f"{c.variable} {c.end} {c.limit:g} {spec.variables[c.variable].units}" for c in spec.constraints]
    if spec.share is not None:
        words.append(f"share of starts {spec.share[0]:g} to {spec.share[1]:g}")
    words += [f"{name} +- {width:g}" for name, width in spec.tolerances.items()]
    return ", ".join(words) or "none"


def held(assessment: Assessment, name: str, rows: slice = slice(None)) -> np.ndarray:
    """Return a variable's values in the lanes of the regime, or in all lanes if none is in it."""
    values, fit = assessment.lanes.values[name][rows], assessment.lanes.in_regime[rows]
    return np.asarray(values[fit] if fit.any() else values)


def _irregular(assessment: Assessment) -> float:
    """Return the share of lanes whose extremes depend on the time of observation; 0 for scenes without regimes."""
    ds = assessment.lanes.dataset
    return float(np.isin(ds["regime"].values, UNBOUNDED).mean()) if "regime" in ds else 0.0


def _other(spec: DesignSpec, regimes: np.ndarray) -> int:
    """Return the first regime that is not the one asked for, or else that one."""
    required = REGIMES.index(str(spec.regime))
    others = regimes[regimes != required]
    return int(others.flat[0]) if others.size else required


def _front_variables(spec: DesignSpec, front: Sequence[FrontPoint]) -> dict[str, Any]:
    if spec.front is None or not front:
        return {}
    against, objective = spec.front.against, spec.variables[spec.maximise]
    known = [point.checked.feasible for point in front]

    def column(value: Any) -> list[float]:
        return [value(p) if ok else np.nan for p, ok in zip(front, known, strict=True)]

    data = {
        "front_limit": _described(
            Variable("1", "factor of the tolerances") if against == "tolerance" else _own(spec, against, "limit of {}"),
            [p.limit for p in front], "front"),
        "front_objective": _described(objective, column(lambda p: p.checked.objective), "front"),
        "front_objective_worst": _described(
            objective, column(lambda p: extreme(held(p.checked, spec.maximise), "least")), "front"),
        "front_feasible": _described(DESIGN_VARIABLES["front_feasible"], known, "front"),
    }  # fmt: skip
    if against != "tolerance":
        end = spec.front.end
        values = column(lambda p: extreme(held(p.checked, against, slice(0, 1)), end))
        data[f"front_{against}"] = _described(_own(spec, against), values, "front")
    for k, name in enumerate(spec.varied):
        unit = np.array(column(lambda p, k=k: p.candidate.point[k]))
        data[f"front_{name}"] = _described(
            _parameter(spec, name), spec.low[k] + unit * (spec.high[k] - spec.low[k]), "front"
        )
    return data

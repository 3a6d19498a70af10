"""The specification of a calibration: observations, unknown parameters with bounds and priors, and errors."""

from collections.abc import Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pandas as pd
from jaxtyping import Bool, Float

from vibrojax.errors import Place, counted, shown, suggestion
from vibrojax.io.log_columns import split_unit
from vibrojax.io.tables import column_numbers, read_table, rows_without_units
from vibrojax.io.variables import VARIABLES
from vibrojax.maps.bounds import read_bounds, read_specification
from vibrojax.maps.read import Point, read_point
from vibrojax.periodic.orbit_derivatives import orbit_variables
from vibrojax.physics.arrays import check_untraced
from vibrojax.physics.units import factor
from vibrojax.settings.names import Names
from vibrojax.settings.toml import read_source
from vibrojax.settings.values import as_table, choice, count, number

CONSTANT = "C"
"""Name of the coefficient of the law, which is no parameter of a scene: rate_of_penetration = C ln(relief)."""

RATE, RELIEF = "rate_of_penetration", "relief"

MAX_OBSERVATIONS = 10_000
"""Largest number of rows. Each is an orbit that is solved at every step of the search."""

DEFAULT_DRAWS, MAX_DRAWS = 1000, 1_000_000
DEFAULT_SEARCHES, MAX_SEARCHES = 3, 64

_KEYS = ("scene", "title", "data", "start", "unknown", "error", "prior", "parameters", "searches", "draws", "seed")
_EXAMPLE = "mu = [0.2, 0.6]"


@dataclass(frozen=True, eq=False)
class CalibrationSpec:
    """A checked calibration.

    - `scene`, `start`, `fixed`: scene, initial condition and fixed parameters, as in `simulate`.
    - `names`: the unknown parameters, `low` and `high` their bounds; `prior_mean` and `prior_error` along them, with an
      infinite error where there is no prior.
    - `conditions`: for each observation the parameters that differ between observations, by name.
    - `observed`: for each variable its values, NaN where there is none; `errors`: their standard errors, or None if the
      residuals shall give them.
    - `labels`: number of each observation's line in the file, or of its row.
    """

    title: str
    file: str
    text: str
    scene: Any
    start: Any
    fixed: dict[str, Any]
    point: Point
    names: tuple[str, ...]
    low: Float[np.ndarray, " unknown"]
    high: Float[np.ndarray, " unknown"]
    prior_mean: Float[np.ndarray, " unknown"]
    prior_error: Float[np.ndarray, " unknown"]
    conditions: dict[str, np.ndarray]
    observed: dict[str, np.ndarray]
    errors: dict[str, np.ndarray] | None
    labels: np.ndarray
    searches: int
    draws: int
    seed: int

    @property
    def values(self) -> Float[np.ndarray, "observations of"]:
        """Observations of all variables, NaN where there is none."""
        return np.stack([*self.observed.values()], axis=1)

    def shortage(self, used: Bool[np.ndarray, " observations"]) -> str:
        """Return why the observations `used` do not determine the unknowns with an error; empty if they do."""
        count = int(np.isfinite(self.values[used]).sum()) + int(np.isfinite(self.prior_error).sum())
        least = len(self.names) + (self.errors is None)
        if count >= least:
            return ""
        wanted = counted(len(self.names), "unknown parameter") + " and the size of the noise" * (self.errors is None)
        more = "give standard errors in [error], " if self.errors is None else "give a [prior], "
        return f"{counted(count, 'value')} for {wanted}; add rows or observed variables, {more}or leave an unknown out"

    def identity(self) -> dict[str, object]:
        """Return all settings on which the result depends, as flat JSON values."""
        tables = {f"data.{name}": x.tolist() for name, x in (self.conditions | self.observed).items()}
        return {"calibration": True, "specification": self.text} | tables


def read_calibration(source: str | PathLike[str] | Mapping[str, object]) -> CalibrationSpec:
    """Read and check a calibration from the path of a TOML file, or from a dict with the same structure.

    **Raises:** `InputError` with a one-line message at the first problem.
    """
    data = source.get("data") if isinstance(source, Mapping) else None
    if isinstance(source, Mapping) and not isinstance(data, (str, PathLike)):
        source = {key: x for key, x in source.items() if key != "data"}
    origin = read_source(source, "calibration")
    place, tables, fixed, names = read_specification(origin, _KEYS)
    unknown = dict(as_table(place.at("unknown"), tables.get("unknown", {})))
    if not unknown:
        raise place.at("unknown").error(f"missing, so there is nothing to calibrate; write one like {_EXAMPLE}")
    bounds = _read_unknown(place.at("unknown"), unknown, names, fixed)
    data = tables.get("data") if data is None else data
    columns, labels, file = _read_data(place.at("data"), data, origin.folder)
    variables = orbit_variables(names.system)
    conditions, observed = _split(file, columns, names, variables, (*bounds, *fixed))
    if CONSTANT in bounds:
        if RELIEF not in variables:
            raise (
                place.at("unknown")
                .at(CONSTANT)
                .error(f"scene {shown(names.scene)} has no relief; choose drilling, coupled-drilling or penetration")
            )
        if RATE not in observed:
            raise file.error(f"has no column {RATE}, which {CONSTANT} needs; add it")
    point = read_point(place.at("parameters"), tables["scene"], fixed, tables.get("start"))
    errors = _read_errors(place.at("error"), tables.get("error"), observed, columns)
    mean, width = _read_prior(place.at("prior"), tables.get("prior", {}), bounds)
    if errors is None and np.isfinite(width).any():
        raise place.at("prior").error("has no weight without standard errors of the observations; give [error]")
    if not {*bounds, *conditions} - {CONSTANT}:
        raise file.error(f"has no operating conditions, and only {CONSTANT} is unknown; use vibrojax fit")
    low, high = (np.array([pair[k] for pair in bounds.values()]) for k in (0, 1))
    spec = CalibrationSpec(
        title=str(tables.get("title") or f"Calibration of {', '.join(bounds)}"),
        file=origin.file,
        text=origin.text,
        scene=tables["scene"],
        start=tables.get("start"),
        fixed=fixed,
        point=point,
        names=tuple(bounds),
        low=low,
        high=high,
        prior_mean=mean,
        prior_error=width,
        conditions=conditions,
        observed=observed,
        errors=errors,
        labels=labels,
        searches=count(place.at("searches"), tables.get("searches", DEFAULT_SEARCHES), 1, MAX_SEARCHES),
        draws=count(place.at("draws"), tables.get("draws", DEFAULT_DRAWS), 2, MAX_DRAWS),
        seed=count(place.at("seed"), tables.get("seed", 0), 0),
    )
    if problem := spec.shortage(np.ones(len(labels), bool)):
        raise file.error(problem)
    return spec


def _read_unknown(
    place: Place, unknown: dict[str, Any], names: Names, fixed: Mapping[str, object]
) -> dict[str, tuple[float, float]]:
    """Return the bounds of the unknown parameters, and of the law's coefficient C [m/s], all positive."""
    own = unknown.pop(CONSTANT, None)
    for name in unknown:
        if name in names.writable and name not in names.parameters:
            choices = ", ".join(names.parameters)
            raise place.at(name).error(f"is not a parameter of the scene itself; choose from {choices}")
    bounds = read_bounds(place, unknown, names, fixed, unusual=True) if unknown else {}
    if own is not None:
        here = place.at(CONSTANT)
        if not isinstance(own, list) or len(own) != 2:
            raise here.error(f"{shown(own)} is not a pair of a least and a greatest value [m/s]; write [1e-4, 1e-2]")
        low, high = (number(here.item(k), end) for k, end in enumerate(own))
        if not 0 < low < high:
            raise here.error(f"{shown(own)} is no interval above 0")
        bounds[CONSTANT] = (low, high)
    return bounds


def _read_data(place: Place, data: object, folder: Path) -> tuple[dict[str, np.ndarray], np.ndarray, Place]:
    """Return the columns by header, the number of each row (in a file, of its line), and the place of the data."""
    if isinstance(data, (str, PathLike)):
        path = folder / data
        file = Place(str(path))
        line, header, others = read_table(
            path, "observation", "no rows; add a line for each observation", "v,period,impact_velocity"
        )
        if len(set(header)) != len(header):
            raise file.at(f"line {line}").error("has two columns of one name; give each column once")
        rows = rows_without_units(file, header, list(others))
        columns = {name: column_numbers(file, name, k, rows)[0] for k, name in enumerate(header)}
        return columns, np.array([k for k, _ in rows]), file
    if data is None:
        raise place.error('missing; give the path of a CSV file with the observations, like data = "runs.csv"')
    for name, column in data.items() if isinstance(data, Mapping) else ():
        for value in jax.tree.leaves(column):
            check_untraced(place.at(str(name)).error, value)
    try:
        frame = pd.DataFrame(data).reset_index(drop=True)
        columns = {str(name): frame[name].to_numpy(float) for name in frame.columns}
    except (TypeError, ValueError) as error:
        raise place.error(f"is not a table of numbers: {error}") from None
    if not len(frame):
        raise place.error("has no rows; give one for each observation")
    return columns, np.arange(len(frame)), place


def _split(
    file: Place, columns: Mapping[str, np.ndarray], names: Names, variables: tuple[str, ...], given: tuple[str, ...]
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Return the operating conditions and the observed variables among the columns, in SI units."""
    conditions: dict[str, np.ndarray] = {}
    observed: dict[str, np.ndarray] = {}
    for header, column in columns.items():
        name, unit = (header, None) if header in (*names.parameters, *variables) else split_unit(header)
        own, here = name in names.parameters, file.at(f"column {header}")
        if not own and name not in variables:
            if name.endswith("_error") and name.removesuffix("_error") in variables:
                continue
            known = (*names.parameters, *variables)
            hint = suggestion(name, known)
            raise here.error(f"is neither a parameter of the scene nor a variable of its orbits; {hint}")
        si = names.parameters[name].unit if own else VARIABLES[name].units
        scale = 1.0 if unit is None else factor(unit, si)
        if scale is None:
            raise here.error(f"is in {unit}, not a unit of {name} [{si}]")
        if name in given:
            raise here.error("is an unknown or a fixed parameter as well; give it in one of the two")
        if own and not np.isfinite(column).all():
            raise here.error("has an empty cell; every observation needs its operating conditions")
        if own:
            for value in column * scale:
                names.quantity(here, name, float(value))
        elif np.isinf(column).any() or not np.isfinite(column).any():
            problem = "an infinite value" if np.isinf(column).any() else "no number"
            raise here.error(f"has {problem}; leave a cell empty where there is no observation")
        (conditions if own else observed)[name] = column * scale
    size = len(next(iter(columns.values()), ()))
    if not observed:
        raise file.error(f"holds no observation; name a column after a variable, such as {', '.join(variables[:3])}")
    if size > MAX_OBSERVATIONS:
        raise file.error(f"holds {size} observations; {MAX_OBSERVATIONS} are the most")
    return conditions, observed


def _read_errors(
    place: Place, value: object, observed: Mapping[str, np.ndarray], columns: Mapping[str, np.ndarray]
) -> dict[str, np.ndarray] | None:
    """Return the standard error of each observation; None if neither the file nor the specification gives errors."""
    table = as_table(place, {} if value is None else value)
    for name in table:
        choice(place, name, tuple(observed))
    errors = {}
    for name, x in observed.items():
        own = columns.get(f"{name}_error")
        if own is None and name not in table:
            continue
        errors[name] = np.broadcast_to(number(place.at(name), table[name]), x.shape) if own is None else own
        if not (errors[name][np.isfinite(x)] > 0).all():
            raise place.at(name).error("is not above 0 for every observation; give its standard error in SI units")
    if errors and (missing := sorted(observed.keys() - errors.keys())):
        raise place.at(missing[0]).error("missing; give the standard error of every observed variable, or of none")
    return errors or None


def _read_prior(
    place: Place, value: object, bounds: Mapping[str, tuple[float, float]]
) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and standard deviation of the normal prior of each unknown; infinite without one."""
    table = as_table(place, value)
    mean, error = np.zeros(len(bounds)), np.full(len(bounds), np.inf)
    for name, pair in table.items():
        choice(place, name, tuple(bounds))
        if not isinstance(pair, list) or len(pair) != 2:
            raise place.at(name).error(f"{shown(pair)} is not a mean and a standard deviation; write [0.4, 0.05]")
        k = list(bounds).index(name)
        mean[k], error[k] = (number(place.at(name).item(i), x) for i, x in enumerate(pair))
        if not error[k] > 0:
            raise place.at(name).error(f"{error[k]:g} is not a standard deviation; it must be above 0")
    return mean, error

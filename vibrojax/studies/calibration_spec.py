"""The specification of a calibration: observations, unknown parameters with bounds and priors, and errors."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Bool, Float

from vibrojax.errors import Place, counted, shown, suggestion
from vibrojax.io.dataset import open_dataset
from vibrojax.io.log_columns import split_unit
from vibrojax.io.tables import column_numbers, read_numbers, read_table, rows_without_units
from vibrojax.io.variables import VARIABLES
from vibrojax.maps.bounds import read_bounds, read_specification
from vibrojax.maps.read import Point, read_point
from vibrojax.periodic.derivatives import orbit_variables
from vibrojax.physics.arrays import check_untraced
from vibrojax.physics.units import factor
from vibrojax.settings.names import Names
from vibrojax.settings.toml import plain, read_source
from vibrojax.settings.values import as_table, choice, count, known_keys, require_number
from vibrojax.studies.calibration_history import VELOCITY, History

CONSTANT = "C"
"""Name of the coefficient of the law, which is no parameter of a scene: rate_of_penetration = C ln(relief)."""

RATE, RELIEF = "rate_of_penetration", "relief"

MAX_OBSERVATIONS = 10_000
"""Largest number of rows. Each is an orbit that is solved at every step of the search."""

DEFAULT_DRAWS, MAX_DRAWS = 1000, 1_000_000
DEFAULT_SEARCHES, MAX_SEARCHES = 3, 64

SPEED_BOUND = 10.0
"""Greatest speed at the first sample of a history, in units of its greatest speed, up to which a state is searched."""

_KEYS = (
    *("scene", "title", "data", "history", "start", "unknown", "error", "prior", "parameters"),
    *("searches", "draws", "seed"),
)
_HISTORY_KEYS = ("data", "columns", "window", "start")
_EXAMPLE = "mu = [0.2, 0.6]"


@dataclass(frozen=True, eq=False)
class CalibrationSpec:
    """A checked calibration.

    - `point`: scene, initial condition and fixed parameters.
    - `names`: the unknown parameters, and then the unknown states at the first sample of the history; `low` and `high`:
      their bounds; `prior_mean` and `prior_error` along them, with an infinite error where there is no prior.
    - `conditions`: for each row the parameters that differ between rows, by name.
    - `observed`: for each variable its values, NaN where there is none, in the rows and at the samples of the history;
      `errors`: their standard errors, or None if the residuals shall give them.
    - `labels`: number of each row's line in the file, or of the row; of samples their number.
    """

    title: str
    file: str
    text: str
    point: Point
    history: History | None
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
    def rows(self) -> int:
        """Number of rows; the other observations are samples of the history."""
        return len(self.labels) - (0 if self.history is None else len(self.history.times))

    @property
    def of_parameters(self) -> "CalibrationSpec":
        """The specification with the unknown parameters alone, without unknown states."""
        count = len(self.names) - (0 if self.history is None else len(self.history.states))
        own = {name: getattr(self, name)[:count] for name in ("names", "low", "high", "prior_mean", "prior_error")}
        return replace(self, **own)

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
        wanted = counted(
            len(self.names), "unknown" if self.history else "unknown parameter"
        ) + " and the size of the noise" * (self.errors is None)
        more = "give standard errors in [error], " if self.errors is None else "give a [prior], "
        return f"{counted(count, 'value')} for {wanted}; add rows or observed variables, {more}or leave an unknown out"

    def identity(self) -> dict[str, object]:
        """Return all settings on which the result depends, as flat JSON values."""
        times = {} if self.history is None else {"time": self.history.times}
        tables = {f"data.{name}": x.tolist() for name, x in (self.conditions | self.observed | times).items()}
        return {"calibration": True, "specification": self.text} | tables


def read_calibration(
    source: str | PathLike[str] | Mapping[str, object], columns: Mapping[str, str] | None = None
) -> CalibrationSpec:
    """Read and check a calibration from the path of a TOML file, or from a dict with the same structure.

    `columns`: columns of the history by quantity, in place of those that the calibration names.

    **Raises:** `InputError` with a one-line message at the first problem.
    """
    given: dict[str, Any] = {}
    if isinstance(source, Mapping):
        given = {
            key: source[key] for key in ("data", "history") if not isinstance(source.get(key, ""), (str, PathLike))
        }
        source = {key: x for key, x in source.items() if key not in given}
    origin = read_source(source, "calibration")
    place, tables, fixed, names = read_specification(origin, _KEYS)
    tables |= given
    unknown = dict(as_table(place.at("unknown"), tables.get("unknown", {})))
    if not unknown:
        raise place.at("unknown").error(f"missing, so there is nothing to calibrate; write one like {_EXAMPLE}")
    bounds = _read_unknown(place.at("unknown"), unknown, names, fixed)
    table, labels, file = _read_data(place, tables, origin.folder)
    variables = orbit_variables(names.system) if table else ()
    conditions, observed = _split(file, table, names, variables, (*bounds, *fixed)) if table else ({}, {})
    if CONSTANT in bounds:
        if RELIEF not in variables:
            why = f"scene {shown(names.scene)} has no relief; choose drilling, coupled-drilling or penetration"
            raise place.at("unknown").at(CONSTANT).error(why if table else "needs rows with a rate; give data")
        if RATE not in observed:
            raise file.error(f"has no column {RATE}, which {CONSTANT} needs; add it")
    point = read_point(place.at("parameters"), tables["scene"], fixed, tables.get("start"))
    history = None
    if tables.get("history") is not None:
        history = _read_history(place, tables, origin.folder, names, fixed, conditions, columns or {})
    elif columns:
        raise Place("--columns").error("names columns of a history, and there is none; give history = PATH")
    measured = observed | ({} if history is None else {VELOCITY: history.velocity})
    errors = _read_errors(place.at("error"), tables.get("error"), measured, table)
    if errors is None and history is not None and observed:
        fault = f"missing; rows and a history have other errors: give that of {', '.join(measured)}"
        raise place.at("error").error(fault)
    mean, width = _read_prior(place.at("prior"), tables.get("prior", {}), bounds)
    if errors is None and np.isfinite(width).any():
        raise place.at("prior").error("has no weight without standard errors of the observations; give [error]")
    if table and not {*bounds, *conditions} - {CONSTANT}:
        raise file.error(f"has no operating conditions, and only {CONSTANT} is unknown; use vibrojax fit")
    low, high = (np.array([pair[k] for pair in bounds.values()]) for k in (0, 1))
    states: tuple[str, ...] = ()
    if history is not None:
        states, none = history.states, np.zeros(len(history.states))
        low, high = np.append(low, -history.bound), np.append(high, history.bound)
        mean, width = np.append(mean, none), np.append(width, none + np.inf)
        rows, samples = np.full(len(labels), np.nan), np.full(len(history.times), np.nan)
        labels = np.append(labels, np.arange(len(samples)))
        for columns_of in (measured, errors or {}):
            for name, x in columns_of.items():
                columns_of[name] = np.append(rows, x) if name == VELOCITY else np.append(x, samples)
    spec = CalibrationSpec(
        title=str(tables.get("title") or f"Calibration of {', '.join(bounds)}"),
        file=origin.file,
        text=origin.text,
        point=point,
        history=history,
        names=(*bounds, *states),
        low=low,
        high=high,
        prior_mean=mean,
        prior_error=width,
        conditions=conditions,
        observed=measured,
        errors=errors,
        labels=labels,
        searches=count(place.at("searches"), tables.get("searches", DEFAULT_SEARCHES), 1, MAX_SEARCHES),
        draws=count(place.at("draws"), tables.get("draws", DEFAULT_DRAWS), 2, MAX_DRAWS),
        seed=count(place.at("seed"), tables.get("seed", 0), 0),
    )
    if problem := spec.shortage(np.ones(len(labels), bool)):
        raise file.error(problem)
    return spec


def _read_history(
    place: Place,
    tables: Mapping[str, Any],
    folder: Path,
    names: Names,
    fixed: Mapping[str, object],
    conditions: Mapping[str, object],
    columns: Mapping[str, str],
) -> History:
    """Return the recorded velocity, the point at which it was recorded, and the state at its first sample."""
    value, here, system = tables["history"], place.at("history"), names.system
    is_table = isinstance(value, Mapping) and not isinstance(value, xr.Dataset)
    table = dict(value) if is_table and not {*_HISTORY_KEYS}.isdisjoint(value) else {"data": value}
    own = {name: x for name, x in table.items() if name not in _HISTORY_KEYS}
    known_keys(here, own, conditions)
    if missing := [name for name in conditions if name not in own]:
        raise here.at(missing[0]).error("missing; the rows have values of their own: give that of the history")
    if VELOCITY not in system.state_names or not system.autonomous:
        raise here.error(f"scene {shown(names.scene)} has no bit that a drive turns; give rows of data")
    if "data" not in tables and "start" in tables:
        raise place.at("start").error("belongs in [history], as the state at its first sample; there are no rows")
    units = {"time": "s"} | {state.name: state.unit for state in system.states}
    chosen = as_table(here.at("columns"), plain(here.at("columns"), table.get("columns", {}))) | {**columns}
    for name in chosen:
        choice(here.at("columns"), name, units)
    x, file = _read_samples(here, table.get("data"), folder, units, {name: str(text) for name, text in chosen.items()})
    for name in ("time", VELOCITY):
        if name not in x:
            fault = f"missing; columns time [s] and {VELOCITY} [m/s] are needed; `columns` may name others"
            raise file.at(name).error(fault)
    begin, end = -np.inf, np.inf
    if "window" in table:
        pair, there = plain(here, table["window"]), here.at("window")
        if not isinstance(pair, list) or len(pair) != 2:
            raise there.error(f"{shown(pair)} is not a pair of times [s]; write [0.0, 0.5]")
        begin, end = (require_number(there.item(k), end) for k, end in enumerate(pair))
    inside = (x["time"] >= begin) & (x["time"] <= end) & np.isfinite(x[VELOCITY])
    x = {name: column[inside] for name, column in x.items()}
    size = len(x["time"])
    if not 2 <= size <= MAX_OBSERVATIONS:
        least = f"{MAX_OBSERVATIONS} are the most: shorten the window" if size > 2 else "two or more are needed"
        raise here.at("window").error(f"holds {size} samples with a velocity; {least}")
    if not (np.diff(x["time"]) > 0).all():
        raise file.at("time").error("does not rise from sample to sample; sort the rows, and give each time once")
    start = (
        None if table.get("start") is None else names.start(here.at("start"), plain(here.at("start"), table["start"]))
    )
    states = () if start is not None else tuple(system.states[system.place(name)] for name in system.start_states)
    guess = [float(np.nan_to_num(x[state.name][0])) if state.name in x else 0.0 for state in states]
    speed = SPEED_BOUND * float(np.abs(x[VELOCITY]).max()) or 1.0
    return History(
        point=read_point(here, tables["scene"], {**fixed, **own}, start if start is not None else guess),
        begin=float(x["time"][0]),
        times=x["time"] - x["time"][0],
        velocity=x[VELOCITY],
        states=tuple(state.name for state in states),
        guess=np.array(guess),
        bound=np.array([speed if state.is_velocity else speed * np.ptp(x["time"]) for state in states]),
    )


def _read_samples(
    place: Place, data: object, folder: Path, units: Mapping[str, str], chosen: Mapping[str, str]
) -> tuple[dict[str, np.ndarray], Place]:
    """Return the recorded quantities by name in SI units, and the place of the data; `chosen`: the user's columns."""
    bare = {name: split_unit(text)[0] for name, text in chosen.items()}

    def quantity_of(header: str) -> tuple[str, str | None]:
        """Return the quantity in a column, "" if there is none, and its unit."""
        for name, text in chosen.items():
            if header in (text, bare[name]):
                return name, split_unit(text)[1]
        name, unit = (header, None) if header in units else split_unit(header)
        return (name, unit) if name in units and name not in chosen else ("", None)

    file = place
    if isinstance(data, (str, PathLike)):
        path = folder / data
        file = Place(str(path))
        is_dataset = path.suffix == ".nc"
        data = open_dataset(path) if is_dataset else read_numbers(file, path, lambda x: quantity_of(x)[0], "time,v1")
    if isinstance(data, xr.Dataset):
        data = {name: data[name].values for name in units if name in data.variables and data[name].dims == ("time",)}
    if not isinstance(data, (Mapping, pd.DataFrame)):
        raise place.error(f"{shown(data)} is no recording; give a dataset, a table, or the path of a CSV file")
    found: dict[str, np.ndarray] = {}
    for header in map(str, data):
        name, unit = quantity_of(header)
        if not name:
            continue
        if name in found:
            raise file.at(header).error(f"is a second column of {name}; give one")
        scale = _factor(file.at(header), name, unit, units[name])
        try:
            found[name] = scale * np.asarray(data[header], float)
        except (TypeError, ValueError):
            raise file.at(header).error("does not hold numbers") from None
    for name, text in chosen.items():
        if name not in found:
            raise place.at("columns").at(name).error(f"{shown(text)} is not a column of the recording")
    if len({x.shape for x in found.values()}) > 1 or any(x.ndim != 1 for x in found.values()):
        raise file.error("its columns differ in length; give one value of each for every time")
    return found, file


def _factor(here: Place, name: str, unit: str | None, si: str) -> float:
    """Return the factor from `unit`, None for SI units, to the unit of the quantity called `name`."""
    scale = 1.0 if unit is None else factor(unit, si)
    if scale is None:
        raise here.error(f"is in {unit}, not a unit of {name} [{si}]")
    return scale


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
        low, high = (require_number(here.item(k), end) for k, end in enumerate(own))
        if not 0 < low < high:
            raise here.error(f"{shown(own)} is no interval above 0")
        bounds[CONSTANT] = (low, high)
    return bounds


def _read_data(
    place: Place, tables: Mapping[str, object], folder: Path
) -> tuple[dict[str, np.ndarray], np.ndarray, Place]:
    """Return the columns by header, the number of each row (in a file, of its line), and the place of the data."""
    data: Any = tables.get("data")
    if data is None and tables.get("history") is not None:
        return {}, np.zeros(0, int), place
    place = place.at("data")
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
        scale = _factor(here, name, unit, si)
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
        errors[name] = np.broadcast_to(require_number(place.at(name), table[name]), x.shape) if own is None else own
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
        mean[k], error[k] = (require_number(place.at(name).item(i), x) for i, x in enumerate(pair))
        if not error[k] > 0:
            raise place.at(name).error(f"{error[k]:g} is not a standard deviation; it must be above 0")
    return mean, error

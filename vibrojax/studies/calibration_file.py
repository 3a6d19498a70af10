"""The file of a calibration: observations of orbits and a recorded velocity, unknowns, errors and priors."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from vibrojax.errors import Place, counted, shown, suggestion
from vibrojax.io.dataset import open_dataset
from vibrojax.io.log_columns import split_unit
from vibrojax.io.tables import decimal_mark, read_cells, to_numbers
from vibrojax.io.variables import VARIABLES
from vibrojax.lanes.labels import measured_besides
from vibrojax.lazy import jax
from vibrojax.maps.bounds import SceneFile, read_bounds, read_file
from vibrojax.maps.read import read_point, read_start
from vibrojax.periodic.derivatives import orbit_variables
from vibrojax.physics.arrays import check_untraced
from vibrojax.physics.parameters import ROTATION, Parameter, resolved
from vibrojax.physics.units import UNITS, factor, likely_units, stated_unit
from vibrojax.scenes import HasRock
from vibrojax.settings.fields import Settings, given, setting, settings_of
from vibrojax.settings.names import Names
from vibrojax.settings.toml import Source, plain, read_source
from vibrojax.settings.values import as_table, choice, read_pair, require_number, warn_if_far
from vibrojax.studies.calibration_history import VELOCITY, History
from vibrojax.studies.calibration_model import CONSTANT, RATE, RELIEF, Problem

LAW = Parameter(CONSTANT, 1e-3, "m s-1", "coefficient of the law, rate = C ln(P/D)", "C", lowest=0.0, open_below=True)

Columns = dict[str, np.ndarray]

MAX_OBSERVATIONS = 10_000
"""Largest number of rows. Each is an orbit that is solved at every step of the search."""

NEVER_NEGATIVE = {RATE, "period", "impact_velocity", "impact_velocity_min", "impact_velocity_max", "impact_energy"} | {
    "impact_power", "blow_frequency", "peak_impact_force", "mean_impact_force", "stick_fraction", "reverse_fraction",
    "stick_slip_index", "bit_amplitude", "striker_amplitude", "mean_force", "relief",
}  # fmt: skip
"""Variables that cannot be negative: such a cell may be a mark of a missing value, like -999.25."""

SPEED_BOUND = 10.0
"""Greatest speed at the first sample of a history, in units of its greatest speed, up to which a state is searched."""


@dataclass(frozen=True, kw_only=True)
class CalibrationFile(SceneFile):
    """The file of a calibration."""

    data: Any = setting(None, "observations of orbits", read=given)
    history: Any = setting(None, "recorded velocity of the bit", read=given)
    start: Any = setting(None, "initial condition", read=given)
    unknown: Any = setting(None, "bounds of the unknown parameters", read=given)
    error: dict[str, Any] = setting(dict, "standard errors of the observed variables", read=as_table)
    prior: dict[str, Any] = setting(dict, "means and standard deviations of unknown parameters", read=as_table)
    searches: int = setting(3, "searches from different points", least=1, most=64)
    draws: int = setting(1000, "draws of the posterior", least=2, most=1_000_000)
    seed: int = setting(0, "seed of the points and draws", least=0)


_ALWAYS, _TIMES = (-np.inf, np.inf), "a pair of times [s]; write [0.0, 0.5]"


@dataclass(frozen=True, kw_only=True)
class HistoryTable(Settings):
    """The table [history] of a calibration, beside the operating conditions."""

    data: Any = setting(None, "the recording", read=given)
    columns: dict[str, Any] = setting(dict, "columns by quantity", read=lambda at, x: as_table(at, plain(at, x)))
    window: Any = setting(_ALWAYS, "begin and end [s]", read=lambda at, x: read_pair(at, plain(at, x), _TIMES))
    start: Any = setting(None, "state at the first sample", read=plain)


@dataclass(frozen=True, eq=False)
class Calibration:
    """A checked calibration: what the file says, and the problem that it poses."""

    file: CalibrationFile
    origin: Source
    problem: Problem


def read_calibration(
    source: str | PathLike[str] | Mapping[str, object], columns: Mapping[str, str] | None = None
) -> Calibration:
    """Read and check a calibration from the path of a TOML file, or from a dict with the same structure.

    `columns`: columns of the history by quantity, in place of those that the calibration names.

    **Raises:** `InputError` with a one-line message at the first problem.
    """
    recorded: dict[str, Any] = {}
    if isinstance(source, Mapping):
        of_data = {key: x for key, x in source.items() if key in ("data", "history")}
        recorded = {key: x for key, x in of_data.items() if not isinstance(x, (str, PathLike))}
        source = {key: x for key, x in source.items() if key not in recorded}
    origin = read_source(source, "calibration")
    file, place, names = read_file(CalibrationFile, replace(origin, tables=origin.tables | recorded))
    unknown, fixed, folder = as_table(place.at("unknown"), file.unknown or {}), dict(file.parameters), origin.folder
    for name in unknown:
        if name in names.writable and name not in names.parameters:
            fault = f"is not a parameter of the scene itself; choose from {', '.join(names.parameters)}"
            raise place.at("unknown").at(name).error(fault)
    unknown = dict(sorted(unknown.items(), key=lambda item: item[0] == CONSTANT))
    variables = [name for name in orbit_variables(names.system) if name in VARIABLES]
    conditions, observed, errors, labels, home = _read_rows(place, file, folder, names, variables, unknown)
    varying, table = [*conditions], conditions
    if turning := {name: home.at(f"column {name}") for name in varying if name not in names.parameters}:
        others = {name: place.at("parameters").at(name) for name in (*ROTATION, "v") if name in fixed}
        others |= {name: place.at("unknown").at(name) for name in unknown} | {name: home.at(name) for name in varying}
        names.check_substitutes(others | turning)
        given = {name: names.quantity(others[name], name, fixed[name]) for name in ROTATION if name in fixed}
        conditions = {name: x for name, x in resolved(conditions | given).items() if name not in ROTATION}
        hole = {"bit_radius"} if isinstance(names.system, HasRock) else set()
        fixed = {name: x for name, x in fixed.items() if name in hole or name not in ROTATION}
    bounds = read_bounds(place.at("unknown"), unknown or None, names, fixed, further={CONSTANT: LAW})
    if CONSTANT in bounds and RELIEF not in variables:
        why = f"scene {shown(names.scene)} has no relief; choose drilling, coupled-drilling or penetration"
        raise place.at("unknown").at(CONSTANT).error(why)
    if CONSTANT in bounds and RATE not in observed:
        raise home.error(f"has no column {RATE}, which {CONSTANT} needs; add it")
    if not file.unusual:
        ends = [(place.at("unknown").at(name), name, np.array(x)) for name, x in bounds.items() if name != CONSTANT]
        for here, name, x in [*ends, *((home.at(f"column {name}"), name, x) for name, x in table.items())]:
            warn_if_far(here, names.writable[name], x, meant="; unusual = true says that it is meant")
    read_start(place.at("start"), file.start, names)
    point = read_point(place.at("parameters"), file.scene, fixed, file.start, file.unusual)
    history = None
    if file.history is not None:
        history = _read_history(place.at("history"), file, names, varying, folder, columns or {})
        if not labels.size and file.start is not None:
            fault = "belongs in [history], as the state at its first sample; there are no rows"
            raise place.at("start").error(fault)
        observed |= {VELOCITY: history.velocity}
    elif columns:
        raise Place("--columns").error("names columns of a history, and there is none; give history = PATH")
    errors = _read_errors(place.at("error"), file.error, observed, errors)
    if not errors and history is not None and labels.size:
        fault = f"missing; rows and a history have other errors: give that of each of {', '.join(observed)}"
        raise place.at("error").error(fault)
    mean, width = np.zeros(len(bounds)), np.full(len(bounds), np.inf)
    for name, pair in file.prior.items():
        here, k = place.at("prior").at(name), [*bounds].index(choice(place.at("prior"), name, tuple(bounds)))
        mean[k], width[k] = read_pair(here, pair, "a mean and a standard deviation; write [0.4, 0.05]")
        low, high = bounds[name]
        if not low <= mean[k] <= high:
            unit = {**names.writable, CONSTANT: LAW}[name].unit
            value, end = (f"{x:.6g} {UNITS.get(unit, (unit,))[0]}".removesuffix(" 1") for x in (mean[k], high))
            fault = f"the mean {value} is outside the bounds, {low:.6g} to {end}"
            raise here.error(f"{fault}; correct its unit, or widen [unknown]")
        if not width[k] > 0:
            raise here.error(f"{width[k]:g} is not a standard deviation; it must be above 0")
    if file.prior and not errors:
        raise place.at("prior").error("has no weight without standard errors of the observations; give [error]")
    least, most = np.array([*bounds.values()]).T
    if history is not None:
        none, count = np.zeros(len(history.states)), len(labels)
        least, most = np.append(least, -history.bound), np.append(most, history.bound)
        mean, width = np.append(mean, none), np.append(width, none + np.inf)
        labels = np.append(labels, labels.max(initial=-1) + 1 + np.arange(len(history.times)))
        pads = {name: (count, 0) if name == VELOCITY else (0, len(history.times)) for name in observed}
        observed = {name: np.pad(x, pads[name], constant_values=np.nan) for name, x in observed.items()}
        errors = {name: np.pad(x, pads[name], constant_values=np.nan) for name, x in errors.items()}
    unknowns = (*bounds, *(() if history is None else history.states))
    values = np.stack([*observed.values()], axis=1)
    known = np.stack([errors[name] for name in observed], axis=1) if errors else None
    problem = Problem(
        point, history, unknowns, least, most, mean, width, conditions, (*observed,), values, known, labels, file.seed
    )
    if fault := problem.shortage(np.ones(len(labels), bool)):
        raise home.error(fault)
    return Calibration(file, origin, problem)


def _read_rows(
    place: Place, file: CalibrationFile, folder: Path, names: Names, variables: list[str], unknown: Mapping[str, object]
) -> tuple[Columns, Columns, Columns, np.ndarray, Place]:
    """Return operating conditions, observations and standard errors of the rows, their numbers, and their place.

    A rotation speed and a radius are conditions too.
    """
    if file.data is None and file.history is not None:
        return {}, {}, {}, np.zeros(0, int), place
    if file.data is None:
        raise place.at("data").error('missing; give the path of a CSV file with observations, like data = "runs.csv"')
    writable = {name: x for name, x in names.writable.items() if name in names.parameters or name in ROTATION}
    units = {name: parameter.unit for name, parameter in writable.items()}
    known = VARIABLES | measured_besides(names.system)
    units |= {f"{name}{end}": known[name].units for end in ("_error", "") for name in variables}
    table, labels, place = _read_table(place.at("data"), file.data, folder, units)
    conditions = {name: x for name, x in table.items() if name in writable}
    observed = {name: x for name, x in table.items() if name in variables}
    for name, x in (conditions | observed).items():
        here = place.at(f"column {name}")
        if name in unknown or name in file.parameters:
            raise here.error("is an unknown or a fixed parameter as well; give it in one of the two")
        if name in conditions and not np.isfinite(x).all():
            raise here.error("has an empty cell; every observation needs its operating conditions")
        for value in x if name in conditions else ():
            names.quantity(here, name, float(value))
        if np.isinf(x).any() or not np.isfinite(x).any():
            fault = "an infinite value" if np.isinf(x).any() else "no number"
            raise here.error(f"has {fault}; leave a cell empty where there is no observation")
        if name in NEVER_NEGATIVE and (negative := x < 0).any():
            first = f"{'line' if labels[0] else 'row'} {labels[int(np.argmax(negative))]}"  # rows of a table begin at 0
            fault = f"has {counted(negative.sum(), 'negative value')}, first in {first}, where none is possible"
            raise here.error(f"{fault}; correct the cells, or leave them empty")
    if not observed:
        raise place.error(f"holds no observation; name a column after a variable, such as {', '.join(variables[:3])}")
    if not {*unknown, *conditions} - {CONSTANT}:
        raise place.error(f"has no operating conditions, and only {CONSTANT} is unknown; use vibrojax fit")
    errors = {name: table[f"{name}_error"] for name in observed if f"{name}_error" in table}
    return conditions, observed, errors, labels, place


def _read_errors(place: Place, table: Mapping[str, object], observed: Columns, columns: Columns) -> Columns:
    """Return the standard error of each observation; none if neither the `columns` nor the `table` give any."""
    for name in table:
        choice(place, name, tuple(observed))
    errors = dict(columns)
    for name, x in observed.items():
        if name not in errors and name in table:
            errors[name] = np.full(x.shape, require_number(place.at(name), table[name]))
        if name in errors and not (errors[name][np.isfinite(x)] > 0).all():
            raise place.at(name).error("is not above 0 for every observation; give its standard error in SI units")
    if errors and (missing := [name for name in observed if name not in errors]):
        raise place.at(missing[0]).error("missing; give the standard error of every observed variable, or of none")
    return errors


def _read_history(
    place: Place, file: CalibrationFile, names: Names, conditions: list[str], folder: Path, columns: Mapping[str, str]
) -> History:
    """Return the recorded velocity, the point at which it was recorded, and the state at its first sample."""
    system, value = names.system, file.history
    is_table = isinstance(value, Mapping) and not settings_of(HistoryTable).keys().isdisjoint(value)
    entries = dict(value) if is_table and not isinstance(value, xr.Dataset) else {"data": value}
    own = {name: entries.pop(name) for name in conditions if name in entries}
    table = HistoryTable.read(place, entries)
    for name in conditions:
        if name not in own:
            raise place.at(name).error("missing; the rows have values of their own: give that of the history")
    if VELOCITY not in system.state_names or not system.autonomous:
        raise place.error(f"scene {shown(names.scene)} has no bit that a drive turns; give rows of data")
    units = {"time": "s"} | {state.name: state.unit for state in system.states}
    chosen = {choice(place.at("columns"), name, units): str(x) for name, x in (table.columns | {**columns}).items()}
    x, _, home = _read_table(place, table.data, folder, units, chosen)
    for name in ("time", VELOCITY):
        if name not in x:
            fault = f"missing; columns time [s] and {VELOCITY} [m/s] are needed; `columns` may name others"
            raise home.at(name).error(fault)
    begin, end = table.window
    inside = (x["time"] >= begin) & (x["time"] <= end) & np.isfinite(x[VELOCITY])
    x = {name: column[inside] for name, column in x.items()}
    time, velocity = x["time"], x[VELOCITY]
    if len(time) < 2:
        raise place.at("window").error(f"holds {len(time)} samples with a velocity; two or more are needed")
    if not (np.diff(time) > 0).all():
        raise home.at("time").error("does not rise from sample to sample; sort the rows, and give each time once")
    states = () if table.start is not None else tuple(system.states[system.place(name)] for name in system.start_states)
    guess = [float(np.nan_to_num(x[state.name][0])) if state.name in x else 0.0 for state in states]
    speed = SPEED_BOUND * float(np.abs(velocity).max()) or 1.0
    parameters, start = {**file.parameters, **own}, guess if table.start is None else table.start
    point = read_point(place, file.scene, parameters, start, file.unusual)
    if {"m1", "k1"} <= point.parameters.keys():
        step = float(np.median(np.diff(time)))
        period = 2 * np.pi * np.sqrt(point.parameters["m1"] / point.parameters["k1"])
        if step > period / 2:
            fault = f"samples are {step:.3g} s apart, more than half a period of the bit ({period:.3g} s)"
            likely = likely_units(step, "s", (0.0, period / 2))
            advice = next((f'if it is in {unit}, write "time ({unit})"' for unit in likely), "give more samples")
            raise home.at("time").error(f"{fault}; {advice}")
    bound = np.array([speed if state.is_velocity else speed * np.ptp(time) for state in states])
    unknown = tuple(state.name for state in states)
    return History(point, float(time[0]), time - time[0], velocity, unknown, np.array(guess), bound)


def _read_table(
    place: Place, data: Any, folder: Path, units: Mapping[str, str], chosen: Mapping[str, str] | None = None
) -> tuple[Columns, np.ndarray, Place]:
    """Return the columns of a file, dataset or table, the number of each row (in a text file, its line), and its place.

    `units`: SI units by quantity, to which the columns are converted. `chosen`: columns, by quantity, whose names
    differ from the quantities; further columns may then hold anything.
    """

    def quantity_of(header: str) -> tuple[str, str | None]:
        """Return the quantity in a column, "" if there is none, and its unit."""
        for name, text in (chosen or {}).items():
            if header in (text, split_unit(text)[0]):
                return name, split_unit(text)[1]
        name, unit = (header, None) if header in units else split_unit(header)
        return (name, unit) if name in units and name not in (chosen or {}) else ("", None)

    home, numbers = place, np.zeros(0, int)
    if isinstance(data, (str, PathLike)):
        path = folder / data
        place = Place(str(path))
        if path.suffix == ".nc":
            data = open_dataset(path)
        else:
            cells = read_cells(place, path)
            numbers = cells.index.to_numpy()
            if not cells.columns.is_unique:
                here = place.at(f"line {cells.attrs['line']}")
                raise here.error("has two columns of one name; give each column once")
            needed = [name for name in cells if chosen is None or quantity_of(name)[0]]
            mark, data = decimal_mark(cells[name] for name in needed), {}
            for name in needed:
                data[name], bad = to_numbers(cells[name], mark, ())
                for line, cell in cells[name][bad].items():
                    fault = f"{shown(str(cell).strip())} is not a number; write one, like 0.4, or leave it empty"
                    raise place.at(f"line {line}, column {name}").error(fault)
    if isinstance(data, xr.Dataset):
        data = {name: x for name, x in data.variables.items() if x.ndim == 1}
    if not isinstance(data, (Mapping, pd.DataFrame)):
        raise place.error(f"{shown(data)} is not a table; give a table, a dataset, or the path of a CSV file")
    columns: dict[str, np.ndarray] = {}
    for key in data:
        name, unit = quantity_of(str(key))
        here = place.at(f"column {key}")
        if not name and chosen is None:
            hint = suggestion(split_unit(str(key))[0], units)
            raise here.error(f"is neither a parameter of the scene nor a variable of its orbits; {hint}")
        if not name:
            continue
        if name in columns:
            raise here.error(f"is a second column of {name}; give one")
        unit = unit or stated_unit(data[key])
        scale = 1.0 if unit in (None, units[name]) else factor(unit, units[name])
        if scale is None:
            raise here.error(f"is in {unit}, not a unit of {name} [{units[name]}]")
        for value in jax.tree.leaves(data[key]):
            check_untraced(here.error, value)
        try:
            columns[name] = scale * np.asarray(data[key], float)
        except (TypeError, ValueError):
            raise here.error("does not hold numbers") from None
    for name, text in (chosen or {}).items():
        if name not in columns:
            raise home.at("columns").at(name).error(f"{shown(text)} is not a column of the recording")
    shapes = {x.shape for x in columns.values()}
    if len(shapes) > 1 or any(len(shape) != 1 for shape in shapes):
        raise place.error("its columns differ in length; give one value of each for every row")
    size = sum(next(iter(shapes), (0,)))
    if columns and not 0 < size <= MAX_OBSERVATIONS:
        raise place.error(f"holds {size} rows with observations; give at least one, and at most {MAX_OBSERVATIONS}")
    return columns, numbers if len(numbers) else np.arange(size), place

"""Data of a fit: a dataset, the path of a dataset, or rig data (a CSV file with one measurement per line)."""

import json
from collections.abc import Callable, Iterator, Mapping
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Float

from vibrojax.analyses.rop_law.columns import (
    FORCE,
    KNOWN,
    RATE,
    RELIEF,
    THRESHOLD,
    Column,
    choose_columns,
    required_names,
    split_unit,
    with_rock,
)
from vibrojax.errors import InputError, Place, shell_assignment, shown
from vibrojax.models.physics.units import is_unit, likely_units
from vibrojax.sweep.input.source import is_number, read_table
from vibrojax.sweep.input.values import warn_if_far

if TYPE_CHECKING:
    Data: TypeAlias = xr.Dataset | str | PathLike[str] | pd.DataFrame
    Columns = Mapping[str, str] | None
else:
    Data = Columns = object  # at run time `open_data` checks the user's argument, with a one-line error message

_MEASUREMENTS = ("measurement", "no rows; add a line for each measurement", f"{RELIEF},{RATE}")
"""Words of `read_table` for rig data."""

Rows = list[tuple[int, list[str]]]
"""The non-empty lines of a CSV: (line number, cells)."""


def open_data(data: Data, fit: str, rates: bool = False, columns: Columns = None) -> tuple[Place, xr.Dataset]:
    """Return the dataset, opened if `data` is a path, and the `Place` that error messages mention.

    `fit` is the name of the calling function. With `rates`, the data must contain a rate of penetration and a relief,
    and may be a CSV or a table with `columns`, as in `read_rig`.
    """
    if rates and isinstance(data, pd.DataFrame):
        return Place(fit), _with_rates(Place(fit), read_rig(Path(fit), columns, table=data))
    if not isinstance(data, (xr.Dataset, str, PathLike)):
        raise InputError(f"{fit}: {shown(data)} is not data; give a dataset or a path")
    path = Path("dataset.nc") if isinstance(data, xr.Dataset) else Path(data)
    place = Place(fit if isinstance(data, xr.Dataset) else str(path))
    if columns and path.suffix.lower() == ".nc":
        raise place.error("has its names and units already; `columns` is for a CSV")
    if isinstance(data, xr.Dataset):
        dataset = data
    elif rates and path.suffix.lower() == ".csv":
        dataset = read_rig(path, columns)
    elif path.suffix.lower() == ".nc":
        from vibrojax.io.dataset import open_dataset

        dataset = open_dataset(path)
    else:
        wrong = "ends in neither .nc nor .csv" if rates else "does not end in .nc"
        raise place.error(f"{wrong}; give a sweep's dataset{' or a CSV file' if rates else ''}")
    return place, _with_rates(place, dataset) if rates else dataset


def _with_rates(place: Place, dataset: xr.Dataset) -> xr.Dataset:
    """Return the dataset, checked to have numbers as rates and reliefs."""
    for name in (RATE, RELIEF):
        if name not in dataset:
            names = ", ".join(str(name) for name in dataset.data_vars) or "nothing"
            raise place.at(name).error(f"missing; a sweep of a scene with rock has it, this holds {names}")
        if dataset[name].dtype.kind not in "fiu":
            raise place.at(name).error("does not hold numbers; the data of a sweep are needed")
    return dataset


def read_rig(path: Path, columns: Columns = None, table: pd.DataFrame | None = None) -> xr.Dataset:
    """Read a CSV into a dataset with rate_of_penetration [m/s] and relief [1] along `point`, the rows.

    Without a relief, the relief is computed as mean_force/threshold. Further columns become coordinates, numeric if all
    their cells are numbers. An empty cell and "nan" mean a missing value. The attribute `columns` records the source
    and unit of each quantity.

    **Arguments:** `columns`: by quantity, the column of the file and its unit, see
    [vibrojax.analyses.rop_law.columns][]; `table`: the table that `path` names, if it is not in a file.

    **Raises:** `InputError` if the file cannot be read, a column is missing, or a cell is not a number.
    """
    if columns is not None and not isinstance(columns, Mapping):
        raise InputError(f'columns: {shown(columns)} does not name columns; give a dict like {{"{RATE}": "ROP (m/h)"}}')
    columns = columns or {}
    for name, text in columns.items():
        if not isinstance(text, str) or not text.strip():
            example = f'{name}="ROP (m/h)"'
            raise Place("columns", str(name)).error(
                f"{shown(text)} is not a column; write one with its unit, like {example}"
            )
    columns = with_rock(columns)
    place = Place(str(path))
    content = None
    if table is not None:
        content = (table.reset_index() if any(table.index.names) else table).to_csv(index=False)
    line, header, others = read_table(path, *_MEASUREMENTS, text=content)
    chosen = choose_columns(place.at(f"line {line}"), header, columns)
    names = required_names(place.at(f"line {line}"), header, chosen, columns)
    rows = _rows(place, header, others)
    values = {}
    for name, column in chosen.items():
        if column.index is None:
            values[name] = np.full(len(rows), np.nan if column.value is None else column.value)
        else:
            values[name] = column.factor * _numbers(place, column.header, column.index, rows)
    for name in names:
        _check_unit(place, name, chosen[name], values[name])
    if RELIEF not in names:
        with np.errstate(divide="ignore", invalid="ignore"):
            values[RELIEF] = values[FORCE] / values[THRESHOLD]
    number = ("point", np.arange(len(rows)), {"units": "1", "long_name": "number of the row"})
    variables: dict[str, Any] = {"point": number}
    for name, numbers in values.items():
        variables[name] = ("point", numbers, {"units": KNOWN[name].unit, "long_name": KNOWN[name].long_name})
    taken = {column.index for column in chosen.values()}
    for index, name in enumerate(header):
        if index not in taken and name not in ("", *variables):
            try:
                variables[name] = ("point", _numbers(place, name, index, rows))
            except InputError:
                variables[name] = ("point", np.array([row[index].strip() for _, row in rows]))
    sources = json.dumps({name: column.described() for name, column in chosen.items()})
    dataset = xr.Dataset(variables, attrs={"title": path.name, "columns": sources})
    return dataset.set_coords([name for name in variables if name not in (RATE, RELIEF)])


def read_numbers(place: Place, path: Path, wanted: Callable[[str], object]) -> dict[str, Float[np.ndarray, " rows"]]:
    """Return the numbers of the `wanted` columns of a CSV by header; NaN for empty cells.

    **Raises:** `InputError` if the file cannot be read or a cell is not a number.
    """
    line, header, others = read_table(path, *_MEASUREMENTS)
    rows = _rows(place, header, others)
    columns: dict[str, Float[np.ndarray, " rows"]] = {}
    for index, name in enumerate(header):
        if wanted(name):
            if name in columns:
                raise place.at(f"line {line}").error(f"column {name} is there twice; give it once")
            columns[name] = _numbers(place, name, index, rows)
    return columns


def _rows(place: Place, header: list[str], others: Iterator[tuple[int, list[str]]]) -> Rows:
    """Return the rows of a CSV; raise `InputError` if the first of them holds units."""
    rows = list(others)
    line, units = rows[0][0], [cell.strip(" []()") for cell in rows[0][1] if cell.strip()]
    if not any(map(is_number, units)) and any(map(is_unit, units)):
        like = f"{header[0]} ({units[0]})"
        fault = f"holds units; write them behind the names, like {like}, and leave it out"
        raise place.at(f"line {line}").error(fault)
    return rows


def _check_unit(place: Place, name: str, column: Column, values: Float[np.ndarray, " rows"]) -> None:
    """Check that the median of a column is not far from the usual values, which suggests that its unit is wrong.

    Warn if the user specified the unit; raise `InputError` if it is assumed.
    """
    known = np.abs(values[np.isfinite(values) & (values != 0)])
    if not known.size or not (quantity := KNOWN[name]).is_far(median := float(np.median(known))):
        return
    units = list(likely_units(median / column.factor, quantity.unit, quantity.usual or (0.0, 0.0)))
    unit = units[0] if units else "UNIT"
    right = f"{column.header} {unit}" if column.index is None else f"{split_unit(column.header)[0]} ({unit})"
    example = f"--columns {shell_assignment(name, right)}"
    likely = f"it is likely in {' or '.join(units)}; name it, like {example}" if units else f"name its unit: {example}"
    here = place.at(f"{column.header}, the median of its column")
    if not column.assumed:
        warn_if_far(here, quantity, median, likely)
        return
    low, high = quantity.usual or (0.0, 0.0)
    fault = f"no unit is given, and {median:.6g} {column.unit} is far outside what the source and rigs have"
    raise here.error(f"{fault} ({low:g} to {high:g} {column.unit}); {likely}")


def _numbers(place: Place, name: str, index: int, rows: Rows) -> Float[np.ndarray, " rows"]:
    """Return the numbers in a column, NaN for empty cells; raise `InputError` for other text."""
    values = np.full(len(rows), np.nan)
    for position, (line, row) in enumerate(rows):
        if cell := row[index].strip():
            try:
                values[position] = float(cell)
            except ValueError:
                fault = f"{shown(cell)} is not a number; write one, like 0.4, or leave it empty"
                raise place.at(f"line {line}, column {name}").error(fault) from None
    return values

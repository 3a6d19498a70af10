"""Data of a fit: a dataset, the path of a dataset, or rig data (a CSV file with one measurement per line)."""

import json
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Float

from vibrojax.errors import InputError, Place, shell_assignment, shown
from vibrojax.io.log_columns import (
    FORCE,
    KNOWN,
    RATE,
    RELIEF,
    THRESHOLD,
    WEIGHT,
    Column,
    required_names,
    split_unit,
    with_rock,
)
from vibrojax.io.riglog import open_log
from vibrojax.physics.units import likely_units
from vibrojax.settings.values import warn_if_far

if TYPE_CHECKING:
    Data: TypeAlias = xr.Dataset | str | PathLike[str] | pd.DataFrame
    Columns = Mapping[str, str] | None
else:
    Data = Columns = object  # at run time `open_data` checks the user's argument, with a one-line error message


def open_data(data: Data, fit: str, columns: Columns = None, **reading: str | None) -> tuple[Place, xr.Dataset]:
    """Return the dataset, opened if `data` is a path, and the `Place` that error messages mention.

    `fit` is the name of the calling function. The data must contain a rate of penetration and a relief, and may be a
    CSV, a LAS file or a table with `columns`; `reading` are further arguments of `read_log`.
    """
    if isinstance(data, pd.DataFrame):
        return Place(fit), _with_rates(Place(fit), read_rig(Path(fit), columns, data, **reading))
    if not isinstance(data, (xr.Dataset, str, PathLike)):
        raise InputError(f"{fit}: {shown(data)} is not data; give a dataset or a path")
    path = Path("dataset.nc") if isinstance(data, xr.Dataset) else Path(data)
    place = Place(fit if isinstance(data, xr.Dataset) else str(path))
    if columns and path.suffix.lower() == ".nc":
        raise place.error("has its names and units already; `columns` is for a CSV")
    if isinstance(data, xr.Dataset):
        dataset = data
    elif path.suffix.lower() in (".csv", ".las"):
        dataset = read_rig(path, columns, **reading)
    elif path.suffix.lower() == ".nc":
        from vibrojax.io.dataset import open_dataset

        dataset = open_dataset(path)
    else:
        raise place.error("ends in neither .nc nor .csv nor .las; give a sweep's dataset or a CSV or LAS file")
    return place, _with_rates(place, dataset)


def _with_rates(place: Place, dataset: xr.Dataset) -> xr.Dataset:
    """Return the dataset, checked to have numbers as rates and reliefs."""
    for name in (RATE, RELIEF):
        if name not in dataset:
            names = ", ".join(str(name) for name in dataset.data_vars) or "nothing"
            raise place.at(name).error(f"missing; a sweep of a scene with rock has it, this holds {names}")
        if dataset[name].dtype.kind not in "fiu":
            raise place.at(name).error("does not hold numbers; the data of a sweep are needed")
    return dataset


def read_rig(path: Path, columns: Columns = None, table: pd.DataFrame | None = None, **reading: Any) -> xr.Dataset:
    """Read a rig log into a dataset with rate_of_penetration [m/s] and relief [1] along `point`, the rows.

    Without a relief, the relief is computed as mean_force/threshold; a weight on bit is a mean force. If the threshold
    is "unknown", or not given with a log whose dialect has none, the relief is mean_force over its median, which the
    attribute `reference_force` [N] holds. The other attributes and coordinates are those of
    [vibrojax.io.riglog.read_log][].

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
    is_unknown = columns.get(THRESHOLD, "").strip() == "unknown"
    columns = {name: text for name, text in columns.items() if not (is_unknown and name == THRESHOLD)}
    log = open_log(path, columns=columns, table=table, **reading)
    chosen, data = dict(log.chosen), log.data.rename_dims(row="point")
    if WEIGHT in chosen and FORCE not in chosen:
        chosen[FORCE] = chosen.pop(WEIGHT)
        data = data.rename({WEIGHT: FORCE})
    is_unknown |= log.data.dialect != "plain" and not {THRESHOLD, RELIEF} & set(chosen)
    if is_unknown and {THRESHOLD, RELIEF} & set(chosen):
        raise Place("columns", THRESHOLD).error(f"is unknown, but {log.place.file} has a threshold or relief; give one")
    standin = {THRESHOLD: Column("unknown", None, "N", 1.0)} if is_unknown else {}
    names = required_names(log.place.at(f"line {log.line}"), log.header, chosen | standin, columns)
    for name in names:
        if name in chosen:
            _check_unit(log.place, name, chosen[name], data[name].values)
    if is_unknown:
        reference = float(np.nanmedian(data[FORCE])) or 1.0
        data[RELIEF] = data[FORCE] / reference
        data.attrs["reference_force"] = reference
    elif RELIEF not in names:
        with np.errstate(divide="ignore", invalid="ignore"):
            data[RELIEF] = data[FORCE] / data[THRESHOLD]
    if RELIEF not in names:
        data[RELIEF].attrs = {"units": KNOWN[RELIEF].unit, "long_name": KNOWN[RELIEF].long_name}
    number = ("point", np.arange(data.sizes["point"]), {"units": "1", "long_name": "number of the row"})
    data = data.assign_coords(point=number).set_coords([str(name) for name in data if name not in (RATE, RELIEF)])
    return data.assign_attrs(columns=json.dumps({name: column.described() for name, column in chosen.items()}))


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

"""Recorded velocities for `fit_friction`: datasets, tables, CSV files and arrays, and their parts without contact."""

from collections.abc import Iterable, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Bool

from vibrojax.errors import InputError, Place, shown, suggestion
from vibrojax.io.attributes import flags
from vibrojax.io.log_columns import split_unit
from vibrojax.io.tables import read_numbers
from vibrojax.physics.units import UNITS, factor
from vibrojax.studies.rop_data import open_data

if TYPE_CHECKING:
    Recording: TypeAlias = xr.Dataset | str | PathLike[str] | pd.DataFrame | Mapping[str, Any] | tuple[Any, Any]
    Contacts: TypeAlias = Iterable[tuple[float, float]]
else:
    Recording = Contacts = object  # checked with one-line error messages

MIN_SAMPLES = 6
"""Least number of samples of a part between contacts: two more than the state at its beginning has elements."""

_QUANTITIES = {"time": "s", "v1": "m s-1", "x1": "m", "x2": "m", "v2": "m s-1", "impact_force": "N"}
"""Quantities that are read from tables, with their SI units."""


def open_recording(data: Recording, fit: str) -> tuple[Place, xr.Dataset]:
    """Return a dataset with `v1` and the other recorded quantities along `time`, and the `Place` for messages.

    `fit` is the name of the calling function.
    """
    if isinstance(data, xr.Dataset):
        return open_data(data, fit)
    if isinstance(data, (str, PathLike)):
        path = Path(data)
        if path.suffix.lower() == ".csv":
            place = Place(str(path))
            return place, _recording(place, read_numbers(place, path, _quantity, "time,v1"))
        if path.suffix.lower() != ".nc":
            raise Place(str(path)).error("ends in neither .nc nor .csv; give a recording as a dataset or a CSV file")
        return open_data(data, fit)
    if isinstance(data, pd.DataFrame):
        frame = data.reset_index() if _quantity(str(data.index.name)) == "time" else data
        if not frame.columns.is_unique:
            raise Place(fit).error("has two columns of one name; give each column once")
        data = {str(name): frame[name].to_numpy() for name in frame.columns}
    elif isinstance(data, (tuple, list, np.ndarray)):
        if len(data) != 2:
            raise Place(fit).error(f"{len(data)} arrays; two are needed, (time, v1) in s and m/s")
        data = dict(zip(("time", "v1"), data, strict=True))
    if not isinstance(data, Mapping):
        raise InputError(f"{fit}: {shown(data)} is not data; give a dataset, a table, a path, or arrays (time, v1)")
    return Place(fit), _recording(Place(fit), {str(name): x for name, x in data.items() if _quantity(str(name))})


def _quantity(header: str) -> str:
    """Return the quantity that a column holds; "" if it is none of those that are read."""
    name = header if header in _QUANTITIES else split_unit(header)[0]
    return name if name in _QUANTITIES else ""


def _recording(place: Place, columns: Mapping[str, Any]) -> xr.Dataset:
    """Return the columns, whose headers may have units, as a dataset in SI units."""
    values: dict[str, np.ndarray] = {}
    for header, column in columns.items():
        name, si = _quantity(header), _QUANTITIES[_quantity(header)]
        unit = None if header == name else split_unit(header)[1]
        scale = 1.0 if unit is None else factor(unit, si)
        if scale is None:
            raise place.at(header).error(f"{shown(unit)} is not a unit of {name}; {suggestion(str(unit), UNITS[si])}")
        if name in values:
            raise place.at(header).error(f"is a second column of {name}; give one")
        try:
            values[name] = scale * np.asarray(column, float)
        except (TypeError, ValueError):
            raise place.at(header).error("does not hold numbers") from None
        if values[name].ndim != 1:
            raise place.at(header).error(f"has {values[name].ndim} dimensions; one is needed, along time")
    for name in ("time", "v1"):
        if name not in values:
            raise place.at(name).error("missing; columns time [s] and v1 [m/s] are needed, the velocity of the bit")
    for name, column in values.items():
        if len(column) != len(values["time"]):
            raise place.at(name).error(f"has {len(column)} values; {len(values['time'])} are needed, as in time")
    if not np.isfinite(values["time"]).all():
        raise place.at("time").error("has an element that is not a finite number")
    variables = {name: ("time", column, {"units": _QUANTITIES[name]}) for name, column in values.items()}
    return xr.Dataset(variables).set_coords("time")


def contact_free_parts(
    place: Place, data: xr.Dataset, inside: Bool[np.ndarray, " samples"], contacts: Contacts
) -> list[range]:
    """Return the parts of the samples `inside` a window that lie between contacts of striker and bit.

    Contacts are given, stated by the events of a trajectory, and indicated by a positive `impact_force`. A contact
    between two samples separates them.
    """
    times = data["time"].values[inside].astype(float)
    free = np.ones(len(times), bool)
    if "impact_force" in data:
        free &= ~(data["impact_force"].values[inside] > 0)
    separated = np.zeros(len(times), bool)  # from the previous sample
    for begin, end in [*_given_contacts(place, contacts), *_recorded_contacts(data)]:
        low, high = np.searchsorted(times, begin, "left"), np.searchsorted(times, end, "right")
        free[low:high] = False
        separated[high : high + 1] = True
    parts: list[range] = []
    for k in np.flatnonzero(free).tolist():
        if parts and parts[-1].stop == k and not separated[k]:
            parts[-1] = range(parts[-1].start, k + 1)
        else:
            parts.append(range(k, k + 1))
    return parts


def _given_contacts(place: Place, contacts: Contacts) -> list[tuple[float, float]]:
    try:
        pairs = [(float(begin), float(end)) for begin, end in contacts]
    except (TypeError, ValueError):
        raise place.at("contacts").error(f"{shown(contacts)} are not pairs (begin, end) [s]") from None
    for begin, end in pairs:
        if not begin <= end:
            raise place.at("contacts").error(f"({begin:g}, {end:g}) does not end after it begins")
    return pairs


def _recorded_contacts(data: xr.Dataset) -> Sequence[tuple[float, float]]:
    """Return the contacts that the events of a trajectory state, each (begin, end) [s]."""
    if "event_time" not in data or "event_kind" not in data:
        return []
    meanings = flags(data["event_kind"])
    kinds = [meanings.get(kind, "") for kind in data["event_kind"].values.tolist()]
    times = dict.fromkeys(("impact", "release"), np.zeros(0))
    for name in times:
        times[name] = data["event_time"].values[[kind == name for kind in kinds]].astype(float)
    begins, ends = times["impact"], times["release"]
    after = [ends[ends > begin] for begin in begins]
    pairs = [
        (float(begin), float(later[0]) if later.size else np.inf) for begin, later in zip(begins, after, strict=True)
    ]
    # A motion may begin during a contact.
    return [(-np.inf, float(ends[0])), *pairs] if ends.size and not (begins < ends[0]).any() else pairs

"""Branches in a dataset of orbit families: the points, stability, and special points of each branch."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Int

from vibrojax.errors import InputError, shown
from vibrojax.io.kinds import SPECIAL_KINDS

STABLE, UNSTABLE, UNKNOWN = 1, 0, -1

KIND, FAMILY = "special_kind", "family"

_KIND_PRIORITY = ("fold", "period-doubling", "torus", "hopf", "section", "grazing", "stick", "end")
"""Kinds of special points, ordered by how well they explain a change of stability, for points with several kinds."""


class Branch(NamedTuple):
    """One branch of a family: indices of its points, in order along the branch, and of its special points."""

    family: int
    number: int
    points: Int[np.ndarray, " points"]
    special: Int[np.ndarray, " special"]


class Interval(NamedTuple):
    """A parameter interval in which a branch is stable.

    `low_kind` and `high_kind` are the kinds of the special points at its ends, "" where there is no special point.
    """

    low: float
    high: float
    low_kind: str
    high_kind: str


def along_name(ds: xr.Dataset) -> str:
    """Return the name of the continuation parameter."""
    return str(ds.attrs["along"])


def kind_names(ds: xr.Dataset) -> list[str]:
    """Return the kind of each special point, as a string."""
    meanings = str(ds[KIND].attrs.get("flag_meanings", "")).split()
    if not set(meanings) <= set(SPECIAL_KINDS):
        raise InputError(f"variable {KIND}: {shown(meanings)} are not kinds of special points")
    return [meanings[flag] for flag in ds[KIND].values.astype(int).tolist()]


def numbers_of(ds: xr.Dataset, which: str) -> Int[np.ndarray, " which"]:
    """Return the family number of each point (`which` = "point") or special point (`which` = "special")."""
    name = f"{which}_{FAMILY}"
    return ds[name].values.astype(int) if name in ds else np.zeros(ds.sizes[which], int)


def family_coordinates(ds: xr.Dataset, which: str) -> dict[str, np.ndarray]:
    """Return the coordinates that distinguish families, by name: their values at each point or special point.

    After a selection of one family, these are scalars. They are undefined at points of families that are left out.
    """
    numbers, labels = numbers_of(ds, which), family_numbers(ds)
    same = numbers[:, None] == labels
    coordinates = {}
    for name, data in ds.coords.items():
        if name != FAMILY and data.dims in ((), (FAMILY,)):
            values = np.broadcast_to(data.values, len(labels))[same.argmax(axis=1)]
            undefined = "" if values.dtype.kind in "UO" else np.nan
            coordinates[str(name)] = np.where(same.any(axis=1), values, undefined)
    return coordinates


def with_selected_families(ds: xr.Dataset) -> xr.Dataset:
    """Return the dataset with the points and special points of its families alone, for example after `isel`."""
    labels = family_numbers(ds)
    return ds.isel({name: np.isin(numbers_of(ds, name), labels) for name in ("point", "special")})


def family_numbers(ds: xr.Dataset) -> Int[np.ndarray, " families"]:
    """Return the numbers of a dataset's families."""
    if FAMILY in ds.coords:
        return np.atleast_1d(ds[FAMILY].values)
    return np.unique(np.concatenate([numbers_of(ds, name) for name in ("point", "special")]))


def branches(ds: xr.Dataset) -> Iterator[Branch]:
    """Yield the branches of all families, in stored order."""
    of_points, of_special = numbers_of(ds, "point"), numbers_of(ds, "special")
    number, special = ds["branch"].values.astype(int), ds["special_branch"].values.astype(int)
    for family, branch in dict.fromkeys(zip(of_points.tolist(), number.tolist(), strict=True)):
        points = np.flatnonzero((of_points == family) & (number == branch))
        yield Branch(family, branch, points, np.flatnonzero((of_special == family) & (special == branch)))


def places(ds: xr.Dataset, branch: Branch) -> Int[np.ndarray, " special"]:
    """Return, for each special point of a branch, the index of the same point among the points.

    Several special points at the same parameter value are assigned to different points if possible.
    """
    values, special_values = ds[along_name(ds)].values[branch.points], ds["special_value"].values[branch.special]
    taken = np.zeros(len(values), int)
    indices = []
    for value in special_values:
        nearest = int(np.lexsort((taken, np.abs(values - value)))[0])
        taken[nearest] += 1
        indices.append(branch.points[nearest])
    return np.array(indices, int)


def stability(ds: xr.Dataset, branch: Branch) -> Int[np.ndarray, " segments"]:
    """Return the stability of each segment between successive points of a branch: 1, 0, or -1 if unknown.

    Multipliers at a special point hold on only one side of it. The stability of the neighbouring point is used instead.
    """
    stable, special = ds["stable"].values[branch.points].astype(int), np.isin(branch.points, places(ds, branch))
    here, following = stable[:-1], stable[1:]
    either = np.where(special[1:] & ~special[:-1], here, np.minimum(here, following))
    either = np.where(special[:-1] & ~special[1:], following, either)
    return np.where(here == following, here, either)


def runs(segments: Int[np.ndarray, " segments"]) -> Iterator[tuple[int, int, int]]:
    """Yield each run of segments with equal stability, as (first point, last point, stability)."""
    ends = np.flatnonzero(np.diff(segments)) + 1
    for first, last in zip([0, *ends.tolist()], [*ends.tolist(), len(segments)], strict=True):
        if last > first:
            yield first, last, int(segments[first])


def stable_intervals(ds: xr.Dataset, branch: Branch) -> list[Interval]:
    """Return the parameter intervals in which a branch is stable."""
    values, names = ds[along_name(ds)].values[branch.points], kind_names(ds)
    kinds: dict[int, str] = {}
    for special, point in zip(branch.special.tolist(), places(ds, branch).tolist(), strict=True):
        kinds[point] = min(kinds.get(point, names[special]), names[special], key=_KIND_PRIORITY.index)
    if branch.number:
        kinds.setdefault(int(branch.points[0]), "period-doubling")  # a period-doubled branch begins at this point

    def end(index: int) -> tuple[float, str]:
        return float(values[index]), kinds.get(int(branch.points[index]), "")

    intervals = []
    for first, last, stable in runs(stability(ds, branch)):
        if stable == STABLE:
            (low, low_kind), (high, high_kind) = sorted((end(first), end(last)))
            intervals.append(Interval(low, high, low_kind, high_kind))
    return intervals

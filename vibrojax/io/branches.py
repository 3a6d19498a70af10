"""A dataset of families, read back: its branches, where they are stable, and where special points lie on them."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Int

from vibrojax.errors import InputError, shown
from vibrojax.io.derived import SPECIAL_KINDS

STABLE, UNSTABLE, UNKNOWN = 1, 0, -1

KIND, FAMILY = "special_kind", "family"

_TELLING = ("fold", "period-doubling", "torus", "section", "grazing", "stick", "end")
"""Kinds in the order in which one of several at a point says best why stability changes there."""


class Branch(NamedTuple):
    """The points of one branch, in order, and its special points."""

    family: int
    number: int
    points: Int[np.ndarray, " points"]
    special: Int[np.ndarray, " special"]


class Interval(NamedTuple):
    """A stretch of a branch that is stable: values of the parameter, and the kinds of special points at its ends, empty
    where there is none."""

    low: float
    high: float
    low_kind: str
    high_kind: str


def along_name(ds: xr.Dataset) -> str:
    """The parameter that the families were followed along."""
    return str(ds.attrs["along"])


def kind_names(ds: xr.Dataset) -> list[str]:
    """The kind of each special point."""
    meanings = str(ds[KIND].attrs.get("flag_meanings", "")).split()
    if not set(meanings) <= set(SPECIAL_KINDS):
        raise InputError(f"variable {KIND}: {shown(meanings)} are no kinds of special points")
    return [meanings[flag] for flag in ds[KIND].values.astype(int).tolist()]


def numbers_of(ds: xr.Dataset, which: str) -> Int[np.ndarray, " which"]:
    """The family of each of the points, or special points, which `which` is ("point" or "special")."""
    name = f"{which}_{FAMILY}"
    return ds[name].values.astype(int) if name in ds else np.zeros(ds.sizes[which], int)


def branches(ds: xr.Dataset) -> Iterator[Branch]:
    """The branches of all families, in order."""
    of_points, of_special = numbers_of(ds, "point"), numbers_of(ds, "special")
    number, special = ds["branch"].values.astype(int), ds["special_branch"].values.astype(int)
    for family, branch in dict.fromkeys(zip(of_points.tolist(), number.tolist(), strict=True)):
        yield Branch(
            family,
            branch,
            np.flatnonzero((of_points == family) & (number == branch)),
            np.flatnonzero((of_special == family) & (special == branch)),
        )


def places(ds: xr.Dataset, branch: Branch) -> Int[np.ndarray, " special"]:
    """The point at which each special point of a branch lies.

    They are points of the branch themselves; where several are at one value, each takes one of its own if it can.
    """
    values, wanted = ds[along_name(ds)].values[branch.points], ds["special_value"].values[branch.special]
    taken = np.zeros(len(values), int)
    found = []
    for value in wanted:
        at = int(np.lexsort((taken, np.abs(values - value)))[0])
        taken[at] += 1
        found.append(branch.points[at])
    return np.array(found, int)


def stability(ds: xr.Dataset, branch: Branch) -> Int[np.ndarray, " segments"]:
    """Whether a branch is stable from each of its points to the next: 1, 0, or -1 where that is not known.

    At a special point the multipliers are those of one side, so that what is beyond it says more.
    """
    at, special = ds["stable"].values[branch.points].astype(int), np.isin(branch.points, places(ds, branch))
    here, there = at[:-1], at[1:]
    either = np.where(
        special[:-1] & ~special[1:], there, np.where(special[1:] & ~special[:-1], here, np.minimum(here, there))
    )
    return np.where(here == there, here, either)


def runs(segments: Int[np.ndarray, " segments"]) -> Iterator[tuple[int, int, int]]:
    """The first and the last point, and the stability, of each stretch of one stability."""
    ends = np.flatnonzero(np.diff(segments)) + 1
    for first, last in zip([0, *ends.tolist()], [*ends.tolist(), len(segments)], strict=True):
        if last > first:
            yield first, last, int(segments[first])


def stable_intervals(ds: xr.Dataset, branch: Branch) -> list[Interval]:
    """Where a branch is stable."""
    values = ds[along_name(ds)].values[branch.points]
    names, at = kind_names(ds), places(ds, branch)
    kinds = {
        place: min(
            (names[one] for one, there in zip(branch.special, at, strict=True) if there == place), key=_TELLING.index
        )
        for place in set(at.tolist())
    }

    if branch.number:
        kinds.setdefault(int(branch.points[0]), "period-doubling")  # at which it left another branch

    def end(place: int) -> tuple[float, str]:
        return float(values[place]), kinds.get(int(branch.points[place]), "")

    found = []
    for first, last, stable in runs(stability(ds, branch)):
        if stable == STABLE:
            (low, low_kind), (high, high_kind) = sorted((end(first), end(last)))
            found.append(Interval(low, high, low_kind, high_kind))
    return found

"""The stretches that branches are followed in, and how each branch comes to be listed once."""

from dataclasses import dataclass, field
from itertools import combinations
from typing import NamedTuple

import numpy as np

from vibrojax.analyses.continuation.problem import At
from vibrojax.analyses.continuation.walk import CLOSED, MOST_UNSTABLE, STALLED, STOPPED, TOO_LONG, UNSTABLE

MEETS = 1e-3
"""Distance over the scales within which a doubled branch that no step goes on from meets the one that it left."""

ENDS = {
    CLOSED: "back where it began",
    TOO_LONG: "more points than are followed",
    STALLED: "no orbit is found any further",
    STOPPED: "joins the branch that it left",
    UNSTABLE: f"a multiplier over {MOST_UNSTABLE:g} is not followed",
}


class Mark(NamedTuple):
    """A special point of a leg: its kind, the equations there, the place of the point before it, and what to say."""

    kind: str
    at: At
    place: int
    note: str = ""


@dataclass
class Leg:
    """A stretch of a branch between a beginning and an end, with one number of returns.

    - `family`, `branch`: which; `way`: 1 or -1, towards or against the direction in which the branch is listed;
      `number`: of the leg on this way.
    - `u`, `ahead`, `step`: where and how it begins; `leaves`: the direction in which a doubled branch left, or None.
    - `home`: the branch's first solution and tangent; `after`: the leg that it goes on from, or left.
    - `reach`: how far beyond its end it meets the branch that it left, if it does.
    - `at`, `marks`: what was found.
    """

    family: int
    branch: int
    way: int
    u: np.ndarray
    ahead: np.ndarray
    step: float
    number: int = 0
    leaves: np.ndarray | None = None
    home: tuple[np.ndarray, np.ndarray] | None = None
    after: "Leg | None" = None
    reach: float = MEETS
    at: At | None = None
    marks: list[Mark] = field(default_factory=list)


def each_once(legs: list[Leg], rows: int) -> list[Leg]:
    """The legs without those of branches that were followed twice; the branches numbered anew.

    A closed branch was followed both ways; one that doubled branches join at both ends was followed from both.
    """
    closed = {leg.family for leg in legs if leg.branch == 0 and any(mark.note == ENDS[CLOSED] for mark in leg.marks)}
    again = _from_other_ends(legs, rows)

    def dropped(leg: Leg | None) -> bool:
        while leg is not None:
            if (leg.branch == 0 and leg.way < 0 and leg.family in closed) or (leg.family, leg.branch) in again:
                return True
            leg = leg.after
        return False

    kept = [leg for leg in legs if not dropped(leg)]
    numbers: dict[tuple[int, int], int] = {}
    for leg in kept:
        among = sum(family == leg.family for family, _ in numbers)
        leg.branch = numbers.setdefault((leg.family, leg.branch), among)
    return kept


def _from_other_ends(legs: list[Leg], rows: int) -> set[tuple[int, int]]:
    """The doubled branches, as (family, branch), that end where others begin, and begin where these end."""
    begins = {(leg.family, leg.branch): leg.u for leg in legs if leg.leaves is not None and leg.number == 0}
    ends = {
        (leg.family, leg.branch): (mark.at.u[0], leg.reach)
        for leg in legs
        for mark in leg.marks
        if mark.note == ENDS[STOPPED]
    }
    found: set[tuple[int, int]] = set()
    for one, other in combinations(sorted(ends), 2):
        same = one[0] == other[0] and one not in found
        if same and _meet(begins[one], *ends[other], rows) and _meet(begins[other], *ends[one], rows):
            found.add(other)
    return found


def _meet(begin: np.ndarray, end: np.ndarray, reach: float, rows: int) -> bool:
    """Whether a branch begins within `reach` of another's end, from whichever of the returns on."""
    if len(begin) != len(end):
        return False
    shifts = range(0, len(begin) - 1, rows)
    turned = (np.append(np.roll(begin[:-1], shift), begin[-1]) for shift in shifts)
    return any(np.abs(one - end).max() <= reach for one in turned)

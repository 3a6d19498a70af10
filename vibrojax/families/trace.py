"""Whole families: every branch in both directions, through its special points and onto the doubled branches."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from vibrojax.families.corners import apart, around, counted_otherwise, doubled
from vibrojax.families.indicators import KINDS
from vibrojax.families.locate import EVENTS, Arcs, Special, by_events, located
from vibrojax.families.problem import At, Flags, Index, Problem, Unknowns, tangent
from vibrojax.families.walk import (
    CLOSED,
    ENDED,
    LONGEST,
    MOST_UNSTABLE,
    SHORTEST,
    STALLED,
    STOPPED,
    TOO_LONG,
    UNSTABLE,
    Begin,
    Trail,
    walk,
)
from vibrojax.measure.ledger import MOST_CYCLES

FIRST_STEP, AFTER_CORNER = 0.02, 1e-3
"""Steps, over the scales, with which a leg begins, and one that goes on around a corner."""

MOST_LEGS = 24
"""Corners and touches of the section on one way of a branch."""

MOST_BRANCHES = 32

SAME_PLACE = 1e-6
"""Distance over the scales within which special points of one kind are one."""

ENDS = {
    CLOSED: "back where it began",
    TOO_LONG: "more points than are followed",
    STALLED: "no orbit is found any further",
    STOPPED: "joins the branch that it left",
    UNSTABLE: f"a multiplier over {MOST_UNSTABLE:g} is not followed",
}


class Mark(NamedTuple):
    """A special point of a leg: its kind, the equations there, the place of the point before it, and what there is to say."""

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
    - `home`: the branch's first solution and tangent.
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
    at: At | None = None
    marks: list[Mark] = field(default_factory=list)


class Tracer:
    """Follows families of one problem.

    **Arguments:**

    - `longest`: step, over the scales.
    - `cycles`: the most returns of doubled branches; `branches`: at most so many of a family.
    """

    def __init__(
        self, problem: Problem, longest: float = LONGEST, cycles: int = MOST_CYCLES, branches: int = MOST_BRANCHES
    ) -> None:
        self._problem, self._longest, self._cycles, self._branches = problem, longest, cycles, branches
        self._count: dict[int, int] = {}

    def __call__(self, family: Index, u: Sequence[np.ndarray]) -> list[Leg]:
        """All legs of the families that orbits belong to, of each its unknowns, as many as it has."""
        self._count = dict.fromkeys(family.tolist(), 1)
        begun = {one: (x, self._upwards(one, x)) for one, x in zip(family.tolist(), u, strict=True)}
        up_first = [Leg(one, 0, 1, *begun[one], FIRST_STEP, home=begun[one]) for one in begun]
        legs = self._all(up_first)
        # A closed branch is known whole by one way.
        closed = {leg.family for leg in legs if any(mark.note == ENDS[CLOSED] for mark in leg.marks)}
        others = [Leg(one, 0, -1, begun[one][0], -begun[one][1], FIRST_STEP) for one in begun if one not in closed]
        return legs + self._all(others)

    def _upwards(self, family: int, u: np.ndarray) -> np.ndarray:
        """The tangent at an orbit, in the direction in which the parameter grows."""
        up = np.zeros_like(u[None])
        up[:, -1] = 1.0
        return tangent(self._problem.at(np.array([family]), u[None]).matrix, up)[0]

    def _all(self, waiting: list[Leg]) -> list[Leg]:
        """The legs, and all that go on from them."""
        done: list[Leg] = []
        while waiting:
            onward: list[Leg] = []
            for size in sorted({len(leg.u) for leg in waiting}):
                group = [leg for leg in waiting if len(leg.u) == size]
                onward += self._follow(group)
                done += group
            waiting = onward
        return done

    def _follow(self, legs: list[Leg]) -> list[Leg]:
        """Follow legs of one number of returns to their ends; the legs that go on from there."""
        problem = self._problem
        family = np.array([leg.family for leg in legs])
        none = np.full_like(legs[0].u, np.nan)
        homes = [leg.home if leg.home is not None and len(leg.home[0]) == len(leg.u) else (none, none) for leg in legs]
        begin = Begin(
            family=family,
            u=np.array([leg.u for leg in legs]),
            tangent=np.array([leg.ahead for leg in legs]),
            step=np.array([leg.step for leg in legs]),
            home=np.array([home for home, _ in homes]),
            away=np.array([away for _, away in homes]),
        )
        leaves = np.array([np.full(len(leg.u), np.nan) if leg.leaves is None else leg.leaves for leg in legs])

        def stop(lanes: Index, at: At, ahead: Unknowns) -> Flags:
            with np.errstate(invalid="ignore"):
                return apart(at.u, leaves[lanes]) <= 0 if len(leaves[0]) % 2 else np.zeros(len(lanes), bool)

        trail = walk(problem, begin, self._longest, stop)
        bounds = np.searchsorted(trail.lane, np.arange(len(legs) + 1))
        special = located(problem, family, trail)
        onward: list[Leg] = []
        for k, leg in enumerate(legs):
            last = bounds[k + 1] - (trail.status[k] == STOPPED)
            leg.at = trail.at.of(slice(bounds[k], last))
            if special is not None:
                self._mark(leg, special, int(bounds[k]), int(last))
        onward += self._beyond_ends(legs, trail, bounds)
        onward += self._doublings(legs)
        return onward

    def _mark(self, leg: Leg, special: Special, first: int, last: int) -> None:
        """Enter the special points between two points of a trail."""
        for k in np.flatnonzero((special.place >= first) & (special.place < last - 1)):
            leg.marks.append(Mark(KINDS[special.kind[k]], special.at.of([k]), int(special.place[k]) - first))
        leg.marks.sort(key=lambda mark: mark.place)

    def _beyond_ends(self, legs: list[Leg], trail: Trail, bounds: np.ndarray) -> list[Leg]:
        """Enter how legs end; the legs that go on."""
        problem = self._problem
        onward: list[Leg] = []
        for k, leg in enumerate(legs):
            at = leg.at
            assert at is not None
            end, status = at.of([-1]), int(trail.status[k])
            place = len(at.u) - 1
            if status == ENDED:
                one = np.array([leg.family])
                bound = "last" if problem.value(one, end.u) == problem.last[one] else "first"
                leg.marks.append(Mark("end", end, place, f"the {bound} value is reached"))
                continue
            if status != STALLED or leg.number >= MOST_LEGS:
                leg.marks.append(Mark("end", end, place, ENDS[status]))
                continue
            ahead = trail.tangent[bounds[k + 1] - 1][None]
            onward += self._past(leg, end, ahead)
        return onward

    def _past(self, leg: Leg, end: At, ahead: Unknowns) -> list[Leg]:
        """The leg that goes on where another found no next point ahead; enter what is passed there."""
        problem, one = self._problem, np.array([leg.family])
        at = leg.at
        assert at is not None
        away = np.flatnonzero(np.abs(at.u - end.u).max(axis=1) > 100 * SHORTEST)
        before = at.of([away[-1] if len(away) else 0])
        place = len(at.u) - 1
        turned = around(problem, one, end, ahead, before)
        passed = Arcs(EVENTS, np.array([place]), one, before, ahead, turned.at, ahead)
        changed = (before.signature != turned.at.signature).any()
        kinds = [KINDS[special.kind[0]] for special in by_events(passed)] if changed else []
        if turned.found[0]:
            self._enter(leg, kinds, end, "")
            go = Leg(leg.family, leg.branch, leg.way, turned.at.u[0], turned.tangent[0], AFTER_CORNER, leg.number + 1)
            go.leaves, go.home = leg.leaves, leg.home
            return [go]
        found = counted_otherwise(problem, leg.family, end, ahead)
        if found is not None:
            otherwise, t = found
            leg.marks.append(Mark("section", end, place, f"{otherwise.times.shape[1]} returns from here"))
            go = Leg(leg.family, leg.branch, leg.way, otherwise.u[0], t[0], AFTER_CORNER, leg.number + 1)
            go.home = leg.home
            return [go]
        if kinds:
            self._enter(leg, kinds, end, "the family ends here")
        else:
            leg.marks.append(Mark("end", end, place, f"{ENDS[STALLED]}; grazing margin {end.margin[0]:.1e}"))
        return []

    def _enter(self, leg: Leg, kinds: Sequence[str], end: At, note: str) -> None:
        """Enter special points at a leg's end that are not known yet."""
        assert leg.at is not None
        for kind in kinds:
            near = [mark for mark in leg.marks if mark.kind == kind and np.abs(mark.at.u - end.u).max() < SAME_PLACE]
            leg.marks = [mark for mark in leg.marks if not any(mark is one for one in near[1:])]
            if near:
                leg.marks = [mark._replace(note=note) if mark is near[0] else mark for mark in leg.marks]
            else:
                leg.marks.append(Mark(kind, end, len(leg.at.u) - 1, note))

    def _doublings(self, legs: list[Leg]) -> list[Leg]:
        """The doubled branches that begin on legs."""
        found = []
        for leg in legs:
            for mark in leg.marks:
                cycles = mark.at.times.shape[1]
                if mark.kind != "period-doubling" or 2 * cycles > self._cycles:
                    continue
                if self._count[leg.family] >= self._branches:
                    continue
                u, ahead = doubled(self._problem, mark.at)
                branch = self._count[leg.family]
                self._count[leg.family] += 1
                found.append(Leg(leg.family, branch, 1, u[0], ahead[0], FIRST_STEP, leaves=ahead[0]))
        return found

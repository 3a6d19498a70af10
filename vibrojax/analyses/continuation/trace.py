"""Whole families: every branch in both directions, through its special points and onto the doubled branches."""

from collections.abc import Sequence

import numpy as np

from vibrojax.analyses.continuation.arcs import Arcs
from vibrojax.analyses.continuation.corners import apart, around, counted_otherwise, doubled
from vibrojax.analyses.continuation.indicators import KINDS
from vibrojax.analyses.continuation.legs import ENDS, Leg, Mark, each_once
from vibrojax.analyses.continuation.locate import Special, by_events, located
from vibrojax.analyses.continuation.problem import At, Flags, Index, Problem, Unknowns, joined_at, tangent
from vibrojax.analyses.continuation.walk import (
    ENDED,
    LONGEST,
    SHORTEST,
    STALLED,
    STOPPED,
    Begin,
    Trail,
    walk,
)
from vibrojax.measures.ledger import MOST_CYCLES

FIRST_STEP, AFTER_CORNER = 0.02, 1e-3
"""Steps, over the scales, with which a leg begins, and one that goes on around a corner."""

MOST_LEGS = 24
"""Corners and touches of the section on one way of a branch."""

MOST_BRANCHES = 32

SAME_PLACE = 1e-6
"""Distance over the scales within which special points of one kind are one."""

_NO_FURTHER = {"section": "the motion goes on, its returns are not counted any more"}


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
        waiting = [
            Leg(one, 0, way, x, way * t, FIRST_STEP, home=(x, way * t))
            for one, (x, t) in begun.items()
            for way in (1, -1)
        ]
        done: list[Leg] = []
        while waiting:
            onward: list[Leg] = []
            for size in sorted({len(leg.u) for leg in waiting}):
                group = [leg for leg in waiting if len(leg.u) == size]
                onward += self._follow(group)
                done += group
            waiting = onward
        return each_once(done, self._problem.rows)

    def _upwards(self, family: int, u: np.ndarray) -> np.ndarray:
        """The tangent at an orbit, in the direction in which the parameter grows."""
        up = np.zeros_like(u[None])
        up[:, -1] = 1.0
        return tangent(self._problem.at(np.array([family]), u[None]).matrix, up)[0]

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

        can_be_doubled = len(leaves[0]) % 2 == 1  # states that can be halved, and the parameter

        def stop(lanes: Index, at: At, ahead: Unknowns) -> Flags:
            with np.errstate(invalid="ignore"):
                return apart(at.u, leaves[lanes]) <= 0 if can_be_doubled else np.zeros(len(lanes), bool)

        trail = walk(problem, begin, self._longest, stop)
        bounds = np.searchsorted(trail.lane, np.arange(len(legs) + 1))
        special = located(problem, family, trail)
        onward: list[Leg] = []
        for k, leg in enumerate(legs):
            last = bounds[k + 1] - (trail.status[k] == STOPPED)
            leg.at = trail.at.of(slice(bounds[k], last))
            if last < bounds[k + 1]:
                leg.reach = max(leg.reach, float(np.abs(trail.at.u[last] - leg.at.u[-1]).max()))
            if special is not None:
                self._mark(leg, special, int(bounds[k]), int(last))
        onward += self._beyond_ends(legs, trail, bounds)
        onward += self._doublings(legs)
        return onward

    def _mark(self, leg: Leg, special: Special, first: int, last: int) -> None:
        """Enter the special points between two points of a trail."""
        for k in np.flatnonzero((special.place >= first) & (special.place < last - 1)):
            kind, at = KINDS[special.kind[k]], special.at.of([k])
            note = self._without_impact(at, special.beyond.of([k])) if kind == "grazing" else ""
            leg.marks.append(Mark(kind, at, int(special.place[k]) - first, note))
        trail = leg.at
        assert trail is not None
        leg.marks.sort(key=lambda mark: (mark.place, np.abs(mark.at.u[0] - trail.u[mark.place]).max()))

    def _without_impact(self, at: At, beyond: At) -> str:
        """What there is to say where other events begin or vanish than impacts: of which modes."""
        if at.impacts[0] != beyond.impacts[0]:
            return ""
        changed = (at.entered[0] != beyond.entered[0]).any(axis=1)
        names = [mode.name for mode, here in zip(self._problem.scene.modes, changed, strict=True) if here]
        return f"no impact: another order of events of {', '.join(names)}"

    def _beyond_ends(self, legs: list[Leg], trail: Trail, bounds: np.ndarray) -> list[Leg]:
        """Enter how legs end; the legs that go on."""
        stalled: list[Leg] = []
        last: list[np.ndarray] = []
        for k, leg in enumerate(legs):
            assert leg.at is not None
            end, status = leg.at.of([-1]), int(trail.status[k])
            if status == STALLED and leg.number < MOST_LEGS:
                stalled.append(leg)
                last.append(trail.tangent[bounds[k + 1] - 1])
                continue
            note = ENDS.get(status, "")
            if status == ENDED:
                one = np.array([leg.family])
                bound = "last" if self._problem.value(one, end.u) == self._problem.last[one] else "first"
                note = f"the {bound} value is reached"
            leg.marks.append(Mark("end", end, len(leg.at.u) - 1, note))
        return self._past_corners(stalled, np.array(last)) if stalled else []

    def _past_corners(self, legs: list[Leg], ahead: Unknowns) -> list[Leg]:
        """The legs that go on where others found no next point ahead; enter what is passed there."""
        ats = [leg.at for leg in legs if leg.at is not None]
        family = np.array([leg.family for leg in legs])
        end = joined_at([at.of([-1]) for at in ats])
        away = [np.flatnonzero(np.abs(at.u - at.u[-1]).max(axis=1) > 100 * SHORTEST) for at in ats]
        before = joined_at([at.of([some[-1] if len(some) else 0]) for at, some in zip(ats, away, strict=True)])
        turned = around(self._problem, family, end, ahead, before)
        place = np.array([len(at.u) - 1 for at in ats])
        passed = Arcs(family, place, before, ahead, turned.at, ahead)
        onward: list[Leg] = []
        for k, leg in enumerate(legs):
            one = np.arange(len(legs)) == k
            changed = (before.signature[k] != turned.at.signature[k]).any()
            kinds = [KINDS[special.kind[0]] for special in by_events(self._problem, passed.of(one))] if changed else []
            go = Leg(
                leg.family,
                leg.branch,
                leg.way,
                leg.u,
                leg.ahead,
                AFTER_CORNER,
                leg.number + 1,
                home=leg.home,
                after=leg,
            )
            if turned.found[k]:
                self._enter(leg, kinds, end.of([k]), "")
                go.u, go.ahead, go.leaves = turned.at.u[k], turned.tangent[k], leg.leaves
                onward.append(go)
                continue
            otherwise = counted_otherwise(self._problem, leg.family, end.of([k]), ahead[[k]])
            if otherwise is not None:
                at, t = otherwise
                self._enter(leg, ["section"], end.of([k]), f"{at.times.shape[1]} returns from here")
                go.u, go.ahead = at.u[0], t[0]
                onward.append(go)
            elif kinds:
                self._enter(leg, kinds, end.of([k]), _NO_FURTHER.get(kinds[0], "the family ends here"))
            elif leg.leaves is not None and abs(apart(end.u[[k]], leg.leaves[None])[0]) < SAME_PLACE:
                leg.marks.append(Mark("end", end.of([k]), int(place[k]), ENDS[STOPPED]))
            else:
                note = f"{ENDS[STALLED]}; grazing margin {end.margin[k]:.1e}"
                leg.marks.append(Mark("end", end.of([k]), int(place[k]), note))
        return onward

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
                found.append(Leg(leg.family, branch, 1, u[0], ahead[0], FIRST_STEP, leaves=ahead[0], after=leg))
        return found

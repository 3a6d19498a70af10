"""Special points of families: between which points they lie, and located there."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Int

from vibrojax.families.arcs import Arcs, drawn_together
from vibrojax.families.corners import SAME_TIME
from vibrojax.families.indicators import INDICATORS, KINDS, holds
from vibrojax.families.problem import At, Flags, Index, PerLane, Problem, Unknowns, joined_at
from vibrojax.families.walk import Trail
from vibrojax.scenes import HasFriction

MOST_CHANGES = 8
"""Of events between two points of a trail."""

EVENTS = -1
"""Instead of a kind, between points on which other events are met: what that is follows from what is found."""


class Special(NamedTuple):
    """Located points: their `kind` as a flag; `place` of the point of the trail that comes before; `at` and `tangent`
    there, on the near side; and `beyond`, the equations right behind."""

    kind: Int[np.ndarray, " points"]
    place: Int[np.ndarray, " points"]
    at: At
    tangent: Unknowns
    beyond: At


def located(problem: Problem, family: Index, trail: Trail) -> Special | None:
    """All special points of a trail, `family` (lanes,) being those of its lanes; None where there are none."""
    with np.errstate(all="ignore"):
        kind, arcs = _candidates(family, trail)
        found: list[Special] = []
        for _ in range(MOST_CHANGES):
            if not len(kind):
                break
            fine, got = _drawn(problem, kind, arcs)
            smooth = np.flatnonzero(got & (kind != EVENTS))
            smooth = smooth[_holds(kind[smooth], fine.of(smooth))]
            found.append(_special(kind[smooth], fine.of(smooth)))
            events = got & (kind == EVENTS)
            found += by_events(problem, fine.of(events))
            # More of them may lie between what was found and the arc's end.
            more = events & (fine.far.signature != arcs.far.signature).any(axis=1)
            onward, rest = fine.of(more), arcs.of(more)
            kind = kind[more]
            arcs = Arcs(rest.family, rest.place, onward.far, onward.ahead_far, rest.far, rest.ahead_far)
    return _joined([one for one in found if len(one.kind)])


def by_events(problem: Problem, arcs: Arcs) -> list[Special]:
    """Points at which impacts, or sticks and slips backwards, begin or vanish; where both do, one of each kind. Where
    the time of the repeat jumps it is the returns that are counted otherwise, and other events follow from that."""
    near, far = arcs.near, arcs.far
    period = near.times.sum(axis=1)
    section = ~(np.abs(far.times.sum(axis=1) - period) < SAME_TIME * period)
    impact = (near.impacts != far.impacts) & ~section
    stick = np.zeros(len(period), bool)
    if isinstance(problem.scene, HasFriction):
        # The bit's slip is -1 backwards, and 0 where it sticks.
        slip = problem.scene.mode_place("slip")
        stick = (near.entered[:, slip, :2] != far.entered[:, slip, :2]).any(axis=1) & ~section
    other = ~impact & ~stick & ~section
    kinds = (("grazing", impact | other), ("stick", stick), ("section", section))
    return [_special(np.full(some.sum(), KINDS.index(kind)), arcs.of(some)) for kind, some in kinds if some.any()]


def _special(kind: Int[np.ndarray, " arcs"], arcs: Arcs) -> Special:
    return Special(kind, arcs.place, arcs.near, arcs.ahead, arcs.far)


def _candidates(family: Index, trail: Trail) -> tuple[Int[np.ndarray, " arcs"], Arcs]:
    """Where along a trail the indicators change their signs, and where other events are met: kinds, and arcs."""
    same = trail.lane[1:] == trail.lane[:-1]
    changes = [(KINDS.index(kind), value(trail.at, trail.tangent)) for kind, value in INDICATORS.items()]
    found = [(kind, np.flatnonzero(same & (x[1:] * x[:-1] < 0))) for kind, x in changes]
    counts = trail.at.signature
    found.append((EVENTS, np.flatnonzero(same & (counts[1:] != counts[:-1]).any(axis=1))))
    kind = np.concatenate([np.full(len(place), kind) for kind, place in found])
    place = np.concatenate([place for _, place in found])
    ends = trail.at.of(place), trail.tangent[place], trail.at.of(place + 1), trail.tangent[place + 1]
    return kind, Arcs(family[trail.lane[place]], place, *ends)


def _drawn(problem: Problem, kind: Int[np.ndarray, " arcs"], arcs: Arcs) -> tuple[Arcs, Flags]:
    """The arcs drawn together, each to what passes zero at points of its kind; where events change, a step."""
    counts = arcs.near.signature

    def value(some: Index, at: At, ahead: Unknowns) -> PerLane:
        found = np.where((at.signature == counts[some]).all(axis=1), 1.0, -1.0)
        for name, indicator in INDICATORS.items():
            mine = kind[some] == KINDS.index(name)
            if mine.any():
                found[mine] = indicator(at.of(mine), ahead[mine])
        return found

    return drawn_together(problem, arcs, value, kind == EVENTS)


def _holds(kind: Int[np.ndarray, " arcs"], arcs: Arcs) -> Flags:
    """Which located points have a multiplier where those of their kind have one."""
    found = np.zeros(len(kind), bool)
    for name in INDICATORS:
        mine = kind == KINDS.index(name)
        if mine.any():
            found[mine] = holds(name, arcs.near.product[mine])
    return found


def _joined(found: list[Special]) -> Special | None:
    if not found:
        return None
    kind, place, tangents = (np.concatenate([getattr(one, n) for one in found]) for n in ("kind", "place", "tangent"))
    at, beyond = joined_at([one.at for one in found]), joined_at([one.beyond for one in found])
    return Special(kind, place, at, tangents, beyond)

"""Special points of families: between which points they lie, and located there."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Int

from vibrojax.analyses.continuation.arcs import Arcs, drawn_together
from vibrojax.analyses.continuation.corners import SAME_TIME
from vibrojax.analyses.continuation.indicators import INDICATORS, KINDS, holds
from vibrojax.analyses.continuation.problem import At, Flags, Index, PerLane, Problem, Unknowns, joined_at
from vibrojax.analyses.continuation.walk import Trail
from vibrojax.models.scenes import HasFriction

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
    """All special points of a trail, `family` (lanes,) being those of its lanes; None where there are none.

    Multipliers jump where events begin or vanish: those points are found first, and others between them.
    """
    found: list[Special] = []
    with np.errstate(all="ignore"):
        kind, arcs = _to_draw(_between_points(family, trail))
        for _ in range(MOST_CHANGES + 1):
            if not len(kind):
                break
            fine, got = _drawn(problem, kind, arcs)
            events = kind == EVENTS
            for end in (fine, fine.turned()):
                smooth = np.flatnonzero(got & ~events)
                smooth = smooth[_holds(kind[smooth], end.of(smooth))]
                found.append(_special(kind[smooth], end.of(smooth)))
                got[smooth] = False
            here, whole = fine.of(got & events), arcs.of(got & events)
            found += by_events(problem, here)
            before = Arcs(whole.family, whole.place, whole.near, whole.ahead, here.near, here.ahead)
            behind = Arcs(whole.family, whole.place, here.far, here.ahead_far, whole.far, whole.ahead_far)
            parts = _turning(before), _to_draw(behind), _turning(arcs.of(~got & events))
            kind = np.concatenate([part for part, _ in parts])
            arcs = _joined_arcs([part for _, part in parts])
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


def _between_points(family: Index, trail: Trail) -> Arcs:
    """The arcs between the points of a trail."""
    place = np.flatnonzero(trail.lane[1:] == trail.lane[:-1])
    ends = trail.at.of(place), trail.tangent[place], trail.at.of(place + 1), trail.tangent[place + 1]
    return Arcs(family[trail.lane[place]], place, *ends)


def _to_draw(arcs: Arcs) -> tuple[Int[np.ndarray, " found"], Arcs]:
    """What special points lie on arcs, as kinds, and the arcs of each: where other events are met, these first."""
    changed = (arcs.near.signature != arcs.far.signature).any(axis=1)
    kind, smooth = _turning(arcs.of(~changed))
    return np.concatenate([np.full(changed.sum(), EVENTS), kind]), _joined_arcs([arcs.of(changed), smooth])


def _turning(arcs: Arcs) -> tuple[Int[np.ndarray, " found"], Arcs]:
    """The kinds whose indicators change their signs on arcs, and the arcs of each."""
    found = [
        (KINDS.index(kind), np.flatnonzero(value(arcs.near, arcs.ahead) * value(arcs.far, arcs.ahead_far) < 0))
        for kind, value in INDICATORS.items()
    ]
    kind = np.concatenate([np.full(len(some), kind) for kind, some in found])
    return kind, arcs.of(np.concatenate([some for _, some in found]))


def _joined_arcs(parts: Sequence[Arcs]) -> Arcs:
    families, places, near, ahead, far, ahead_far = zip(*parts, strict=True)
    whole = (np.concatenate(one) for one in (families, places, ahead, ahead_far))
    family, place, ahead, ahead_far = whole
    return Arcs(family, place, joined_at(near), ahead, joined_at(far), ahead_far)


def _drawn(problem: Problem, kind: Int[np.ndarray, " arcs"], arcs: Arcs) -> tuple[Arcs, Flags]:
    """The arcs drawn together, each to what passes zero at points of its kind; where events change, the margin,
    which vanishes from one side at least, and passes zero to be negative where other events are met."""
    counts = arcs.near.signature

    def value(some: Index, at: At, ahead: Unknowns) -> PerLane:
        same = (at.signature == counts[some]).all(axis=1)
        found = np.where(same, 1.0, -1.0) * np.maximum(at.margin, np.finfo(float).tiny)
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

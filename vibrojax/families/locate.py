"""Special points of families: between which points they lie, and located there."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from vibrojax.families.indicators import INDICATORS, KINDS, holds
from vibrojax.families.problem import At, Flags, Index, PerLane, Problem, Unknowns, corrected, tangent
from vibrojax.families.walk import Trail

WITHIN = 1e-11
"""Distance over the scales of the two ends between which a point is located."""

CLOSE_ENDS = 1e-6
"""The same up to which it counts as located, where no orbits are found any nearer."""

SAME_TIME = 1e-2
"""Relative difference of the time of a repeat, at two neighbouring points, up to which the returns are the same."""

MOST_TURNS = 60

MOST_CHANGES = 8
"""Of events between two points of a trail."""

EVENTS = "events"
"""Instead of a kind, between points on which other events are met: what that is follows from what is found."""


class Arcs(NamedTuple):
    """Arcs with a point of a kind on each: `place` of the point of a trail that comes before, of the `family`; the
    equations at its two ends, and the tangents there."""

    kind: str
    place: Int[np.ndarray, " arcs"]
    family: Index
    near: At
    ahead: Unknowns
    far: At
    ahead_far: Unknowns

    def of(self, some: Flags) -> "Arcs":
        """Some of the arcs."""
        ends = self.near.of(some), self.ahead[some], self.far.of(some), self.ahead_far[some]
        return Arcs(self.kind, self.place[some], self.family[some], *ends)


class Special(NamedTuple):
    """Located points, of lanes: `at` and `tangent` there, on the near side; `kind` as a flag; `place` of the point of
    the trail that comes before; and `beyond`, the equations right behind."""

    kind: Int[np.ndarray, " points"]
    place: Int[np.ndarray, " points"]
    at: At
    tangent: Unknowns
    beyond: At


def candidates(family: Index, trail: Trail) -> list[Arcs]:
    """Where along a trail the indicators change their signs, and where other events are met."""
    same = trail.lane[1:] == trail.lane[:-1]
    with np.errstate(all="ignore"):
        changes = {kind: indicator(trail.at, trail.tangent) for kind, indicator in INDICATORS.items()}
        found = {kind: np.flatnonzero(same & (x[1:] * x[:-1] < 0)) for kind, x in changes.items()}
    counts = trail.at.signature
    found[EVENTS] = np.flatnonzero(same & (counts[1:] != counts[:-1]).any(axis=1))
    return [
        Arcs(
            kind,
            place,
            family[trail.lane[place]],
            trail.at.of(place),
            trail.tangent[place],
            trail.at.of(place + 1),
            trail.tangent[place + 1],
        )
        for kind, place in found.items()
        if len(place)
    ]


def located(problem: Problem, family: Index, trail: Trail) -> Special | None:
    """All special points of a trail, `family` (lanes,) being those of its lanes; None where there are none."""
    found: list[Special] = []
    with np.errstate(all="ignore"):
        for arcs in candidates(family, trail):
            if arcs.kind == EVENTS:
                found += _events(problem, arcs)
                continue
            fine, got = _refined(problem, arcs)
            right = got & holds(arcs.kind, fine.near.product)
            fine = fine.of(right)
            kind = np.full(len(fine.place), KINDS.place(arcs.kind))
            found.append(Special(kind, fine.place, fine.near, fine.ahead, fine.far))
    return joined(found)


def joined(found: list[Special]) -> Special | None:
    """All of them together."""
    if not found:
        return None
    kind, place, tangents = (np.concatenate([getattr(one, n) for one in found]) for n in ("kind", "place", "tangent"))
    at, beyond = (
        At(*(np.concatenate(some) for some in zip(*(getattr(one, name) for one in found), strict=True)))
        for name in ("at", "beyond")
    )
    return Special(kind, place, at, tangents, beyond)


def _events(problem: Problem, arcs: Arcs) -> list[Special]:
    """All points on arcs at which other events begin to be met, one after another."""
    found: list[Special] = []
    for _ in range(MOST_CHANGES):
        if not len(arcs.place):
            break
        fine, got = _refined(problem, arcs)
        found += by_events(fine.of(got))
        more = got & (fine.far.signature != arcs.far.signature).any(axis=1)
        fine, arcs = fine.of(more), arcs.of(more)
        arcs = Arcs(arcs.kind, arcs.place, arcs.family, fine.far, fine.ahead_far, arcs.far, arcs.ahead_far)
    return found


def by_events(arcs: Arcs) -> list[Special]:
    """Points at which impacts, or sticks and slips backwards, begin or vanish; where both do, one of each kind. Where
    the time of the repeat jumps it is the returns that are counted otherwise, and other events follow from that."""
    near, far = arcs.near, arcs.far
    period = near.times.sum(axis=1)
    section = ~(np.abs(far.times.sum(axis=1) - period) < SAME_TIME * period)
    impact = (near.impacts != far.impacts) & ~section
    # The first mode is the bit's slip: -1 backwards, 0 stuck.
    stick = (near.entered[:, 0, :2] != far.entered[:, 0, :2]).any(axis=1) & ~section
    other = ~impact & ~stick & ~section
    found = []
    for kind, some in (("grazing", impact | other), ("stick", stick), ("section", section)):
        if some.any():
            flags = np.full(some.sum(), KINDS.place(kind))
            found.append(Special(flags, arcs.place[some], near.of(some), arcs.ahead[some], far.of(some)))
    return found


def _refined(problem: Problem, arcs: Arcs) -> tuple[Arcs, Flags]:
    """The arcs, their ends drawn together to the point on them; and for which that was possible.

    By the Illinois variant of the false position, which draws both ends; where what passes zero is a step, by halves.
    """
    kind, place, family, near, ahead, far, ahead_far = arcs
    near, far = near.of(np.arange(len(place))), far.of(np.arange(len(place)))
    ahead, ahead_far = ahead.copy(), ahead_far.copy()
    row, counts = ahead.copy(), near.signature
    base = np.einsum("ij,ij->i", row, near.u)
    low, high = np.zeros(len(place)), np.einsum("ij,ij->i", row, far.u) - base
    f_low, f_high = _value(kind, near, ahead, counts), _value(kind, far, ahead_far, counts)
    side = np.zeros(len(place), int)
    active = np.arange(len(place))
    for turn in range(MOST_TURNS):
        apart = np.abs(far.u[active] - near.u[active]).max(axis=1)
        active = active[(apart > WITHIN) & (np.minimum(np.abs(f_low[active]), np.abs(f_high[active])) > 0)]
        if not len(active):
            break
        fa, fb = f_low[active], f_high[active]
        share = np.where((turn % 4 == 3) | (kind == EVENTS), 0.5, fa / (fa - fb))
        share = np.where(np.isfinite(share), np.clip(share, 1e-3, 1 - 1e-3), 0.5)
        guess = near.u[active] + share[:, None] * (far.u[active] - near.u[active])
        arc = low[active] + share * (high[active] - low[active])
        now, done = corrected(problem, family[active], guess, row[active], base[active] + arc)
        there = tangent(now.matrix, row[active])
        f = _value(kind, now, there, counts[active])
        stays = done & (np.sign(f) == np.sign(fa))
        passes = done & ~stays
        for mine, value, end, tangents, f_end, f_other, way in (
            (stays, low, near, ahead, f_low, f_high, 1),
            (passes, high, far, ahead_far, f_high, f_low, -1),
        ):
            lanes = active[mine]
            value[lanes], f_end[lanes], tangents[lanes] = arc[mine], f[mine], there[mine]
            end.put(lanes, now.of(mine))
            again = lanes[side[lanes] == way]
            f_other[again] /= 2
            side[lanes] = way
        active = active[done]
    got = np.abs(far.u - near.u).max(axis=1) < CLOSE_ENDS
    return Arcs(kind, place, family, near, ahead, far, ahead_far), got


def _value(kind: str, at: At, ahead: Unknowns, counts: Float[np.ndarray, "arcs counts"]) -> PerLane:
    """What passes zero at a point of the kind; where events change, a step."""
    if kind == EVENTS:
        return np.where((at.signature == counts).all(axis=1), 1.0, -1.0)
    return INDICATORS[kind](at, ahead)

"""Arcs of families, drawn together to the point on them where something passes zero."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Int

from vibrojax.analyses.continuation.problem import At, Flags, Index, PerLane, Problem, Unknowns, corrected, tangent
from vibrojax.analyses.continuation.vanishing import entered, foretold

WITHIN = 1e-10
"""Distance over the scales of the two ends between which a point is located."""

STEEP_WITHIN, SMALL = 1e-13, 1e-5
"""The same where a value without jumps is not small by then: beside a graze multipliers change as the root of the
distance."""

CLOSE_ENDS = 1e-6
"""The same up to which it counts as located, where no orbits are found any nearer."""

MOST_TURNS, MOST_FORETOLD = 60, 16
"""Of all, and of those that ask where the value is going to vanish; the others halve."""

BEYOND = 1e-2
"""Part of the bracket that a zero may be foretold outside of it."""

OTHERWISE = np.array([0.5, 0.1, 0.9, 0.01, 0.99])
"""Where on an arc an orbit is looked for after so many were not found: beside corners some planes have none."""


class Arcs(NamedTuple):
    """Arcs of lanes: their `family`; the `place` of the point of a trail that comes before; the equations at their two
    ends, and the tangents there."""

    family: Index
    place: Int[np.ndarray, " arcs"]
    near: At
    ahead: Unknowns
    far: At
    ahead_far: Unknowns

    def of(self, some: Flags | Index) -> "Arcs":
        """Some of the arcs."""
        return Arcs(
            self.family[some],
            self.place[some],
            self.near.of(some),
            self.ahead[some],
            self.far.of(some),
            self.ahead_far[some],
        )

    def turned(self) -> "Arcs":
        """The arcs from their far ends to their near ones."""
        return self._replace(near=self.far, ahead=self.ahead_far, far=self.near, ahead_far=self.ahead)


Value = Callable[[Index, At, Unknowns], PerLane]
"""`value(arcs, at, tangent)`: what passes zero on arcs, by index, at points of them."""


def drawn_together(problem: Problem, arcs: Arcs, value: Value, events: Flags) -> tuple[Arcs, Flags]:
    """The arcs with their ends at the point where `value` passes zero; and for which that was possible.

    Orbits are looked for where the value is foretold to vanish, or rather beside, by as much as that is in doubt, so
    that both ends are drawn in; by halves where nothing can be foretold. Where events begin or vanish the value may
    jump: then its signs tell the sides, and each side foretells for itself. Where they do (`events`), orbits may be
    found on one side only, because the map goes as a root on the other: then the end where fewer events are met is
    drawn to the last orbit of its kind, and the other stays.
    """
    drawing = _Drawing(problem, arcs.of(np.arange(len(arcs.place))), value, events)
    for turn in range(MOST_TURNS):
        drawing.turn(turn < MOST_FORETOLD)
        if not len(drawing.active):
            break
    return drawing.arcs, drawing.apart() < CLOSE_ENDS


class _Drawing:
    """Arcs on the way: the bracket `low` to `high` of each, lengths along the tangent at its first near end, and where
    in it the two ends are; the bracket may have moved on from them."""

    def __init__(self, problem: Problem, arcs: Arcs, value: Value, events: Flags) -> None:
        self._problem, self.arcs, self._value = problem, arcs, value
        lanes = np.arange(len(arcs.place))
        self.active = lanes
        self._row = arcs.ahead.copy()
        self._base = np.einsum("ij,ij->i", self._row, arcs.near.u)
        self._low, self._high = np.zeros(len(lanes)), np.einsum("ij,ij->i", self._row, arcs.far.u) - self._base
        self._low_at, self._high_at = self._low.copy(), self._high.copy()
        f_low, f_high = value(lanes, arcs.near, arcs.ahead), value(lanes, arcs.far, arcs.ahead_far)
        self._finest = np.full(len(lanes), WITHIN / 3)
        self._sign, self._exact = np.sign(f_low), (f_low == 0) | (f_high == 0)
        more = arcs.far.signature - arcs.near.signature
        self._jumps = events | (more != 0).any(axis=1)
        self._fewer = np.where(events, np.sign(more.sum(axis=1)), 0)
        self._misses = np.zeros(len(lanes), int)
        self._one_sided = np.zeros(len(lanes), bool)
        # What is known of the value: on the near side, on the far one, and of both.
        self._known_at, self._known = np.full((2, 3, len(lanes), 3), np.nan)
        for side, at, f in (
            (0, self._low, f_low),
            (1, self._high, f_high),
            (2, self._high, f_high),
            (2, self._low, f_low),
        ):
            self._learn(side, lanes, at, f)

    def apart(self) -> PerLane:
        """How far the ends are from each other, over the scales."""
        between = np.abs(self.arcs.far.u - self.arcs.near.u).max(axis=1)
        return np.where(self._one_sided, self._high - self._low, between)

    def turn(self, foretell: bool) -> None:
        """Look for one more orbit on each arc."""
        # At a kink the solutions at the two ends stay apart, however near their rows are to each other.
        wide = (self.apart() > WITHIN) & (self._high - self._low > WITHIN / 10)
        steep = ~wide & ~self._jumps & (self._high - self._low > STEEP_WITHIN)
        steep &= np.nanmin(np.abs(self._known[2, :, :2]), axis=1) > SMALL
        self._finest[steep] = STEEP_WITHIN / 3
        self.active = self.active[((wide | steep) & ~self._exact)[self.active]]
        lanes = self.active
        if not len(lanes):
            return
        low, high = self._low[lanes], self._high[lanes]
        arc = self._foretold(lanes) if foretell else (low + high) / 2
        others = OTHERWISE[np.minimum(self._misses[lanes], len(OTHERWISE) - 1)]
        arc = np.where((self._misses[lanes] > 0) & ~self._one_sided[lanes], low + others * (high - low), arc)
        guess, row = self._guess(lanes, arc), self._row[lanes]
        now, found = corrected(self._problem, self.arcs.family[lanes], guess, row, self._base[lanes] + arc)
        there = tangent(now.matrix, row)
        f = self._value(lanes, now, there)
        self._exact[lanes[found & (f == 0)]] = True
        stays = found & (np.sign(f) == self._sign[lanes])
        for side, mine in ((0, stays), (1, found & ~stays)):
            self._draw(side, lanes[mine], arc[mine], now.of(mine), there[mine], f[mine])
        self._miss(lanes[~found], arc[~found])
        self._misses[lanes[found]] = 0
        self.active = lanes[self._misses[lanes] < len(OTHERWISE)]

    def _draw(self, side: int, lanes: Index, arc: PerLane, now: At, ahead: Unknowns, f: PerLane) -> None:
        """Draw one end to where orbits were found."""
        if side == 0:
            self._low[lanes] = self._low_at[lanes] = arc
            self.arcs.near.put(lanes, now)
            self.arcs.ahead[lanes] = ahead
        else:
            self._high[lanes] = self._high_at[lanes] = arc
            self.arcs.far.put(lanes, now)
            self.arcs.ahead_far[lanes] = ahead
        self._learn(side, lanes, arc, f)
        self._learn(2, lanes, arc, f)

    def _miss(self, lanes: Index, arc: PerLane) -> None:
        """Where no orbits were found: beyond what there is, on arcs that have them on one side only."""
        fewer, known = self._fewer[lanes], self._one_sided[lanes]
        ahead, behind = known & (fewer > 0), known & (fewer < 0)
        self._high[lanes[ahead]] = arc[ahead]
        self._low[lanes[behind]] = arc[behind]
        self._one_sided[lanes] |= fewer != 0
        self._misses[lanes] = np.where(self._one_sided[lanes], 0, self._misses[lanes] + 1)

    def _learn(self, side: int, lanes: Index, at: PerLane, value: PerLane) -> None:
        entered(self._known_at[side], lanes, at)
        entered(self._known[side], lanes, value)

    def _foretold(self, lanes: Index) -> PerLane:
        """Where orbits are looked for."""
        low, high, jumps = self._low[lanes], self._high[lanes], self._jumps[lanes]
        arc, least = (low + high) / 2, np.full(len(lanes), np.inf)
        for side in range(3):
            at, doubt = foretold(self._known_at[side][lanes], self._known[side][lanes])
            beyond = np.maximum(np.maximum(low - at, at - high), 0)
            doubt = np.maximum(np.maximum(doubt, 2 * beyond), self._finest[lanes])
            with np.errstate(invalid="ignore"):
                sound = (jumps == (side < 2)) & (beyond < BEYOND * (high - low)) & (doubt < least)
            at = np.clip(at, low, high)
            to_wide = np.where(at - low > high - at, -1.0, 1.0)
            # Its own side learns more by it, until there is nothing left to learn.
            own = (-1.0, 1.0, to_wide)[side]
            way = np.where((doubt <= self._finest[lanes]) | (beyond > 0), to_wide, own)
            there = at + way * doubt
            there = np.where((there > low) & (there < high), there, at + to_wide * doubt)
            sound &= (there > low) & (there < high)
            arc, least = np.where(sound, there, arc), np.where(sound, doubt, least)
        return arc

    def _guess(self, lanes: Index, arc: PerLane) -> Unknowns:
        """The orbits there: between the ends by their tangents, or beside a jump from the nearer."""
        row, low, high = self._row[lanes], self._low_at[lanes], self._high_at[lanes]
        near, far = self.arcs.near.u[lanes], self.arcs.far.u[lanes]
        ahead, ahead_far = _along(self.arcs.ahead[lanes], row), _along(self.arcs.ahead_far[lanes], row)
        one_sided, fewer = self._one_sided[lanes], self._fewer[lanes]
        from_near = np.where(one_sided, fewer > 0, arc - low < high - arc)
        lone = np.where(
            from_near[:, None], near + (arc - low)[:, None] * ahead, far + (arc - high)[:, None] * ahead_far
        )
        whole, part = (high - low)[:, None], ((arc - low) / (high - low))[:, None]
        between = near + part * (far - near)
        between += (
            part * (1 - part) * ((1 - part) * (whole * ahead - far + near) - part * (whole * ahead_far - far + near))
        )
        return np.where(self._jumps[lanes][:, None], lone, between)


def _along(tangents: Unknowns, row: Unknowns) -> Unknowns:
    """Tangents of such a length that they go as far as a direction."""
    return tangents / np.einsum("ij,ij->i", tangents, row)[:, None]

"""Arcs of families, drawn together to the point on them where something passes zero."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Int

from vibrojax.families.problem import At, Flags, Index, PerLane, Problem, Unknowns, corrected, tangent

WITHIN = 1e-10
"""Distance over the scales of the two ends between which a point is located."""

CLOSE_ENDS = 1e-6
"""The same up to which it counts as located, where no orbits are found any nearer."""

MOST_TURNS = 60

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


Value = Callable[[Index, At, Unknowns], PerLane]
"""`value(arcs, at, tangent)`: what passes zero on arcs, by index, at points of them."""


def drawn_together(problem: Problem, arcs: Arcs, value: Value, by_halves: Flags) -> tuple[Arcs, Flags]:
    """The arcs with their ends at the point where `value` passes zero; and for which that was possible.

    By the Illinois variant of the false position, which draws both ends; where the value is a step, `by_halves`. Beside
    a step orbits may be found on one side only, because the map goes as a root on the other: then the end where fewer
    events are met is drawn to the last orbit of its kind, and the other stays.
    """
    every = np.arange(len(arcs.place))
    arcs = arcs.of(every)
    near, ahead, far, ahead_far = arcs.near, arcs.ahead, arcs.far, arcs.ahead_far
    row = ahead.copy()
    base = np.einsum("ij,ij->i", row, near.u)
    low, high = np.zeros(len(every)), np.einsum("ij,ij->i", row, far.u) - base
    low_at, high_at = low.copy(), high.copy()  # of the ends, from which the bracket may have moved on
    f_low, f_high = value(every, near, ahead), value(every, far, ahead_far)
    side, misses = np.zeros((2, len(every)), int)
    fewer = np.where(by_halves, np.sign(far.signature.sum(axis=1) - near.signature.sum(axis=1)), 0)
    one_sided = np.zeros(len(every), bool)
    active = every
    for turn in range(MOST_TURNS):
        apart = np.where(one_sided, high - low, np.abs(far.u - near.u).max(axis=1))[active]
        active = active[(apart > WITHIN) & (np.minimum(np.abs(f_low[active]), np.abs(f_high[active])) > 0)]
        if not len(active):
            break
        fa, fb = f_low[active], f_high[active]
        share = np.where((turn % 4 == 3) | by_halves[active], 0.5, fa / (fa - fb))
        share = np.where(np.isfinite(share), np.clip(share, 1e-3, 1 - 1e-3), 0.5)
        others = OTHERWISE[np.minimum(misses[active], len(OTHERWISE) - 1)]
        share = np.where((misses[active] > 0) & ~one_sided[active], others, share)
        arc = low[active] + share * (high[active] - low[active])
        along = (arc - low_at[active]) / (high_at[active] - low_at[active])
        guess = near.u[active] + along[:, None] * (far.u[active] - near.u[active])
        from_near, from_far = (
            end.u[active] + _onward(t[active], row[active], arc - at[active])
            for end, t, at in ((near, ahead, low_at), (far, ahead_far, high_at))
        )
        lone = np.where((fewer[active] > 0)[:, None], from_near, from_far)
        guess = np.where(one_sided[active][:, None], lone, guess)
        now, done = corrected(problem, arcs.family[active], guess, row[active], base[active] + arc)
        there = tangent(now.matrix, row[active])
        f = value(active, now, there)
        stays = done & (np.sign(f) == np.sign(fa))
        passes = done & ~stays
        for mine, length, at, end, tangents, f_end, f_other, way in (
            (stays, low, low_at, near, ahead, f_low, f_high, 1),
            (passes, high, high_at, far, ahead_far, f_high, f_low, -1),
        ):
            lanes = active[mine]
            length[lanes], at[lanes], f_end[lanes], tangents[lanes] = arc[mine], arc[mine], f[mine], there[mine]
            end.put(lanes, now.of(mine))
            f_other[lanes[side[lanes] == way]] /= 2
            side[lanes] = way
        missed = active[~done]
        high[missed] = np.where(one_sided[missed] & (fewer[missed] > 0), arc[~done], high[missed])
        low[missed] = np.where(one_sided[missed] & (fewer[missed] < 0), arc[~done], low[missed])
        one_sided[missed] |= fewer[missed] != 0
        misses[active] = np.where(done | one_sided[active], 0, misses[active] + 1)
        active = active[misses[active] < len(OTHERWISE)]
    together = np.where(one_sided, high - low, np.abs(far.u - near.u).max(axis=1)) < CLOSE_ENDS
    return arcs, together


def _onward(tangents: Unknowns, row: Unknowns, arc: PerLane) -> Unknowns:
    """How far to go along tangents, that it is so far along a direction."""
    return (arc / np.einsum("ij,ij->i", tangents, row))[:, None] * tangents

"""Changes of events at which both ends of a bracket stay apart: grazes at which a branch turns back, and jumps.

At a graze that the map passes continuously, the orbits of both sides lead to one orbit. Where static friction exceeds
kinetic friction, a stick that begins at a touch has a duration from its beginning on, so that the map jumps. The last
orbits of the two sides then differ, and the branch ends at the last orbit of its own side.
"""

import numpy as np

from vibrojax.periodic.brackets import ACCEPTED_WITHIN, Brackets
from vibrojax.periodic.problem import Points, Problem, Unknowns, towards

GRAZED_MARGIN = 1e-4
"""Largest grazing margin of a grazing point. The margin may vary as the square root of the distance, and points are
located, or branches stall, within `SHORTEST_STEP` (1e-9)."""

MARGIN_STEPS, CLOSER = 12, 0.9
"""Steps along a branch to the zero of its margin, and the share of the way to the predicted zero that each advances at
most."""

AT_GRAZE = 1e-11
"""Margin at which the steps end."""

CHORD_STEPS, CHORD_SHARES = 6, (0.9, 0.5, 0.2)
"""Steps towards a graze on the side with more events, and the shares of the way that are tried."""

JUMP_STEPS, JUMP_WITHIN = 80, 1e-12
"""Largest number of steps towards the last orbit on one side of a change, and the scaled step at which they end."""

LEAST_JUMP = 1e-5
"""Scaled distance of the last orbits from which on the map jumps. Next to grazes of impacts, where slopes are up to
5e5, rounding errors are up to 5e-7."""

BESIDE = (1e-6, 1e-5, 1e-4, 1e-3, 1e-2)
"""Scaled distances of the parameter from a graze at which an orbit with fewer events is sought."""

SAME_GRAZE = 1e-2
"""Scaled distance from a steep orbit within which the graze of the orbit with fewer events is its graze."""


def onto_grazes(problem: Problem, whole: Brackets, changes: Brackets) -> Brackets:
    """Return located changes of events, the ends of which stay apart, with both ends next to the change.

    A branch may turn back at a graze. The planes of its bracket then contain orbits of both sides, or of one side only,
    before the graze is reached. The end with fewer events follows its margin, which is smooth there, to zero. The other
    end follows the chord: special points may be between it and the graze. `whole`: the brackets that were shrunk.
    """
    ends = tuple(side.of(np.arange(len(changes.place))) for side in (changes.near, changes.far))
    apart = np.abs(changes.far.u - changes.near.u).max(axis=1, initial=0.0) > ACCEPTED_WITHIN
    more = (changes.far.signature - changes.near.signature).sum(axis=1)
    for k in np.flatnonzero(apart & (more != 0)).tolist():
        few, many = (0, 1) if more[k] > 0 else (1, 0)
        before, last, other = (whole.near, whole.far)[few].of([k]), ends[few].of([k]), ends[many].of([k])
        last = _at_zero_margin(problem, before, last)
        ends[few].put([k], last)
        chord, sign = last.u - other.u, 1.0 if many == 0 else -1.0
        for _ in range(CHORD_STEPS):
            length = float(np.linalg.norm(chord))
            closer = (_beside(problem, other, chord / length, share * length) for share in CHORD_SHARES)
            now = next((now for now in closer if now is not None), None)
            if now is None:
                break
            other = now.along(sign * now.tangent)
            chord = last.u - other.u
        ends[many].put([k], other)
    return changes._replace(near=ends[0], far=ends[1])


def end_at_jumps(problem: Problem, changes: Brackets) -> Brackets:
    """Return located changes of events; where the map jumps, `ends` is set and `near` is the last orbit of its side."""
    near, ends = changes.near.of(np.arange(len(changes.place))), changes.ends.copy()
    apart = np.abs(changes.far.u - changes.near.u).max(axis=1, initial=0.0)
    for k in np.flatnonzero((apart > ACCEPTED_WITHIN) & problem.scene.may_jump).tolist():
        sides = ((changes.near.of([k]), apart[k]), (changes.far.of([k]), -apart[k]))
        first, second = (_to_last_orbit(problem, side, step) for side, step in sides)
        off = np.abs(_at_no_margin(first) - _at_no_margin(second)).max()
        ends[k] = off > LEAST_JUMP
        if ends[k]:
            near.put([k], first.of([-1]))
    return changes._replace(near=near, ends=ends)


def _at_no_margin(points: Points) -> Unknowns:
    """Return the unknowns (1, unknowns) to which orbits with smaller and smaller margins lead, linearly in the margin.

    The orbits of the side with more events are smooth in the margin, not in the parameter.
    """
    way = points.of(points.margin >= 2 * points.margin[-1])
    if not len(way.u) or points.margin[-1] < AT_GRAZE:
        return points.u[-1:]
    near, far = points.of([-1]), way.of([-1])
    return np.asarray(near.u + (near.u - far.u) * near.margin / (far.margin - near.margin))


def _to_last_orbit(problem: Problem, point: Points, step: float) -> Points:
    """Return orbits with the events of a point, up to the last one along the branch; `step`: first scaled step."""
    way, failed = [point], False
    for _ in range(JUMP_STEPS):
        if abs(step) < JUMP_WITHIN:
            break
        now = _beside(problem, way[-1], way[-1].tangent, step)
        failed |= now is None
        way += [] if now is None else [now]
        step = step / 2 if failed else 2 * step
    return Points.join(way)


def _beside(problem: Problem, point: Points, row: Unknowns, step: float) -> Points | None:
    """Return the orbit with the same events at a distance from a point along `row`, or None."""
    guess = point.u + step * row
    now, converged = problem.correct(point.family, guess, row, np.einsum("ij,ij->i", row, guess))
    return now if converged[0] and (now.signature == point.signature).all() else None


def graze_beside(problem: Problem, point: Points) -> Points | None:
    """Return the graze next to an orbit with more events, as the end of the orbits with fewer, or None.

    On the side with more events the map has a square root, multipliers grow without limit, and branches stall short of
    the graze (Nordmark, *Journal of Sound and Vibration* 145 (1991), 279). On one side of its parameter, there is an
    orbit without these events, along which the margin is smooth.
    """
    for distance in BESIDE:
        for sign in (1.0, -1.0):
            row = towards(point.u, sign)
            guess = point.u + distance * row
            now, converged = problem.correct(point.family, guess, row, sign * guess[:, -1])
            fewer = now.signature.sum() < point.signature.sum()
            away = _beside(problem, now, row, distance) if converged[0] and fewer else None
            if away is None:
                continue
            graze = _at_zero_margin(problem, away, now)
            if graze.margin[0] < AT_GRAZE and np.abs(graze.u - point.u).max() < SAME_GRAZE:
                return graze
    return None


def _at_zero_margin(problem: Problem, before: Points, last: Points) -> Points:
    """Return the orbit to which two orbits of a branch lead as their margin, which is smooth there, goes to zero."""
    share = CLOSER
    for _ in range(MARGIN_STEPS):
        gained = float(before.margin[0] - last.margin[0])
        if last.margin[0] < AT_GRAZE or gained == 0:
            break
        row = last.tangent
        way = float((row @ (last.u - before.u)[0])[0])
        step = share * way * float(last.margin[0]) / gained
        now = _beside(problem, last, row, step) if abs(step) < abs(way) else None
        if now is None or now.margin[0] >= last.margin[0]:
            share /= 3  # the margin bends
        else:
            before, last, share = last, now, CLOSER
    return last

"""Changes of events at which both ends of a bracket stay apart: grazes at which a branch turns back, and jumps.

At a graze that the map passes continuously, the orbits of both sides lead to one orbit. Where static friction exceeds
kinetic friction, a stick that begins at a touch has a duration from its beginning on, so that the map jumps. The last
orbits of the two sides then differ, and the branch ends at the last orbit of its own side.
"""

import numpy as np

from vibrojax.periodic.brackets import ACCEPTED_WITHIN, Brackets
from vibrojax.periodic.problem import PerLane, Points, Problem, Unknowns, solve_bordered

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

NODES, NODE_RATIO = 1e-3 * 2.0 ** np.arange(6), 2.0
"""Margins from which a graze is extrapolated (at much smaller ones, events are too near to be told apart), and least
ratio of the margins of two points."""

NODE_POLISHES = 2
"""Newton steps after convergence, which is judged relative to the multipliers."""

EXTRAPOLATED_WITHIN = 1e-7
"""Largest scaled difference between extrapolations of a graze by polynomials of successive degrees."""


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
    for k in np.flatnonzero(apart > ACCEPTED_WITHIN).tolist():
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
    return _neville(np.append(points.margin[-1], way.margin[-1]), np.stack([points.u[-1], way.u[-1]]), 0.0)[-1]


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


def extrapolated_graze(problem: Problem, points: Points) -> Unknowns | None:
    """Return the unknowns (1, unknowns) at the graze to which a branch leads from the side with more events, or None.

    The map has a square root there, and multipliers grow without limit, so that the branch stalls short of the graze.
    In the velocity of the grazing impact, to which the margin is proportional, the branch is smooth (Nordmark, *Journal
    of Sound and Vibration* 145 (1991), 279). A polynomial through orbits with small margins leads to the margin zero.
    `points`: of one branch, the last one next to the graze.
    """
    same = (points.signature == points.signature[-1]).all(axis=1)
    known: list[int] = []
    for k in range(len(same) - 1, np.flatnonzero(~same).max(initial=-1), -1):
        if points.margin[k] >= (NODE_RATIO * points.margin[known[-1]] if known else NODES[0] / 2):
            known.append(k)
    known = known[: len(NODES)]
    if len(known) < 2:
        return None
    guess = np.concatenate([_neville(points.margin[known], points.u[known], m)[-1] for m in NODES])
    family, row = np.repeat(points.family[:1], len(guess)), np.repeat(guess[-1:] - guess[:1], len(guess), axis=0)
    row /= np.linalg.norm(row, axis=1, keepdims=True)
    level = np.einsum("ij,ij->i", row, guess)
    nodes, converged = problem.correct(family, guess, row, level)
    for _ in range(NODE_POLISHES):
        short = np.einsum("ij,ij->i", row, nodes.u) - level
        step = solve_bordered(nodes.matrix, row, -np.column_stack([nodes.off, short]))
        nodes = problem.evaluate(family, nodes.u + np.nan_to_num(step))
    nodes = nodes.of(converged & (nodes.signature == points.signature[-1]).all(axis=1))
    if len(nodes.u) < 3 or not (np.diff(nodes.margin) > 0).all():
        return None
    before, limit = _neville(nodes.margin, nodes.u, 0.0)[-2:]
    error = np.abs(limit - before).max()
    return limit if error < min(EXTRAPOLATED_WITHIN, np.abs(limit - points.u[-1]).max()) else None


def _neville(x: PerLane, y: Unknowns, at: float) -> list[np.ndarray]:
    """Return the values (1, columns) at one place of the polynomials through the first 1, 2, ... points."""
    rows, values = y, [y[:1]]
    for degree in range(1, len(x)):
        low, high = (x[:-degree] - at)[:, None], (x[degree:] - at)[:, None]
        rows = (high * rows[:-1] - low * rows[1:]) / (high - low)
        values.append(rows[:1])
    return values

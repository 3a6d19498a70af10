"""How families go on where the next point does not lie ahead: around corners, and where returns are counted otherwise.

Where an event begins or vanishes the return map has a kink, and a family a corner, which may be sharp enough to turn
back. Where the section is touched, the same motion has another number of returns.
"""

from typing import NamedTuple

import numpy as np

from vibrojax.analyses.continuation.problem import At, Flags, Index, PerLane, Problem, Unknowns, corrected, tangent
from vibrojax.measures.ledger import MOST_CYCLES

PROBES = (1e-9, 1e-8, 1e-7, 1e-6, 1e-5)
"""Distances over the scales at which the other side of a corner is looked for."""

LEAVING = (1e-6, 1e-5, 1e-4, 1e-3)
"""Distances at which the next point is looked for beyond a corner."""

SAME_TIME = 1e-2
"""Relative difference of the time of a repeat, at two neighbouring points, up to which the returns are the same."""

SAME_PERIOD = 1e-4
"""Relative difference of the time of a repeat, up to which the motion is the same with other returns."""


class Onward(NamedTuple):
    """Where a lane goes on: whether it does, a point there with its tangent, and the kind of what is passed."""

    found: Flags
    at: At
    tangent: Unknowns


def around(problem: Problem, family: Index, last: At, ahead: Unknowns, before: At) -> Onward:
    """The families beyond a corner.

    **Arguments:** `last`: the last points, and the tangents `ahead` there; `before`: points a little before, whose
    events are those of the side from which the corner was reached.
    """
    with np.errstate(all="ignore"):
        other = _other_side(problem, family, last, ahead, before.signature)
        lanes = len(family)
        found, best, tangents = np.zeros(lanes, bool), other.of(np.arange(lanes)), ahead.copy()
        along = _null(other.matrix)
        # Where the time of a repeat is another, returns are counted otherwise, and no corner is turned.
        period = last.times.sum(axis=1)
        same = np.abs(other.times.sum(axis=1) - period) < SAME_TIME * period
        for distance in LEAVING:
            for way in (1.0, -1.0):
                some = np.flatnonzero(~found & same & np.isfinite(along).all(axis=1))
                if not len(some):
                    break
                t = way * along[some]
                guess = last.u[some] + distance * t
                value = np.einsum("ij,ij->i", t, guess)
                now, right = corrected(problem, family[some], guess, t, value)
                right &= (now.signature == other.signature[some]).all(axis=1)
                right &= (now.signature != before.signature[some]).any(axis=1)
                right &= np.abs(now.u - guess).max(axis=1) < 0.5 * distance
                kept = some[right]
                found[kept] = True
                best.put(kept, now.of(right))
                tangents[kept] = tangent(now.matrix[right], t[right])
    return Onward(found, best, tangents)


def _other_side(problem: Problem, family: Index, last: At, ahead: Unknowns, counts: np.ndarray) -> At:
    """The equations right behind the corner."""
    other = last.of(np.arange(len(family)))
    for distance in PROBES:
        some = np.flatnonzero((other.signature == counts).all(axis=1) | ~np.isfinite(other.residual))
        if not len(some):
            break
        other.put(some, problem.at(family[some], last.u[some] + distance * ahead[some]))
    return other


def _null(matrix: np.ndarray) -> Unknowns:
    """The direction that each matrix takes to zero."""
    sound = np.isfinite(matrix).all(axis=(1, 2))
    found = np.linalg.svd(np.where(sound[:, None, None], matrix, 0.0))[2][:, -1]
    found[~sound] = np.nan
    return found


def counted_otherwise(problem: Problem, family: int, last: At, ahead: Unknowns) -> tuple[At, Unknowns] | None:
    """The same motion with another number of returns, right behind where the section is touched; None if there is none.

    **Arguments:** of one lane: its last point and the tangent there.
    """
    one = np.array([family])
    period, cycles = float(last.times.sum()), last.times.shape[1]
    for distance in (1e-7, 1e-6, 1e-5, 1e-4):
        u = last.u + distance * ahead
        value = problem.value(one, u)
        for begin in problem.states(one, u)[0]:
            states, total = [begin], 0.0
            for _ in range(min(cycles + 3, 2 * MOST_CYCLES)):
                now = problem.at(one, problem.unknowns(one, states[-1][None, None], value))
                total += float(now.times[0, 0])
                if not np.isfinite(total) or total > (1 + SAME_PERIOD) * period:
                    break
                if total > (1 - SAME_PERIOD) * period:
                    break
                states.append(states[-1] + now.off[0] * problem.scales[family])
            if abs(total - period) > SAME_PERIOD * period or len(states) == cycles or len(states) > MOST_CYCLES:
                continue
            guess = problem.unknowns(one, np.stack(states)[None], value)
            row = np.zeros_like(guess)
            row[:, -1] = 1.0
            now, found = corrected(problem, one, guess, row, guess[:, -1])
            if found[0] and np.abs(now.u - guess).max() < 100 * distance + 1e-3:
                return now, tangent(now.matrix, row * np.sign(ahead[:, -1:]))
    return None


def doubled(problem: Problem, at: At) -> tuple[Unknowns, Unknowns]:
    """The branches of twice the period at period doublings: the doubled unknowns, and the direction they leave in.

    By the eigenvector of -1: after one repeat a state beside the orbit is on its other side.
    """
    lanes, rows = len(at.u), problem.rows
    cycles = at.times.shape[1]
    values, vectors = np.linalg.eig(at.product)
    nearest = np.abs(values + 1).argmin(axis=1)
    first = np.take_along_axis(vectors, nearest[:, None, None], axis=2)[..., 0].real
    blocks = at.matrix[..., :-1].reshape(lanes, cycles, rows, cycles, rows)
    parts = [first]
    for k in range(cycles - 1):
        jacobian = blocks[:, k, :, k] + (0 if cycles > 1 else np.eye(rows))
        parts.append(np.einsum("ijk,ik->ij", jacobian, parts[-1]))
    half = np.concatenate(parts, axis=1)
    u = np.concatenate([at.u[:, :-1], at.u[:, :-1], at.u[:, -1:]], axis=1)
    ahead = np.concatenate([half, -half, np.zeros((lanes, 1))], axis=1)
    return u, ahead / np.linalg.norm(ahead, axis=1, keepdims=True)


def apart(u: Unknowns, ahead: Unknowns) -> PerLane:
    """How far doubled branches are from what they doubled from, along the direction they left in."""
    half = (u.shape[1] - 1) // 2
    return np.einsum("ij,ij->i", u[:, :half] - u[:, half:-1], ahead[:, :half])

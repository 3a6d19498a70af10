"""Switching between parts of branches: around corners, to other numbers of section crossings, and to doubled branches.

Where an event begins or vanishes, the return map has a kink. The branch has a corner there, which may be so sharp that
the branch turns back. Where the motion becomes tangent to the section, the branch continues with another number of
section crossings per period.
"""

from typing import NamedTuple

import numpy as np

from vibrojax.analyses.continuation.problem import Evaluation, Flags, Index, PerLane, Problem, Unknowns, unit_tangent
from vibrojax.measures.ledger import MOST_CYCLES

PROBE_DISTANCES = (1e-9, 1e-8, 1e-7, 1e-6, 1e-5)
"""Scaled distances behind a corner at which the other side of the corner is evaluated."""

DEPARTURE_DISTANCES = (1e-6, 1e-5, 1e-4, 1e-3)
"""Scaled distances between a corner and the first point beyond it."""

REINDEX_DISTANCES = (1e-7, 1e-6, 1e-5, 1e-4)
"""Scaled distances behind a tangency with the section at which section crossings are counted again."""

SAME_TIME = 1e-2
"""Largest relative difference of the period of the motion between neighbouring points with the same crossings."""

SAME_PERIOD = 1e-4
"""Largest relative difference of the period between two descriptions of one motion with different crossings."""


class CornerExit(NamedTuple):
    """Continuations beyond corners: mask `turned` of lanes with a continuation, and a point on it with its tangent."""

    turned: Flags
    evaluation: Evaluation
    tangent: Unknowns


def turn_corner(problem: Problem, family: Index, last: Evaluation, tangent: Unknowns, before: Evaluation) -> CornerExit:
    """Return points of the branches beyond corners.

    **Arguments:** `last`: the last points, with their `tangent`; `before`: points slightly before the corners, with the
    events of the side from which the corner was reached.
    """
    lanes = np.arange(len(family))
    with np.errstate(all="ignore"):
        other = last.of(lanes)
        for distance in PROBE_DISTANCES:
            subset = np.flatnonzero((other.signature == before.signature).all(axis=1) | ~np.isfinite(other.residual))
            if not len(subset):
                break
            other.put(subset, problem.evaluate(family[subset], last.u[subset] + distance * tangent[subset]))
        turned, best, tangents = np.zeros(len(lanes), bool), other.of(lanes), tangent.copy()
        sound = np.isfinite(other.matrix).all(axis=(1, 2))
        direction = np.linalg.svd(np.where(sound[:, None, None], other.matrix, 0.0))[2][:, -1]  # null vectors
        # A jump of the period means that other section crossings are counted, not that there is a corner.
        same = np.abs(other.period - last.period) < SAME_TIME * last.period
        for distance in DEPARTURE_DISTANCES:
            for sign in (1.0, -1.0):
                subset = np.flatnonzero(~turned & same & sound)
                if not len(subset):
                    break
                t = sign * direction[subset]
                guess = last.u[subset] + distance * t
                now, right = problem.correct(family[subset], guess, t, np.einsum("ij,ij->i", t, guess))
                right &= (now.signature == other.signature[subset]).all(axis=1)
                right &= (now.signature != before.signature[subset]).any(axis=1)
                right &= np.abs(now.u - guess).max(axis=1) < 0.5 * distance
                kept = subset[right]
                turned[kept] = True
                best.put(kept, now.of(right))
                tangents[kept] = unit_tangent(now.matrix[right], t[right])
    return CornerExit(turned, best, tangents)


def reindex_returns(
    problem: Problem, family: int, last: Evaluation, tangent: Unknowns
) -> tuple[Evaluation, Unknowns] | None:
    """Describe the motion with another number of section crossings, just behind a tangency with the section.

    Return the new point and its tangent, or None if there is no such description.

    **Arguments:** `last`, `tangent`: last point of one lane, and the tangent at this point.
    """
    lane = np.array([family])
    period, cycles = float(last.times.sum()), last.times.shape[1]
    for distance in REINDEX_DISTANCES:
        u = last.u + distance * tangent
        value = problem.value(lane, u)
        for begin in problem.states(lane, u)[0]:
            states, total = [begin], 0.0
            for _ in range(min(cycles + 3, 2 * MOST_CYCLES)):
                now = problem.evaluate(lane, problem.unknowns(lane, states[-1][None, None], value))
                total += float(now.times[0, 0])
                if not np.isfinite(total) or total > (1 - SAME_PERIOD) * period:
                    break
                states.append(states[-1] + now.off[0] * problem.scales[family])
            if abs(total - period) > SAME_PERIOD * period or len(states) == cycles or len(states) > MOST_CYCLES:
                continue
            guess = problem.unknowns(lane, np.stack(states)[None], value)
            row = np.zeros_like(guess)
            row[:, -1] = 1.0
            now, converged = problem.correct(lane, guess, row, guess[:, -1])
            if converged[0] and np.abs(now.u - guess).max() < 100 * distance + 1e-3:
                return now, unit_tangent(now.matrix, row * np.sign(tangent[:, -1:]))
    return None


def doubled_branch(problem: Problem, evaluation: Evaluation) -> tuple[Unknowns, Unknowns]:
    """Return the doubled unknowns at period doublings, and the tangents of the doubled branches.

    The tangent is the eigenvector of the multiplier -1: after one period of the original orbit, a neighbouring state is
    on the opposite side of that orbit.
    """
    lanes, rows = len(evaluation.u), problem.rows
    cycles = evaluation.times.shape[1]
    values, vectors = np.linalg.eig(evaluation.product)
    nearest = np.abs(values + 1).argmin(axis=1)
    parts = [np.take_along_axis(vectors, nearest[:, None, None], axis=2)[..., 0].real]
    blocks = evaluation.matrix[..., :-1].reshape(lanes, cycles, rows, cycles, rows)
    for k in range(cycles - 1):
        parts.append(np.einsum("ijk,ik->ij", blocks[:, k, :, k], parts[-1]))
    half = np.concatenate(parts, axis=1)
    u = np.concatenate([evaluation.u[:, :-1], evaluation.u], axis=1)
    tangent = np.concatenate([half, -half, np.zeros((lanes, 1))], axis=1)
    return u, tangent / np.linalg.norm(tangent, axis=1, keepdims=True)


def branch_distance(u: Unknowns, departure: Unknowns) -> PerLane:
    """Return the signed distance of doubled branches from the original branch, along the direction `departure`."""
    half = (u.shape[1] - 1) // 2
    return np.einsum("ij,ij->i", u[:, :half] - u[:, half:-1], departure[:, :half])

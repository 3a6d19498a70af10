"""Passage of branches through special points: corners and tangencies with the section.

Where an event begins or vanishes, the return map has a kink. The branch has a corner there, which may be so sharp that
the branch turns back. Where the motion becomes tangent to the section, the branch continues with another number of
section crossings per period.
"""

from collections.abc import Sequence

import numpy as np

from vibrojax.measures.ledger import MOST_CYCLES
from vibrojax.periodic.arclength import SHORTEST_STEP
from vibrojax.periodic.brackets import EVENT_CHANGE, Brackets
from vibrojax.periodic.location import SAME_TIME
from vibrojax.periodic.problem import Flags, PerLane, Points, Problem, Unknowns, towards

BEFORE_CORNER = 100 * SHORTEST_STEP
"""Scaled distance before a corner at which a point certainly has the events of the side before the corner."""

PROBE_DISTANCES = (1e-9, 1e-8, 1e-7, 1e-6, 1e-5)
"""Scaled distances behind a corner at which the other side of the corner is evaluated."""

DEPARTURE_DISTANCES = (1e-6, 1e-5, 1e-4, 1e-3)
"""Scaled distances between a corner and the first point beyond it."""

REINDEX_DISTANCES = (1e-7, 1e-6, 1e-5, 1e-4)
"""Scaled distances behind a tangency with the section at which section crossings are counted again."""

SAME_PERIOD = 1e-4
"""Largest relative difference of the period between two descriptions of one motion with different crossings."""


def turn_corner(problem: Problem, branches: Sequence[Points]) -> tuple[Flags, Brackets]:
    """Find the continuations of branches beyond the corners at their ends.

    **Arguments:** `branches`: points of each branch with equal numbers of unknowns, the last ones at the corners.

    **Returns:** a mask of the branches with a continuation, and brackets. `near` is a point of each branch slightly
    before the corner, with the events of that side. `far` is a point on the continuation or just behind the corner.
    """
    last = Points.join([branch.of([-1]) for branch in branches])
    away = [np.flatnonzero(np.abs(x.u - x.u[-1]).max(axis=1) > BEFORE_CORNER) for x in branches]
    before = Points.join([x.of([k[-1] if len(k) else 0]) for x, k in zip(branches, away, strict=True)])
    family, tangent = last.family, last.tangent
    lanes = np.arange(len(family))
    with np.errstate(all="ignore"):
        other = last.of(lanes)
        for distance in PROBE_DISTANCES:
            subset = np.flatnonzero((other.signature == before.signature).all(axis=1) | ~np.isfinite(other.residual))
            if not len(subset):
                break
            other.put(subset, problem.evaluate(family[subset], last.u[subset] + distance * tangent[subset]))
        turned, beyond = np.zeros(len(lanes), bool), other.of(lanes)
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
                beyond.put(kept, now.of(right))
    return turned, Brackets(np.full(len(lanes), EVENT_CHANGE), lanes, before, beyond)


def reindex_returns(problem: Problem, last: Points) -> Points | None:
    """Describe the motion with another number of section crossings, just behind a tangency with the section.

    Return the new point, or None if there is no such description. `last`: last point of one branch.
    """
    lane, tangent = last.family, last.tangent
    period, cycles = float(last.times.sum()), last.times.shape[1]
    for distance in REINDEX_DISTANCES:
        u = last.u + distance * tangent
        for begin in problem.states(lane, u)[0]:
            states, total = [begin], 0.0
            for _ in range(min(cycles + 3, 2 * MOST_CYCLES)):
                now = problem.evaluate(lane, problem.unknowns(lane, states[-1][None, None], problem.values(lane, u)))
                total += float(now.times[0, 0])
                if not np.isfinite(total) or total > (1 - SAME_PERIOD) * period:
                    break
                states.append(states[-1] + now.off[0, : problem.rows] * problem.scales[lane[0]])
            if abs(total - period) > SAME_PERIOD * period or len(states) == cycles or len(states) > MOST_CYCLES:
                continue
            guess = problem.unknowns(lane, np.stack(states)[None], problem.values(lane, u))
            now, converged = problem.correct(lane, guess, towards(guess, 1.0), guess[:, -1])
            if converged[0] and np.abs(now.u - guess).max() < 100 * distance + 1e-3:
                return now.along(towards(guess, np.sign(tangent[:, -1])))
    return None


def cross_impact(problem: Problem, last: Points) -> Points | None:
    """Describe the motion just behind a point at which an impact passes the time of a stroboscopic section.

    The states before and after the impact differ, although the motion changes smoothly. Return the new point, or None
    if no state at the section is at an impact. `last`: last point of one branch.
    """
    scene, lane, sign = problem.scene, last.family, np.sign(last.tangent[:, -1])
    states, parameters = problem.states(lane, last.u)[0], problem.parameters_at(lane, last.u)
    for cycle, state in enumerate(states):
        for other in scene.states_across_impacts(parameters, dict(zip(scene.return_states, state, strict=True))):
            rows = problem.rows
            mine, previous = (slice(k * rows, (k + 1) * rows) for k in (cycle, (cycle - 1) % len(states)))
            for distance in REINDEX_DISTANCES:
                guess = last.u + distance * last.tangent
                guess[0, mine] = other / problem.scales[lane[0]]
                if len(states) > 1:
                    guess[0, mine] += problem.evaluate(lane, guess).off[0, previous]
                now, converged = problem.correct(lane, guess, towards(guess, 1.0), guess[:, -1])
                if converged[0] and np.abs(now.u - guess).max() < 100 * distance + 1e-3:
                    return now.along(towards(guess, sign))
    return None


def branch_distance(u: Unknowns, departure: Unknowns) -> PerLane:
    """Return the signed distance of doubled branches from the original branch, along the direction `departure`."""
    half = (u.shape[1] - 1) // 2
    return np.einsum("ij,ij->i", u[:, :half] - u[:, half : 2 * half], departure[:, :half])

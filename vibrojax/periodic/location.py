"""Special points between successive points of branches: detection, location, classification, and passage through them.

A change of events hides other special points, because multipliers jump there. It is located first, and the parts of the
branch before and behind it are searched again.

Where an event begins or vanishes, the return map has a kink. The branch has a corner there, which may be so sharp that
the branch turns back. Where the motion becomes tangent to the section, the branch continues with another number of
section crossings per period.
"""

from collections.abc import Callable, Iterable, Sequence
from itertools import product

import numpy as np
from jaxtyping import Complex, Float, Int

from vibrojax.io.kinds import SPECIAL_KINDS
from vibrojax.measures.ledger import MOST_CYCLES
from vibrojax.periodic.arclength import SHORTEST_STEP, Branches
from vibrojax.periodic.brackets import ACCEPTED_WITHIN, EVENT_CHANGE, Brackets, TestFunction, shrink_brackets
from vibrojax.periodic.grazes import GRAZED_MARGIN, end_at_jumps, onto_grazes
from vibrojax.periodic.newton import multipliers
from vibrojax.periodic.problem import Flags, Index, PerLane, Points, Problem, Unknowns, towards
from vibrojax.periodic.return_map import across_impacts

MAX_EVENT_CHANGES = 32
"""Largest number of event changes that are located between two points of a branch. Where a flight vanishes, so do all
bounces behind it, one by one."""

CRITICAL_DISTANCE = 1e-3
"""Largest distance of a located point's multiplier from its critical value. Where events begin or vanish, multipliers
may jump over the critical value; such a point has another kind."""

SAME_MARGIN = 1e-4
"""Relative difference of the margin up to which it goes on from one side of a change to the other."""

SAME_TIME = 1e-2
"""Largest relative difference of the period of the motion between neighbouring points with the same crossings."""

Test = Callable[[Points, Points], PerLane]
"""`test(points, reference)`: test values; `reference`: points of the same branches that fix the signs of vectors."""


def pair_products(values: Complex[np.ndarray, "lanes multipliers"]) -> PerLane:
    """Return the product of mu_i mu_j - 1 over all pairs of multipliers.

    See Kuznetsov, *Elements of Applied Bifurcation Theory*, section 10.2.
    """
    first, second = np.triu_indices(values.shape[1], 1)
    return np.asarray(np.prod(values[:, first] * values[:, second] - 1, axis=1).real)


TEST_FUNCTIONS: dict[str, Test] = {
    "fold": lambda points, _: points.tangent[:, -1],
    "period-doubling": lambda points, _: np.linalg.det(points.product + np.eye(points.product.shape[1])),
    "torus": lambda points, _: pair_products(multipliers(points.product)),
}
"""Functions that change sign at special points, by kind: the tangent's component along the parameter; det(M + 1), where
M is the derivative of the map over one period of the motion; and `pair_products`."""


class Locator:
    """Location of the special points of families; a subclass replaces test functions, acceptance and names."""

    max_event_changes = MAX_EVENT_CHANGES

    def __init__(self, problem: Problem) -> None:
        self.problem = problem

    def tests(self, family: Index) -> Iterable[tuple[int, Flags, Test]]:
        """Return flag, mask of the lanes with this kind of special point, and test function of each kind."""
        every = np.ones(len(family), bool)
        return [(SPECIAL_KINDS.index(kind), every, test) for kind, test in TEST_FUNCTIONS.items()]

    def accepted(self, brackets: Brackets, shrunk: Brackets, test: TestFunction, lanes: Index) -> Brackets:
        """Return the special points among the `lanes` of brackets that were shrunk around zeros of their tests.

        Where two events exchange their order, the number of each is the same, but multipliers may jump.
        """
        parts = []
        for side in (shrunk, shrunk._replace(near=shrunk.far, far=shrunk.near)):
            critical = is_critical(side.kind[lanes], side.near.product[lanes])
            parts.append(side.of(lanes[critical]))
            lanes = lanes[~critical]
        left = shrunk.of(lanes)
        exchanged = left.of(multipliers_jump(left.near, left.far))
        return Brackets.join([*parts, exchanged.as_kind(SPECIAL_KINDS.index("grazing"))])

    def classified(self, changes: Brackets) -> Brackets:
        """Return located changes of events, each with its kind; nothing is called grazing although nothing grazes.

        The margin vanishes at a graze. If it goes on, other events have changed, such as the number of bounces that end
        in rest.
        """
        changes = end_at_jumps(self.problem, changes)
        # Where only one end of a bracket has moved to the change, it comes first: the end with fewer events.
        apart = np.abs(changes.far.u - changes.near.u).max(axis=1, initial=0.0) > ACCEPTED_WITHIN
        later = apart & (changes.far.margin < changes.near.margin) & ~changes.ends
        swapped = changes._replace(near=changes.far, far=changes.near)
        changes = classify_event_changes(self.problem, Brackets.join([changes.of(~later), swapped.of(later)]))
        near, far = changes.near.margin, changes.far.margin
        touches, goes_on = np.minimum(near, far) < GRAZED_MARGIN, np.abs(near - far) <= SAME_MARGIN * near
        grazing, stick = (changes.kind == SPECIAL_KINDS.index(kind) for kind in ("grazing", "stick"))
        return changes.of(changes.ends | ~(grazing & goes_on | (grazing | stick) & ~touches))

    def __call__(self, branches: Branches) -> Brackets:
        """Return the special points between the points of branches: `near` at the point, `far` just behind it."""
        with np.errstate(all="ignore"):
            brackets = self._detect(branches.brackets(np.arange(len(branches.lane) - 1)))
            located = [brackets.of(slice(0))]
            for _ in range(self.max_event_changes + 1):
                if not len(brackets.place):
                    break
                test = self._test_function(brackets)
                shrunk, success = shrink_brackets(self.problem, brackets, test)
                events = brackets.kind == EVENT_CHANGE
                located.append(self.accepted(brackets, shrunk, test, np.flatnonzero(success & ~events)))
                whole = brackets.of(success & events)
                change = onto_grazes(self.problem, whole, shrunk.of(success & events))
                located.append(self.classified(change))
                before, behind = whole._replace(far=change.near), whole._replace(near=change.far)
                parts = self._detect_smooth(before), self._detect(behind)
                brackets = Brackets.join([*parts, self._detect_smooth(brackets.of(~success & events))])
        return Brackets.join(located)

    def _detect(self, brackets: Brackets) -> Brackets:
        """Return the brackets with special points; a change of events hides points of other kinds."""
        changed = brackets.changes_events
        smooth = self._detect_smooth(brackets.of(~changed))
        return Brackets.join([brackets.of(changed).as_kind(EVENT_CHANGE), smooth])

    def _detect_smooth(self, brackets: Brackets) -> Brackets:
        """Return the brackets in which a test function changes sign."""
        parts = [brackets.of(slice(0))]
        for kind, mask, test in self.tests(brackets.near.family):
            own = brackets.of(mask)
            changed = test(own.near, own.near) * test(own.far, own.near) < 0
            parts.append(own.of(changed).as_kind(kind))
        return Brackets.join(parts)

    def _test_function(self, brackets: Brackets) -> TestFunction:
        """Return a function that evaluates the test function of each bracket's kind.

        For `EVENT_CHANGE` the test function is the grazing margin, which tends to zero from at least one side. It gets
        a negative sign where the events differ from those at the near end.
        """
        near, counts = brackets.near, brackets.near.signature

        def test(lanes: Index, points: Points) -> PerLane:
            same = (points.signature == counts[lanes]).all(axis=1)
            values = np.where(same, 1.0, -1.0) * np.maximum(points.margin, np.finfo(float).tiny)
            for kind, mask, function in self.tests(points.family):
                own = mask & (brackets.kind[lanes] == kind)
                if own.any():
                    values[own] = function(points.of(own), near.of(lanes[own]))
            return values

        return test


def classify_event_changes(problem: Problem, brackets: Brackets) -> Brackets:
    """Classify points at which events begin or vanish: impacts, sticks and reversals, or tangencies with the section.

    A point at which both impacts and sticks change is returned twice, once with each kind. If the duration of the
    period jumps, other section crossings are counted; such a point counts as a tangency only. All remaining changes
    count as grazing, if the scene has events.
    """
    near, far = brackets.near, brackets.far
    section = ~(np.abs(far.period - near.period) < SAME_TIME * near.period)
    impact = (near.impacts != far.impacts) & ~section
    # The mode of friction is -1 for reversed motion, and 0 for stick. An impact reverses the motion, too.
    slips = list(problem.scene.switch_places.values())
    reverses, sticks = (near.mode_changes[:, slips] != far.mode_changes[:, slips]).any(axis=1).T[:2]
    stick = (sticks | (reverses & ~impact)) & ~section
    other = ~stick & ~section & bool(problem.scene.guard_names)
    kinds = {"grazing": impact | other, "stick": stick, "section": section}
    return Brackets.join([brackets.of(mask).as_kind(SPECIAL_KINDS.index(kind)) for kind, mask in kinds.items()])


def is_critical(kind: Int[np.ndarray, " lanes"], product: Float[np.ndarray, "lanes states states"]) -> Flags:
    """Return a mask of lanes with a multiplier near the critical value of their `kind` (a flag)."""
    values = multipliers(product)
    fold, doubling = (np.abs(values - critical).min(axis=1) < CRITICAL_DISTANCE for critical in (1, -1))
    on_circle = np.abs(np.abs(values) - 1) < CRITICAL_DISTANCE
    torus = ((np.abs(values.imag) > CRITICAL_DISTANCE) & on_circle).any(axis=1)
    return np.select([kind == SPECIAL_KINDS.index(name) for name in TEST_FUNCTIONS], [fold, doubling, torus], False)


BEFORE_CORNER = 100 * SHORTEST_STEP
"""Scaled distance before a corner at which a point certainly has the events of the side before the corner."""

PROBE_DISTANCES = (1e-9, 1e-8, 1e-7, 1e-6, 1e-5)
"""Scaled distances behind a corner at which the other side of the corner is evaluated."""

PROBED_ORDERS = 2
"""Number of orders of events behind a corner in which orbits are sought."""

BENDS = (0.0, 0.1, 1.0, 10.0)
"""Relative distances ahead of the tangent behind a corner: the impacts that begin at a graze are as fast as the branch
is long, and as deep as its square."""

DEPARTURE_DISTANCES = (1e-6, 1e-5, 1e-4, 1e-3)
"""Scaled distances between a corner and the first point beyond it."""

REINDEX_DISTANCES = (1e-7, 1e-6, 1e-5, 1e-4)
"""Scaled distances behind a tangency with the section at which section crossings are counted again."""

AT_STOP = 1e-5
"""Largest gap at which a state is at an impact, relative to a typical gap."""

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
    lanes = np.arange(len(last.u))
    turned, beyond, known = np.zeros(len(lanes), bool), last.of(lanes), [before.signature]
    with np.errstate(all="ignore"):
        # Within rounding errors of a corner, events that coincide there may come in an order that no orbit has.
        for attempt in range(PROBED_ORDERS):
            open_lanes = np.flatnonzero(~turned)
            if not len(open_lanes):
                break
            other = _other_side(problem, last.of(open_lanes), [signature[open_lanes] for signature in known])
            found, onward = _continued(problem, before.of(open_lanes), last.of(open_lanes), other)
            turned[open_lanes] = found
            kept = found | (attempt == 0)
            beyond.put(open_lanes[kept], onward.of(kept))
            known.append(known[0].copy())
            known[-1][open_lanes] = other.signature
    return turned, Brackets(np.full(len(lanes), EVENT_CHANGE), lanes, before, beyond, np.zeros(len(lanes), bool))


def multipliers_jump(first: Points, second: Points) -> Flags:
    """Return a mask of neighbouring points, far from grazes, between which two events exchange their order.

    The number of each event is the same, but the derivative of the map is another one.
    """
    off = np.abs(first.product - second.product).max(axis=(1, 2))
    apart = off > CRITICAL_DISTANCE * np.maximum(1.0, np.abs(first.product).max(axis=(1, 2)))
    apart &= (first.signature == second.signature).all(axis=1)
    least = np.minimum(first.margin, second.margin)
    return np.asarray(apart & (least > GRAZED_MARGIN) & np.isfinite(least))


def _other_side(problem: Problem, last: Points, known: Sequence[np.ndarray]) -> Points:
    """Return the nearest probes behind corners with events other than the `known` signatures, else the last probes."""
    other = last.of(np.arange(len(last.u)))
    for distance in PROBE_DISTANCES:
        same = np.any([(other.signature == signature).all(axis=1) for signature in known], axis=0)
        same &= ~multipliers_jump(last, other)
        subset = np.flatnonzero(same | ~np.isfinite(other.residual))
        if not len(subset):
            break
        u = last.u[subset] + distance * last.tangent[subset]
        other.put(subset, problem.evaluate(last.family[subset], u))
    return other


def _continued(problem: Problem, before: Points, last: Points, other: Points) -> tuple[Flags, Points]:
    """Return a mask of the corners behind which orbits with the events of `other` go on, and points of these, or it.

    Where events change all along an orbit at once, as those of a circle about a stop, probes have events of both sides.
    A branch that turns back there is sought at the mirror images of the points before the corner.
    """
    turned, beyond = np.zeros(len(last.u), bool), other.of(np.arange(len(last.u)))
    sound = np.isfinite(other.matrix).all(axis=(1, 2))
    null = np.linalg.svd(np.where(sound[:, None, None], other.matrix, 0.0))[2][:, -1]  # null vectors
    mirrored = np.concatenate([last.tangent[:, :-1], -last.tangent[:, -1:]], axis=1)
    # A jump of the period means that other section crossings are counted, not that there is a corner.
    same = np.abs(other.period - last.period) < SAME_TIME * last.period
    exchanged = multipliers_jump(last, other)
    same &= (other.signature != before.signature).any(axis=1) | exchanged
    for distance, bend in product(DEPARTURE_DISTANCES, BENDS):
        for direction in (null, -null, mirrored):
            subset = np.flatnonzero(~turned & same & sound)
            if not len(subset):
                break
            t = direction[subset]
            guess = last.u[subset] + distance * (t + bend * distance * last.tangent[subset])
            now, right = problem.correct(last.family[subset], guess, t, np.einsum("ij,ij->i", t, guess))
            known = (before if direction is mirrored else other).signature[subset]
            right &= (now.signature == known).all(axis=1) != (direction is mirrored)
            right &= ~exchanged[subset] | multipliers_jump(last.of(subset), now)
            right &= np.abs(now.u - guess).max(axis=1) < 0.5 * distance
            kept = subset[right]
            turned[kept] = True
            beyond.put(kept, now.of(right))
    return turned, beyond


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
    lane, rows, cycles = last.family, problem.rows, last.times.shape[1]

    def sides(u: Unknowns, cycle: int) -> list[tuple[PerLane, np.ndarray]]:
        return across_impacts(problem.scene, problem.parameters_at(lane, u), problem.states(lane, u)[0][[cycle]])

    def across(distance: float, cycle: int, stop: int) -> Unknowns:
        """Return unknowns behind the last ones. The continued state penetrates the stop by as much as the motion."""
        u, mine, previous = last.u + distance * last.tangent, *(np.arange(rows) + k * rows for k in (cycle, cycle - 1))
        u[0, mine] = sides(u, cycle)[stop][1][0] / problem.scales[lane[0]]
        if cycles > 1:
            u[0, mine] += problem.evaluate(lane, u).off[0, previous]
        return u

    at_stop = [
        (k, stop) for k in range(cycles) for stop, (gap, _) in enumerate(sides(last.u, k)) if abs(gap) <= AT_STOP
    ]
    for cycle, stop in at_stop:
        for distance in REINDEX_DISTANCES:
            guess = across(distance, cycle, stop)
            # At a fixed parameter, the other orbit of a fold would be as near.
            row = across(2 * distance, cycle, stop) - guess
            if not np.isfinite(row).all():
                continue
            row /= np.linalg.norm(row)
            now, converged = problem.correct(lane, guess, row, np.einsum("ij,ij->i", row, guess))
            if converged[0] and np.abs(now.u - guess).max() < 100 * distance + 1e-3:
                return now
    return None

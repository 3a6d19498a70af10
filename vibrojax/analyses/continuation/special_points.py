"""Detection and location of special points between successive points of branches."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Int

from vibrojax.analyses.continuation.arclength import Branches
from vibrojax.analyses.continuation.brackets import EVENT_CHANGE, Brackets, shrink_brackets
from vibrojax.analyses.continuation.problem import Flags, Index, PerLane, Points, Problem
from vibrojax.analyses.continuation.switching import SAME_TIME
from vibrojax.io.kinds import SPECIAL_KINDS
from vibrojax.models.scenes import HasFriction
from vibrojax.periodic.newton import multipliers

MAX_EVENT_CHANGES = 8
"""Largest number of event changes that are located between two points of a branch."""

CRITICAL_DISTANCE = 1e-3
"""Largest distance of a located point's multiplier from its critical value. Where events begin or vanish, multipliers
may jump over the critical value; such a point has another kind."""


def _torus(points: Points) -> PerLane:
    """Return the product of mu_i mu_j - 1 over all pairs of multipliers.

    See Kuznetsov, *Elements of Applied Bifurcation Theory*, section 10.2.
    """
    values = multipliers(points.product)
    first, second = np.triu_indices(values.shape[1], 1)
    return np.prod(values[:, first] * values[:, second] - 1, axis=1).real


TEST_FUNCTIONS: dict[str, Callable[[Points], PerLane]] = {
    "fold": lambda points: points.tangent[:, -1],
    "period-doubling": lambda points: np.linalg.det(points.product + np.eye(points.product.shape[1])),
    "torus": _torus,
}
"""Functions that change sign at special points, by kind: the tangent's component along the parameter; det(M + 1), where
M is the derivative of the map over one period of the motion; and `_torus`."""


def locate_special_points(problem: Problem, branches: Branches) -> Brackets:
    """Return all special points between the points of branches: `near` at the special point, `far` just behind it.

    Multipliers jump where events begin or vanish. Such points are located first, then the special points between them.
    """
    with np.errstate(all="ignore"):
        brackets = _detect(branches.brackets(np.arange(len(branches.lane) - 1)))
        located = [brackets.of(slice(0))]
        for _ in range(MAX_EVENT_CHANGES + 1):
            if not len(brackets.place):
                break
            shrunk, success = shrink_brackets(problem, brackets, _test_function(brackets))
            events = brackets.kind == EVENT_CHANGE
            for side in (shrunk, shrunk._replace(near=shrunk.far, far=shrunk.near)):
                smooth = np.flatnonzero(success & ~events)
                smooth = smooth[is_critical(side.kind[smooth], side.near.product[smooth])]
                located.append(side.of(smooth))
                success[smooth] = False
            change, whole = shrunk.of(success & events), brackets.of(success & events)
            located.append(classify_event_changes(problem, change))
            before, behind = whole._replace(far=change.near), whole._replace(near=change.far)
            parts = _detect_smooth(before), _detect(behind), _detect_smooth(brackets.of(~success & events))
            brackets = Brackets.join(parts)
    return Brackets.join(located)


def classify_event_changes(problem: Problem, brackets: Brackets) -> Brackets:
    """Classify points at which events begin or vanish: impacts, sticks and reversals, or tangencies with the section.

    A point at which both impacts and sticks change is returned twice, once with each kind. If the duration of the
    period jumps, other section crossings are counted; such a point counts as a tangency only. All remaining changes
    count as grazing.
    """
    near, far = brackets.near, brackets.far
    section = ~(np.abs(far.period - near.period) < SAME_TIME * near.period)
    impact = (near.impacts != far.impacts) & ~section
    stick = np.zeros(len(section), bool)
    if isinstance(problem.scene, HasFriction):
        # The mode of the bit's slip is -1 for reversed motion, and 0 for stick.
        slip = problem.scene.mode_place("slip")
        stick = (near.mode_changes[:, slip, :2] != far.mode_changes[:, slip, :2]).any(axis=1) & ~section
    kinds = {"grazing": impact | (~stick & ~section), "stick": stick, "section": section}
    return Brackets.join([brackets.of(mask).as_kind(SPECIAL_KINDS.index(kind)) for kind, mask in kinds.items()])


def is_critical(kind: Int[np.ndarray, " lanes"], product: Float[np.ndarray, "lanes states states"]) -> Flags:
    """Return a mask of lanes with a multiplier near the critical value of their `kind` (a flag)."""
    values = multipliers(product)
    fold, doubling = (np.abs(values - critical).min(axis=1) < CRITICAL_DISTANCE for critical in (1, -1))
    on_circle = np.abs(np.abs(values) - 1) < CRITICAL_DISTANCE
    torus = ((np.abs(values.imag) > CRITICAL_DISTANCE) & on_circle).any(axis=1)
    return np.select([kind == SPECIAL_KINDS.index(name) for name in TEST_FUNCTIONS], [fold, doubling, torus], False)


def _detect(brackets: Brackets) -> Brackets:
    """Return the brackets with special points; a change of events hides points of other kinds."""
    changed = brackets.changes_events
    return Brackets.join([brackets.of(changed).as_kind(EVENT_CHANGE), _detect_smooth(brackets.of(~changed))])


def _detect_smooth(brackets: Brackets) -> Brackets:
    """Return the brackets in which a test function changes sign."""
    parts = []
    for kind, test in TEST_FUNCTIONS.items():
        changed = test(brackets.near) * test(brackets.far) < 0
        parts.append(brackets.of(changed).as_kind(SPECIAL_KINDS.index(kind)))
    return Brackets.join(parts)


def _test_function(brackets: Brackets) -> Callable[[Index, Points], PerLane]:
    """Return a function that evaluates the test function of each bracket's kind.

    For `EVENT_CHANGE` the test function is the grazing margin, which tends to zero from at least one side. It gets a
    negative sign where the events differ from those at the near end.
    """
    counts = brackets.near.signature

    def test(lanes: Index, points: Points) -> PerLane:
        same = (points.signature == counts[lanes]).all(axis=1)
        values = np.where(same, 1.0, -1.0) * np.maximum(points.margin, np.finfo(float).tiny)
        for name, function in TEST_FUNCTIONS.items():
            mask = brackets.kind[lanes] == SPECIAL_KINDS.index(name)
            if mask.any():
                values[mask] = function(points.of(mask))
        return values

    return test

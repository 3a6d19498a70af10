"""Detection and location of special points between successive points of branches."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Int

from vibrojax.analyses.continuation.arclength import BranchPoints
from vibrojax.analyses.continuation.brackets import BranchBrackets, shrink_brackets
from vibrojax.analyses.continuation.indicators import KINDS, TEST_FUNCTIONS, is_critical
from vibrojax.analyses.continuation.problem import Evaluation, Flags, Index, PerLane, Problem, Unknowns
from vibrojax.analyses.continuation.switching import SAME_TIME
from vibrojax.models.scenes import HasFriction

MAX_EVENT_CHANGES = 8
"""Largest number of event changes that are located between two points of a branch."""

EVENT_CHANGE = -1
"""Provisional kind of a bracket with different events at its ends; the located point determines the final kind."""

Kinds = Int[np.ndarray, " _"]


class SpecialPoints(NamedTuple):
    """Located special points: `kind` as a flag, and brackets with `near` at the point and `far` just behind it."""

    kind: Kinds
    brackets: BranchBrackets


def locate_special_points(problem: Problem, family: Index, points: BranchPoints) -> SpecialPoints | None:
    """Return all special points between the points of branches, or None if there are none.

    **Arguments:** `family` (lanes,): family index of each lane.

    Multipliers jump where events begin or vanish. Such points are located first, then the special points between them.
    """
    located: list[tuple[Kinds, BranchBrackets]] = []
    place = np.flatnonzero(points.lane[1:] == points.lane[:-1])
    with np.errstate(all="ignore"):
        kind, brackets = _detect(points.brackets(family[points.lane[place]], place))
        for _ in range(MAX_EVENT_CHANGES + 1):
            if not len(kind):
                break
            shrunk, success = _shrink(problem, kind, brackets)
            events = kind == EVENT_CHANGE
            for side in (shrunk, shrunk.reversed()):
                smooth = np.flatnonzero(success & ~events)
                smooth = smooth[is_critical(kind[smooth], side.near.product[smooth])]
                located.append((kind[smooth], side.of(smooth)))
                success[smooth] = False
            change, whole = shrunk.of(success & events), brackets.of(success & events)
            located += classify_event_changes(problem, change)
            before = whole._replace(far=change.near, far_tangent=change.near_tangent)
            behind = whole._replace(near=change.far, near_tangent=change.far_tangent)
            parts = _detect_smooth(before), _detect(behind), _detect_smooth(brackets.of(~success & events))
            kind, brackets = _join(parts)
    located = [part for part in located if len(part[0])]
    return SpecialPoints(*_join(located)) if located else None


def classify_event_changes(problem: Problem, brackets: BranchBrackets) -> list[tuple[Kinds, BranchBrackets]]:
    """Classify points at which events begin or vanish: impacts, sticks and reversals, or tangencies with the section.

    A point at which both impacts and sticks change has both kinds. If the duration of the period jumps, other section
    crossings are counted; such a point counts as a tangency only. All remaining changes count as grazing.
    """
    near, far = brackets.near, brackets.far
    section = ~(np.abs(far.period - near.period) < SAME_TIME * near.period)
    impact = (near.impacts != far.impacts) & ~section
    stick = np.zeros(len(section), bool)
    if isinstance(problem.scene, HasFriction):
        # The mode of the bit's slip is -1 for reversed motion, and 0 for stick.
        slip = problem.scene.mode_place("slip")
        stick = (near.mode_changes[:, slip, :2] != far.mode_changes[:, slip, :2]).any(axis=1) & ~section
    other = ~impact & ~stick & ~section
    kinds = (("grazing", impact | other), ("stick", stick), ("section", section))
    return [(np.full(mask.sum(), KINDS.index(kind)), brackets.of(mask)) for kind, mask in kinds if mask.any()]


def _detect(brackets: BranchBrackets) -> tuple[Kinds, BranchBrackets]:
    """Return the kinds and brackets of special points; a change of events hides points of other kinds."""
    changed = (brackets.near.signature != brackets.far.signature).any(axis=1)
    events = np.full(changed.sum(), EVENT_CHANGE), brackets.of(changed)
    return _join([events, _detect_smooth(brackets.of(~changed))])


def _detect_smooth(brackets: BranchBrackets) -> tuple[Kinds, BranchBrackets]:
    """Return the kinds and brackets for which a test function changes sign."""
    parts = []
    for kind, test in TEST_FUNCTIONS.items():
        near, far = test(brackets.near, brackets.near_tangent), test(brackets.far, brackets.far_tangent)
        subset = np.flatnonzero(near * far < 0)
        parts.append((np.full(len(subset), KINDS.index(kind)), brackets.of(subset)))
    return _join(parts)


def _join(parts: Sequence[tuple[Kinds, BranchBrackets]]) -> tuple[Kinds, BranchBrackets]:
    kinds, brackets = zip(*parts, strict=True)
    fields: list[Any] = [
        Evaluation.join(field) if isinstance(field[0], Evaluation) else np.concatenate(field)
        for field in zip(*brackets, strict=True)
    ]
    return np.concatenate(kinds), BranchBrackets(*fields)


def _shrink(problem: Problem, kind: Kinds, brackets: BranchBrackets) -> tuple[BranchBrackets, Flags]:
    """Shrink brackets to the zeros of the test functions of their kinds.

    For `EVENT_CHANGE` the test function is the grazing margin, which tends to zero from at least one side. It gets a
    negative sign where the events differ from those at the near end.
    """
    counts = brackets.near.signature

    def test(lanes: Index, evaluation: Evaluation, tangent: Unknowns) -> PerLane:
        same = (evaluation.signature == counts[lanes]).all(axis=1)
        values = np.where(same, 1.0, -1.0) * np.maximum(evaluation.margin, np.finfo(float).tiny)
        for name, function in TEST_FUNCTIONS.items():
            mine = kind[lanes] == KINDS.index(name)
            if mine.any():
                values[mine] = function(evaluation.of(mine), tangent[mine])
        return values

    return shrink_brackets(problem, brackets, test, kind == EVENT_CHANGE)

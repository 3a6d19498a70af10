"""The points of families in order, and their special points, from the legs that were followed."""

from collections.abc import Iterable
from itertools import groupby
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from vibrojax.analyses.continuation.indicators import KINDS, multipliers
from vibrojax.analyses.continuation.legs import Leg
from vibrojax.analyses.continuation.problem import At, Problem

SPACING = 0.02
"""Distance over the scales within which points that are not special are left out."""


class Point(NamedTuple):
    """One orbit of a family: `at` has it, of one lane."""

    family: int
    branch: int
    at: At


class SpecialPoint(NamedTuple):
    """A special point: its `kind` as a flag, the orbit there, and what there is to say."""

    kind: int
    point: Point
    note: str


class Columns(NamedTuple):
    """What points are, each (points,), of the multipliers (points, states)."""

    family: Int[np.ndarray, " points"]
    branch: Int[np.ndarray, " points"]
    value: Float[np.ndarray, " points"]
    cycles: Int[np.ndarray, " points"]
    period: Float[np.ndarray, " points"]
    impacts: Float[np.ndarray, " points"]
    margin: Float[np.ndarray, " points"]
    multiplier_abs: Float[np.ndarray, "points states"]
    multiplier_arg: Float[np.ndarray, "points states"]


def in_order(legs: Iterable[Leg]) -> tuple[list[Point], list[SpecialPoint]]:
    """The points of all branches, each from one end to the other, and the special points in the same order."""
    points: list[Point] = []
    special: list[SpecialPoint] = []
    ordered = sorted(legs, key=lambda leg: (leg.family, leg.branch, leg.way * (leg.number + 1)))
    for (family, branch), some in groupby(ordered, key=lambda leg: (leg.family, leg.branch)):
        for leg in some:
            along, marks = _with_marks(leg)
            # Against the way it was followed; where two legs meet at the branch's beginning it is there once.
            along = along[::-1] if leg.way < 0 else along
            same = points and (points[-1].family, points[-1].branch) == (family, branch)
            if same and along and _distance(points[-1].at, along[0]) < 1e-12:
                along = along[1:]
            points += [Point(family, branch, at) for at in along]
            special += marks[::-1] if leg.way < 0 else marks
    return points, special


def _with_marks(leg: Leg) -> tuple[list[At], list[SpecialPoint]]:
    """The orbits of a leg, its special ones among them, and those alone."""
    assert leg.at is not None
    found: list[At] = []
    marks: list[SpecialPoint] = []
    waiting = list(leg.marks)
    last = len(leg.at.u) - 1
    for k in range(last + 1):
        at = leg.at.of([k])
        if k in (0, last) or not found or _distance(found[-1], at) >= SPACING:
            found.append(at)
        while waiting and waiting[0].place <= k:
            mark = waiting.pop(0)
            marks.append(SpecialPoint(KINDS.index(mark.kind), Point(leg.family, leg.branch, mark.at), mark.note))
            if _distance(found[-1], mark.at) > 0:
                found.append(mark.at)
    return found, marks


def _distance(one: At, other: At) -> float:
    """Over the scales; infinite between orbits of other numbers of returns."""
    if one.u.shape != other.u.shape:
        return np.inf
    return float(np.abs(one.u - other.u).max())


def columns(problem: Problem, points: list[Point]) -> Columns:
    """What the points are."""
    rows = problem.rows
    values = multipliers(
        np.concatenate([point.at.product for point in points]) if points else np.zeros((0, rows, rows))
    )
    family = np.array([point.family for point in points], int)
    cycles = np.array([point.at.times.shape[1] for point in points], int)
    last = np.array([point.at.u[0, -1] for point in points], float)
    return Columns(
        family=family,
        branch=np.array([point.branch for point in points], int),
        value=last * problem.unit[family],
        cycles=cycles,
        period=np.array([point.at.times.sum() for point in points], float) / np.maximum(cycles, 1),
        impacts=np.array([point.at.impacts[0] for point in points], float),
        margin=np.array([point.at.margin[0] for point in points], float),
        multiplier_abs=np.abs(values),
        multiplier_arg=np.abs(np.angle(values)),
    )


def states(problem: Problem, points: list[Point]) -> Float[np.ndarray, "points states"]:
    """The first state at the section of each."""
    first = [point.at.u[0, : problem.rows] * problem.scales[point.family] for point in points]
    return np.array(first).reshape(len(points), problem.rows)

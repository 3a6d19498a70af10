"""Points of codimension two on curves: test functions, location, and names.

See Kuznetsov, *Elements of Applied Bifurcation Theory*, chapters 8 and 9, and di Bernardo et al., *Piecewise-smooth
Dynamical Systems*, chapter 9, for points with events.
"""

from collections.abc import Callable

import numpy as np

from vibrojax.analyses.continuation.arclength import Branches
from vibrojax.analyses.continuation.brackets import EVENT_CHANGE, Brackets, shrink_brackets
from vibrojax.analyses.continuation.problem import Index, PerLane, Points
from vibrojax.analyses.continuation.special_points import classify_event_changes
from vibrojax.analyses.curves.extended import EVENTS, CurveProblem
from vibrojax.analyses.curves.singular import signed_singular
from vibrojax.io.kinds import SPECIAL_KINDS
from vibrojax.periodic.newton import multipliers

MOST_CHANGES = 4
"""Largest number of event changes that are located between two points of a curve."""

JUMP = 1e-2
"""Largest value of a test function at a located point, relative to its values at the ends of the bracket. A test
function that jumps through zero has larger values."""

TOUCHES = 1e-3
"""Largest grazing margin of another event that begins or vanishes at a located point. An impact next to a graze of the
same guard is passed before its margin vanishes, see [vibrojax.analyses.curves.event_map][]."""

NAMES = {
    ("fold", "grazing"): "grazing-fold",
    ("period-doubling", "grazing"): "grazing-doubling",
    ("grazing", "grazing"): "double grazing",
    ("grazing", "stick"): "stick-graze",
}
"""Names of points at which a curve's own condition and another one hold; others are called "a and b"."""

Test = Callable[[Points, Points], PerLane]
"""`test(points, reference)`: test values; `reference`: points of the same curves that fix the signs of vectors."""


def name_of(kind: str, other: str) -> str:
    """Return the name of a point at which the conditions of two kinds hold."""
    first, second = sorted((kind, other), key=SPECIAL_KINDS.index)
    return NAMES.get((first, second), f"{first} and {second}")


def _cusp(points: Points, reference: Points) -> PerLane:
    """Return the quadratic coefficient w B(v, v) of the map on the centre manifold of a fold."""

    def vectors(points: Points) -> tuple[np.ndarray, np.ndarray]:
        size = points.u.shape[1] - 2
        return signed_singular(points.matrix[:, :size, :size])[1:]

    (w, v), (before, _) = vectors(points), vectors(reference)
    sign = np.sign(np.einsum("ij,ij->i", w, before))
    return np.asarray(sign * np.einsum("ij,ij->i", points.matrix[:, -1, :-2], v))


def _others(points: Points, critical: float) -> np.ndarray:
    """Return the multipliers without the one nearest to a critical value."""
    values = multipliers(points.product)
    nearest = np.abs(values - critical).argmin(axis=1)
    mask = np.arange(values.shape[1]) != nearest[:, None]
    return values[mask].reshape(len(values), -1)


def _pair(points: Points) -> tuple[PerLane, np.ndarray]:
    """Return half the sum of the pair of multipliers whose product is nearest to 1, and the remaining multipliers."""
    values = multipliers(points.product)
    i, j = np.triu_indices(values.shape[1], 1)
    nearest = np.abs(values[:, i] * values[:, j] - 1).argmin(axis=1)
    lanes = np.arange(len(values))
    first, second = i[nearest], j[nearest]
    mask = np.ones(values.shape, bool)
    mask[lanes, first] = mask[lanes, second] = False
    return ((values[lanes, first] + values[lanes, second]) / 2).real, values[mask].reshape(len(values), -1)


def cosine(points: Points) -> PerLane:
    """Return the cosine of the argument of the pair on the unit circle; beyond 1, the pair is real."""
    return _pair(points)[0]


def _product_of_pairs(values: np.ndarray) -> PerLane:
    i, j = np.triu_indices(values.shape[1], 1)
    return np.asarray(np.prod(values[:, i] * values[:, j] - 1, axis=1).real)


def _of_singular(critical: float) -> dict[str, Test]:
    """Return the tests of curves with the multiplier `critical`, 1 or -1."""
    own, flip = (f"1:{1 if critical > 0 else 2} resonance", "fold-flip")
    return {
        own: lambda points, _: np.prod(_others(points, critical) - critical, axis=1).real,
        flip: lambda points, _: np.prod(_others(points, critical) + critical, axis=1).real,
        name_of("fold" if critical > 0 else "period-doubling", "torus"): lambda points, _: _product_of_pairs(
            _others(points, critical)
        ),
    }


def _cosine_test(value: float) -> Test:
    return lambda points, _: cosine(points) - value


def tests_of(kind: str, flip_coefficient: Callable[[Points], PerLane]) -> dict[str, Test]:
    """Return the test functions of curves of one kind, by the name of the point at which they vanish."""
    if kind == "fold":
        return {"cusp": _cusp, **_of_singular(1.0)}
    if kind == "period-doubling":
        return {"generalised flip": lambda points, _: flip_coefficient(points), **_of_singular(-1.0)}
    if kind == "torus":
        strong = {"1:1": 1.0, "1:2": -1.0, "1:3": -0.5, "1:4": 0.0}
        tests = {f"{name} resonance": _cosine_test(value) for name, value in strong.items()}
        tests["fold and torus"] = lambda points, _: np.prod(_pair(points)[1] - 1, axis=1).real
        tests["period-doubling and torus"] = lambda points, _: np.prod(_pair(points)[1] + 1, axis=1).real
        return tests
    if kind == "hopf":  # the orbit has no amplitude, and one of its multipliers is 1
        return {}
    eye = lambda points: np.eye(points.product.shape[1])  # noqa: E731
    return {
        name_of(kind, "fold"): lambda points, _: np.linalg.det(points.product - eye(points)),
        name_of(kind, "period-doubling"): lambda points, _: np.linalg.det(points.product + eye(points)),
        name_of(kind, "torus"): lambda points, _: _product_of_pairs(multipliers(points.product)),
    }


ALL_NAMES = tuple(dict.fromkeys(name for kind in (*SPECIAL_KINDS[:3], *EVENTS) for name in tests_of(kind, cosine)))
"""Names of the points that test functions locate; points with another event are named by `name_of`."""


def locate(problem: CurveProblem, branches: Branches) -> list[tuple[int, str, Points]]:
    """Return the points of codimension two: index of the point of a branch before each, its name, and the point.

    Test functions jump where events change. Such points are located first, then the others between them.
    """
    located: list[tuple[int, str, Points]] = []
    with np.errstate(all="ignore"):
        brackets = _detect(problem, branches.brackets(np.arange(len(branches.lane) - 1)))
        for _ in range(MOST_CHANGES):
            if not len(brackets.place):
                break
            test = _test_function(problem, brackets)
            every = np.arange(len(brackets.place))
            ends = np.maximum(np.abs(test(every, brackets.near)), np.abs(test(every, brackets.far)))
            shrunk, success = shrink_brackets(problem, brackets, test)
            events = brackets.kind == EVENT_CHANGE
            least = np.minimum(np.abs(test(every, shrunk.near)), np.abs(test(every, shrunk.far)))
            for k in np.flatnonzero(success & ~events & (least < JUMP * ends)).tolist():
                located.append((int(shrunk.place[k]), ALL_NAMES[shrunk.kind[k]], shrunk.near.of([k])))
            changes = shrunk.of(success & events)
            for k in range(len(changes.place)):
                change = changes.of([k])
                if min(change.near.margin[0], change.far.margin[0]) < TOUCHES:
                    located += [(int(change.place[0]), name, change.near) for name in event_names(problem, change)]
            whole = brackets.of(success & events)
            before, behind = whole._replace(far=changes.near), whole._replace(near=changes.far)
            brackets = Brackets.join([_smooth(problem, before), _detect(problem, behind)])
    return located


def event_names(problem: CurveProblem, change: Brackets) -> list[str]:
    """Return the names of the point at which another event begins or vanishes on one curve."""
    kind = str(problem.kinds[change.near.family[0]])
    again = change.near.mode_changes[0, -1, 0] != change.far.mode_changes[0, -1, 0]
    if again:
        return [name_of(kind, kind)]
    classified = classify_event_changes(problem, change)
    return [name_of(kind, SPECIAL_KINDS[flag]) for flag in classified.kind]


def _detect(problem: CurveProblem, brackets: Brackets) -> Brackets:
    changed = brackets.changes_events
    return Brackets.join([brackets.of(changed).as_kind(EVENT_CHANGE), _smooth(problem, brackets.of(~changed))])


def _smooth(problem: CurveProblem, brackets: Brackets) -> Brackets:
    """Return the brackets in which a test function of the curve's kind changes sign, with the index of its name."""
    parts = [brackets.of(slice(0))]
    kinds = problem.kinds[brackets.near.family]
    for kind in np.unique(kinds):
        own = brackets.of(kinds == kind)
        for name, test in tests_of(str(kind), problem.flip_coefficient).items():
            changed = test(own.near, own.near) * test(own.far, own.near) < 0
            parts.append(own.of(changed).as_kind(ALL_NAMES.index(name)))
    return Brackets.join(parts)


def _test_function(problem: CurveProblem, brackets: Brackets) -> Callable[[Index, Points], PerLane]:
    """Return a function that evaluates the test function of each bracket; see `_detect` for their kinds."""
    counts, near = brackets.near.signature, brackets.near.of(slice(None))
    near = near.of(np.arange(len(near.u)))
    kinds = problem.kinds[near.family]

    def evaluate(lanes: Index, points: Points) -> PerLane:
        same = (points.signature == counts[lanes]).all(axis=1)
        values = np.where(same, 1.0, -1.0) * np.maximum(points.margin, np.finfo(float).tiny)
        for flag in np.unique(brackets.kind[lanes]):
            for kind in np.unique(kinds[lanes]) if flag != EVENT_CHANGE else ():
                mask = (brackets.kind[lanes] == flag) & (kinds[lanes] == kind)
                test = tests_of(str(kind), problem.flip_coefficient).get(ALL_NAMES[flag])
                if mask.any() and test is not None:
                    values[mask] = test(points.of(mask), near.of(lanes[mask]))
        return values

    return evaluate

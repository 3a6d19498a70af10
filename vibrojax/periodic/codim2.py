"""Points of codimension two on curves: test functions, location, and names.

See Kuznetsov, *Elements of Applied Bifurcation Theory*, chapters 8 and 9, and di Bernardo et al., *Piecewise-smooth
Dynamical Systems*, chapter 9, for points with events.
"""

from collections.abc import Callable, Iterator

import numpy as np

from vibrojax.io.kinds import SPECIAL_KINDS
from vibrojax.periodic.brackets import Brackets, TestFunction
from vibrojax.periodic.curve_equations import EVENTS, CurveProblem
from vibrojax.periodic.location import Locator, Test, classify_event_changes, pair_products
from vibrojax.periodic.newton import multipliers, signed_singular
from vibrojax.periodic.problem import Flags, Index, PerLane, Points

MAX_CURVE_EVENT_CHANGES = 3
"""Largest number of event changes that are located between two points of a curve."""

JUMP = 1e-2
"""Largest value of a test function at a located point, relative to its values at the ends of the bracket. A test
function that jumps through zero has larger values."""

TOUCHES = 1e-3
"""Largest grazing margin of another event that begins or vanishes at a located point. An impact next to a graze of the
same guard is passed before its margin vanishes, see [vibrojax.periodic.event_map][]."""

NAMES = {
    ("fold", "grazing"): "grazing-fold",
    ("period-doubling", "grazing"): "grazing-doubling",
    ("grazing", "grazing"): "double grazing",
    ("grazing", "stick"): "stick-graze",
}
"""Names of points at which a curve's own condition and another one hold; others are called "a and b"."""


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


def _of_singular(critical: float) -> dict[str, Test]:
    """Return the tests of curves with the multiplier `critical`, 1 or -1."""
    own, flip = (f"1:{1 if critical > 0 else 2} resonance", "fold-flip")
    return {
        own: lambda points, _: np.prod(_others(points, critical) - critical, axis=1).real,
        flip: lambda points, _: np.prod(_others(points, critical) + critical, axis=1).real,
        name_of("fold" if critical > 0 else "period-doubling", "torus"): lambda points, _: pair_products(
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
        name_of(kind, "torus"): lambda points, _: pair_products(multipliers(points.product)),
    }


CONTINUED = ("fold", "period-doubling", "torus", "grazing", "stick", "hopf")
"""Kinds of special points that are continued; the others depend on how returns are counted."""

CODIM2_NAMES = tuple(
    dict.fromkeys(
        [name for kind in CONTINUED for name in tests_of(kind, cosine)]
        + [name_of(kind, other) for kind in CONTINUED for other in (*EVENTS, "section", kind)]
    )
)
"""Names of the points of codimension two: those of test functions, and those at which another event begins."""


class CodimensionTwo(Locator):
    """Location of the points of codimension two of curves."""

    max_event_changes = MAX_CURVE_EVENT_CHANGES
    problem: CurveProblem

    def tests(self, family: Index) -> Iterator[tuple[int, Flags, Test]]:
        """Yield flag, mask of the lanes on curves of one kind, and test function of each kind of point."""
        kinds = self.problem.kinds[family]
        for kind in np.unique(kinds):
            for name, test in tests_of(str(kind), self.problem.flip_coefficient).items():
                yield CODIM2_NAMES.index(name), kinds == kind, test

    def accepted(self, brackets: Brackets, shrunk: Brackets, test: TestFunction, lanes: Index) -> Brackets:
        """Return the points among the `lanes` of shrunk brackets in which the test function does not jump."""
        before = np.maximum(*(np.abs(test(lanes, end.of(lanes))) for end in (brackets.near, brackets.far)))
        least = np.minimum(*(np.abs(test(lanes, end.of(lanes))) for end in (shrunk.near, shrunk.far)))
        return shrunk.of(lanes[least < JUMP * before])

    def classified(self, changes: Brackets) -> Brackets:
        """Return located changes of other events, each with its names."""
        parts = [changes.of(slice(0))]
        for k in np.flatnonzero(np.minimum(changes.near.margin, changes.far.margin) < TOUCHES).tolist():
            change = changes.of([k])
            parts += [change.as_kind(CODIM2_NAMES.index(x)) for x in event_names(self.problem, change)]
        return Brackets.join(parts)


def event_names(problem: CurveProblem, change: Brackets) -> list[str]:
    """Return the names of the point at which another event begins or vanishes on one curve."""
    kind = str(problem.kinds[change.near.family[0]])
    again = change.near.mode_changes[0, -1, 0] != change.far.mode_changes[0, -1, 0]
    if again:
        return [name_of(kind, kind)]
    classified = classify_event_changes(problem, change)
    return [name_of(kind, SPECIAL_KINDS[flag]) for flag in classified.kind]

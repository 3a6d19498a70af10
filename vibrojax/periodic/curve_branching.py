"""Curves that begin at points of codimension two on other curves, and curves that were continued twice."""

from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float

from vibrojax.io.kinds import SPECIAL_KINDS
from vibrojax.periodic.codim2 import NAMES
from vibrojax.periodic.curve_equations import EVENTS, CurveProblem, antiperiodic
from vibrojax.periodic.curve_following import NEAR_START, Curve, between, continue_both_ways
from vibrojax.periodic.event_map import conditions_of
from vibrojax.periodic.newton import signed_singular
from vibrojax.periodic.problem import Points
from vibrojax.periodic.segments import Mark

MAX_CURVES = 40
"""Largest number of curves that begin at points of codimension two; each of the drill takes about half a second."""

FEWEST_POINTS = 4
"""Smallest number of points of a curve that begins at a point of codimension two. Of a pair of real multipliers whose
product is 1, as of a curve that has no orbits on either side, fewer points are found."""

MAX_ROUNDS = 3
"""Largest number of points of codimension two between a special point of the family and a curve."""

SAME_CURVE = 2e-3
"""Scaled distance from a curve within which a point lies on it; curves are interpolated to about a tenth of it."""

OFFSETS = (0.0, 1e-5, -1e-5, 1e-4, -1e-4)
"""Scaled distances from a point of codimension two at which its other curve is sought. Where an event begins at the
point, the other curve may have orbits on one side only."""

AMPLITUDE = 0.05
"""Scaled amplitude of the doubled orbit at which the curve of its folds begins, next to a generalised flip. The folds'
equations are singular at the flip itself."""

AT_EVENT = 1e-7
"""Signed margin at a special point up to which a condition holds within the accuracy of the point."""

NEAR_EVENT = 1e-3
"""Largest signed margin at a special point of the condition that its curve satisfies."""


def other_kind(name: str, kind: str) -> str | None:
    """Return the kind of the curve that meets a curve of `kind` at a point of codimension two, or None."""
    if name in ("1:1 resonance", "1:2 resonance"):
        torus = {"1:1 resonance": "fold", "1:2 resonance": "period-doubling"}[name]
        return torus if kind == "torus" else "torus"
    if name == "generalised flip":
        return "fold"
    names = {name: kinds for kinds, name in NAMES.items()} | {"fold-flip": ("fold", "period-doubling")}
    kinds = list(names.get(name, tuple(name.split(" and "))))
    if len(kinds) != 2 or kind not in kinds:
        return None
    kinds.remove(kind)
    return kinds[0] if kinds[0] in (*SPECIAL_KINDS[:3], *EVENTS) else None


def condition_at(
    problem: CurveProblem, curve: int, u: np.ndarray, own: np.ndarray | None = None
) -> Float[np.ndarray, " conditions"]:
    """Return the choice of the event whose signed margin is zero at a point; zeros if there is none.

    `own`: choice of a condition that holds there as well, and is not meant.
    """
    choices = np.eye(problem.chosen.shape[1])
    if not len(choices):  # the system has no events
        return np.zeros(0)
    every = np.full(len(choices), curve)
    with np.errstate(all="ignore"):
        margins = problem.margins(every, np.repeat(u[None], len(choices), axis=0), choices)
    least = np.nan_to_num(np.abs(margins), nan=np.inf).min(axis=1)
    if own is not None:
        least[own > 0] = np.inf
    # Next to a stick that begins and ends at once, the conditions of its switch hold, too; those of minima are first.
    nearest = int(np.argmax(least < AT_EVENT)) if (least < AT_EVENT).any() else int(least.argmin())
    return choices[nearest] if least[nearest] < NEAR_EVENT else np.zeros(len(choices))


def passes(problem: CurveProblem, curve: Curve, point: Points) -> bool:
    """Return whether a curve passes through a point of another curve, whatever crossing its orbit is listed from."""
    rows, mine, others = problem.rows, curve.number, int(point.family[0])
    ratio = problem.scales[others] / problem.scales[mine]
    states = (point.u[0, :-2].reshape(-1, rows) * ratio).ravel()
    for part in curve.parts:
        if part.u.shape[1] != point.u.shape[1] or not len(part.u):
            continue
        for shift in range(0, len(states), rows):
            u = np.append(np.roll(states, shift), point.u[0, -2:])
            if np.abs(part.u - u).max(axis=1).min() < SAME_CURVE:
                return True
            way = np.diff(part.u, axis=0)
            share = np.einsum("ij,ij->i", u - part.u[:-1], way) / np.maximum((way**2).sum(axis=1), 1e-300)
            inside = np.flatnonzero((share > 0) & (share < 1))
            if len(inside) and np.abs(between(part, inside, share[inside]) - u).max(axis=1).min() < SAME_CURVE:
                return True
    return False


def _alike(problem: CurveProblem, first: int, second: int) -> bool:
    """Return whether two curves have the same condition and the same fixed parameters."""
    # The name of an event depends on what changes, its condition does not.
    same = problem.kinds[first] == problem.kinds[second] or set(problem.kinds[[first, second]]) <= set(EVENTS)
    same &= bool((problem.chosen[first] == problem.chosen[second]).all())
    fixed = (x for name, x in problem.parameters.items() if name not in problem.along)
    return bool(same) and all(x[first] == x[second] for x in fixed)


def without_duplicates(problem: CurveProblem, curves: list[Curve]) -> list[Curve]:
    """Return the curves without those whose special point lies on an earlier one, which gets a note."""
    kept: list[Curve] = []
    for curve in curves:
        others = [x for x in kept if _alike(problem, x.number, curve.number)]
        same = [x for x in others if curve.begin is not None and passes(problem, x, curve.begin)]
        if not same:
            kept.append(curve)
        elif curve.special >= 0:
            same[0].notes.append(f"passes special point {curve.special}, too")
    return kept


def with_branches(problem: CurveProblem, curves: list[Curve]) -> tuple[CurveProblem, list[Curve]]:
    """Return all curves with those that begin at their points of codimension two, and the equations of all."""
    fresh, begun = curves, 0
    for _ in range(MAX_ROUNDS):
        every = [Curve(number) for number in range(len(problem.kinds))]
        marks = [(curve, mark) for curve in fresh for mark in curve.marks]
        begins: list[Points] = []
        for curve, mark in marks:
            kind = other_kind(mark.kind, str(problem.kinds[curve.number]))
            if kind is None:
                continue
            extended = _extended(problem, curve, mark, kind)
            number = len(problem.kinds)
            if extended is None:
                continue
            doubled = mark.kind == "generalised flip"
            begin = _begin_doubled(extended, mark, number) if doubled else _begin(extended, mark, number)
            point = begin if doubled and begin is not None else mark.orbit
            if any(_alike(extended, x.number, number) and passes(extended, x, point) for x in curves):
                continue
            if begin is None:
                continue
            same = [x for x in begins if _alike(extended, int(x.family[0]), number) and x.u.shape == begin.u.shape]
            if any(np.abs(x.u - begin.u).max() < SAME_CURVE for x in same):
                continue
            if begun >= MAX_CURVES:
                note = f"further curves begin here; {MAX_CURVES} of them are followed"
                curve.notes += [note] * (note not in curve.notes)
                continue
            problem, begun = extended, begun + 1
            begins.append(begin)
            values = zip(problem.along, problem.values(mark.orbit.family, mark.orbit.u)[0], strict=True)
            place = ", ".join(f"{name} = {value:.6g}" for name, value in values)
            every.append(Curve(number, notes=[], origin=f"begins at the point {mark.kind} at {place}"))
        if not begins:
            break
        continue_both_ways(problem, begins, every, lambda ends: None)
        further = [every[int(begin.family[0])] for begin in begins]
        further = [x for x in further if sum(len(part.u) for part in x.parts) >= FEWEST_POINTS]
        fresh = without_duplicates(problem, [*curves, *further])[len(curves) :]
        for curve in fresh:
            curve.notes.insert(0, curve.origin)
        curves = [*curves, *fresh]
    return problem, curves


def _extended(problem: CurveProblem, curve: Curve, mark: Mark, kind: str) -> CurveProblem | None:
    """Return the equations with those of a further curve, of another kind than `curve`; None without a condition."""
    k = curve.number
    chosen = np.zeros(problem.chosen.shape[1])
    if kind in EVENTS:
        chosen = condition_at(problem, k, mark.orbit.u[0], problem.chosen[k])
        if not chosen.any():
            return None
        guard, _ = conditions_of(problem.scene)[int(chosen.argmax())]
        kind = "stick" if guard in problem.scene.switch_places else "grazing"

    def again(x: np.ndarray) -> np.ndarray:
        return np.concatenate([x, x[[k]]])

    arrays: dict[str, Any] = {name: again(getattr(problem, name)) for name in ("scales", "unit", "first", "last")}
    return replace(
        problem,
        parameters={name: again(x) for name, x in problem.parameters.items()},
        **arrays,
        kinds=np.append(problem.kinds, kind),
        chosen=np.concatenate([problem.chosen, chosen[None]]),
    )


def _begin(problem: CurveProblem, mark: Mark, number: int) -> Points | None:
    """Return the first point of a curve next to a point of codimension two, with its tangent; None if there is none."""
    curve, across = np.array([number]), mark.orbit.matrix[0, -1]
    across = across / max(float(np.linalg.norm(across)), 1e-300)
    with np.errstate(all="ignore"):
        for offset in OFFSETS if np.isfinite(across).all() else OFFSETS[:1]:
            u = mark.orbit.u + offset * across
            now = problem.evaluate(curve, u)
            if not (np.isfinite(now.matrix).all() and np.isfinite(now.residual).all()):
                continue
            row = np.linalg.svd(now.matrix)[2][:, -1]
            begin, converged = problem.correct(curve, u, row, np.einsum("ij,ij->i", row, u))
            if converged[0] and np.abs(begin.u - mark.orbit.u).max() < NEAR_START and np.isfinite(begin.tangent).all():
                return begin
    return None


def _begin_doubled(problem: CurveProblem, mark: Mark, number: int) -> Points | None:
    """Return a fold of the doubled orbit next to a generalised flip, with its tangent; None if there is none."""
    point, curve = mark.orbit, np.array([number])
    states, parameters = point.u[:, :-2], point.u[:, -2:]
    shooting = point.matrix[:, : states.shape[1], : states.shape[1]]
    _, _, v = signed_singular(antiperiodic(shooting, problem.rows))
    row = np.concatenate([v, -v, np.zeros_like(parameters)], axis=1)
    u = np.concatenate([states, states, parameters], axis=1) + AMPLITUDE * row
    with np.errstate(all="ignore"):
        begin, converged = problem.correct(curve, u, row, np.einsum("ij,ij->i", row, u))
    near = np.abs(begin.u - u).max() < AMPLITUDE
    return begin if converged[0] and near and np.isfinite(begin.tangent).all() else None

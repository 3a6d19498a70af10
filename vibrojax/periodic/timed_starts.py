"""Beginnings of families without a section: orbits by their crossings or by one state, and orbits at a Hopf point."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from jaxtyping import Float

from vibrojax.periodic.flow_map import Flow, moving_names
from vibrojax.periodic.problem import FAMILY_ACCURACY, Index, PerLane, Points, Problem
from vibrojax.periodic.timed_problem import TimedProblem

GROWTH = 30.0
"""Largest growth of a small distance over a part of the first orbit; along the family it may become greater."""

LEAST_PARTS, HOPF_PARTS, MOST_PARTS = 4, 16, 64
"""Numbers of parts: of the simplest orbits, of those that begin at a Hopf point and still change much, and the most."""

AMPLITUDES = (2e-2, 5e-3, 1e-3)
"""Scaled amplitudes that are tried for the first orbit near a Hopf point."""

GROWN, MOST_GROWN = 1.5, 40
"""Ratio of the amplitudes of successive orbits that grow from a Hopf point, and their largest number."""

States = Float[np.ndarray, "orbits states"]


def free_problem(
    problem: Problem, families: Index, unknowns: Sequence[np.ndarray]
) -> tuple[TimedProblem, list[np.ndarray]]:
    """Return the equations without a section, and the unknowns of the same orbits.

    **Arguments:** `problem`, `unknowns`: equations with the states at the section, and the orbits of `families`.
    """
    scene, names = problem.scene, moving_names(problem.scene)
    begin, period, values = np.zeros((len(families), len(names))), np.ones(len(families)), np.zeros(len(families))
    for k, (number, u) in enumerate(zip(families.tolist(), unknowns, strict=True)):
        point = problem.evaluate(np.array([number]), u[None])
        section = dict(zip(scene.return_states, problem.states(point.family, point.u)[0, 0], strict=True))
        begin[k] = [section.get(name, 0.0) for name in names]
        period[k], values[k] = point.period[0], problem.values(point.family, point.u)[0, 0]
    return through(problem, families, begin, period, values)


def through(
    problem: Problem, families: Index, begin: States, period: PerLane, values: PerLane
) -> tuple[TimedProblem, list[np.ndarray]]:
    """Return the equations without a section, and the unknowns of motions from states `begin` over a `period` [s].

    `values` (orbits,): of the continuation parameter.
    """
    [along] = problem.along
    known = {name: x[families] for name, x in problem.parameters.items()} | {along: values}
    parts, size = _mesh(problem, known, begin, period)
    timed = _timed(problem, families, size, period, parts)
    states = [begin.T]
    for _ in range(parts - 1):
        states.append(np.asarray(timed.flow(known, states[-1], period / parts).state))
    u = timed.unknowns_of(families, np.stack([x.T for x in states], axis=1), period, values[:, None])
    return timed, list(u)


def _timed(problem: Problem, families: Index, size: States, period: PerLane, parts: int) -> TimedProblem:
    count = len(problem.scales)
    scales, unit = np.ones((count, size.shape[1])), np.ones(count)
    scales[families], unit[families] = size, period
    return TimedProblem(
        scene=problem.scene, along=problem.along, parameters=problem.parameters, scales=scales, unit=problem.unit,
        first=problem.first, last=problem.last, most_steps=problem.most_steps, period_unit=unit, parts=parts,
        # In the plane, orbits do not cross.
        impossible=("period-doubling", "torus") if size.shape[1] == 2 else (),
    )  # fmt: skip


def from_equilibrium(
    problem: Problem,
    states: Float[np.ndarray, " states"],
    jacobian: Float[np.ndarray, "states states"],
    scales: Float[np.ndarray, " states"],
    value: float,
) -> tuple[TimedProblem, np.ndarray] | None:
    """Return the equations and the unknowns of a small orbit around an equilibrium at a Hopf point, or None.

    The orbit begins as an ellipse in the plane of the critical eigenvector (Kuznetsov, *Elements of Applied Bifurcation
    Theory*, section 3.4), and the parameter follows from it.
    """
    eigenvalues, vectors = np.linalg.eig(jacobian)
    turning = np.flatnonzero(eigenvalues.imag > 0)
    if not len(turning):
        return None
    critical = turning[np.abs(eigenvalues[turning].real).argmin()]
    period, vector = 2 * np.pi / eigenvalues[critical].imag, vectors[:, critical]
    vector = vector / np.abs(vector / scales).max()
    family, parts = np.zeros(1, int), HOPF_PARTS
    timed = _timed(problem, family, scales[None], np.array([period]), parts)
    turns = np.exp(2j * np.pi * np.arange(parts) / parts)
    ellipse = (vector * turns[:, None]).real

    def unknowns(amplitude: float) -> np.ndarray:
        own = (states + amplitude * ellipse)[None]
        return timed.unknowns_of(family, own, np.array([period]), np.array([[value]]))

    centre = unknowns(0.0)
    for amplitude in AMPLITUDES:
        guess = unknowns(amplitude)
        row = (guess - centre) / np.linalg.norm(guess - centre)
        at, converged = timed.correct(family, guess, row, np.einsum("ij,ij->i", row, guess))
        if converged[0] and at.swing[0] > amplitude / 10:
            return timed, at.u[0]
    return None


def larger(timed: TimedProblem, u: np.ndarray) -> Iterator[Points]:
    """Yield orbits of the family that begins at a Hopf point, each larger than the one before; first that of `u`."""
    family = np.zeros(1, int)
    now = timed.evaluate(family, u[None])
    for _ in range(MOST_GROWN):
        yield now
        states = timed.states(family, now.u)
        centre = timed.unknowns_of(
            family,
            np.broadcast_to(states.mean(axis=1, keepdims=True), states.shape),
            now.period,
            timed.values(family, now.u),
        )
        guess = centre + GROWN * (now.u - centre)
        row = (guess - centre) / np.linalg.norm(guess - centre)
        now, converged = timed.correct(family, guess, row, np.einsum("ij,ij->i", row, guess))
        if not converged[0]:
            return


def _mesh(problem: Problem, parameters: Mapping[str, PerLane], begin: States, period: PerLane) -> tuple[int, States]:
    """Return the number of parts in which no distance grows by more than `GROWTH`, and the scales of the states."""
    flow, rows = Flow(problem.scene, problem.along, FAMILY_ACCURACY, problem.most_steps), begin.shape[1]
    parts = LEAST_PARTS
    while True:
        state, growth = begin.T, 1.0
        least, greatest = state.copy(), state.copy()
        for _ in range(parts):
            end = flow(parameters, state, period / parts)
            state = np.asarray(end.state)
            least, greatest = np.fmin(least, end.least), np.fmax(greatest, end.greatest)
            swing = (greatest - least) / 2
            own = np.moveaxis(np.asarray(end.jacobian)[:, :rows], -1, 0)
            relative = own * swing.T[:, None, :] / np.maximum(swing.T[:, :, None], 1e-300)
            growth = max(growth, float(np.nan_to_num(np.linalg.norm(relative, ord=2, axis=(1, 2))).max()))
        if growth <= GROWTH or parts >= MOST_PARTS:
            break
        parts *= 2
    largest = swing.max(axis=0)
    return parts, np.where(swing > 1e-6 * largest, swing, largest).T

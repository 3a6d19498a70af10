"""Two descriptions of an orbit: its states at the section, as in datasets, and those at equal parts of the period."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from vibrojax.periodic.flow_map import Flow
from vibrojax.periodic.hopf import larger_orbits
from vibrojax.periodic.orbits import Orbits
from vibrojax.periodic.problem import FAMILY_ACCURACY, Index, PerLane, Points, Problem
from vibrojax.periodic.segments import Mark
from vibrojax.periodic.timed_problem import TimedProblem

GROWTH = 30.0
"""Largest growth of a small distance over a part of the first orbit; along the family it may become greater."""

LEAST_PARTS, MOST_PARTS = 4, 64
"""Numbers of parts of the simplest orbits, and the largest number."""

SAMPLES = 16
"""Samples of each part of an orbit among which crossings are searched."""

REFINEMENTS = 6
"""Newton steps for the time of a crossing."""

RETURNING = 4
"""Number of the orbit with which a family begins, among those that grow from a Hopf point and return to the section."""

SAME_DURATION = 1e-6
"""Largest relative difference between the period of an orbit and that of its description at the section."""

States = Float[np.ndarray, "orbits states"]


def free_problem(problem: Problem, known: Sequence[Orbits]) -> tuple[TimedProblem, Index, list[np.ndarray]]:
    """Return the equations without a section, the numbers of the families, and the unknowns of known orbits of these.

    `problem`: equations with the states at the section; `lane` of the orbits is the number of their family.
    """
    families = np.concatenate([orbits.lane for orbits in known])
    begin = np.zeros((len(families), len(problem.moving)))
    begin[:, problem.places] = np.concatenate([orbits.states[:, 0] for orbits in known])
    period = np.concatenate([orbits.times.sum(axis=1) for orbits in known])
    timed, first = through(problem, families, begin, period, problem.parameters[problem.along[0]][families])
    order = np.argsort(families)
    return timed, families[order], [first[k] for k in order.tolist()]


def through(
    problem: Problem, families: Index, begin: States, period: PerLane, values: PerLane
) -> tuple[TimedProblem, list[np.ndarray]]:
    """Return the equations without a section, and the unknowns of motions from states `begin` over a `period` [s].

    `values` (orbits,): of the continuation parameter.
    """
    [along] = problem.along
    known = {name: x[families] for name, x in problem.parameters.items()} | {along: values}
    parts, size = _mesh(problem, known, begin, period)
    timed = TimedProblem.of(problem, families, size, period, parts)
    states = [begin.T]
    for _ in range(parts - 1):
        states.append(np.asarray(timed.flow(known, states[-1], period / parts).state))
    u = timed.timed_unknowns(families, np.stack([x.T for x in states], axis=1), period, values[:, None])
    return timed, list(u)


def returning_orbit(section: Problem, timed: TimedProblem, u: np.ndarray) -> Orbits | None:
    """Return an orbit near a Hopf point, that of `u` or a larger one, by its states at the section; None without one.

    The smallest motions do not re-arm the section. The orbit is not the first that does: the Hopf point is extrapolated
    from those between.
    """
    [along] = section.along
    found: list[Orbits] = []
    for point in larger_orbits(timed, u):
        [(states, times)] = crossings_of(timed, point)
        if len(times):
            parameters = {**section.parameters, along: timed.values(point.family, point.u)[:, 0]}
            orbit = Orbits.find(section.scene, parameters, states[None])
            if orbit.converged[0] and abs(orbit.times.sum() / point.period[0] - 1) < SAME_DURATION:
                found.append(orbit)
        if len(found) == RETURNING:
            break
    return found[-1] if found else None


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


def at_section(timed: TimedProblem, problem: Problem, marks: list[Mark]) -> list[Mark]:
    """Return the marks with the states at the section as unknowns of `problem`.

    An orbit that does not cross the section keeps its period as one return, from unknown states.
    """
    found: list[Mark] = list(marks)
    sizes = {mark.orbit.u.shape[1] for mark in marks}
    for size in sizes:
        numbers = [k for k, mark in enumerate(marks) if mark.orbit.u.shape[1] == size]
        points = Points.join([marks[k].orbit._replace(times=marks[k].orbit.period[:, None]) for k in numbers])
        for k, (states, times) in zip(numbers, crossings_of(timed, points), strict=True):
            orbit = marks[k].orbit
            family, values = orbit.family, timed.values(orbit.family, orbit.u)
            if marks[k].kind == "hopf" or not len(times):
                here = timed.states(family, orbit.u)[0, 0][problem.places]
                states = here[None] if marks[k].kind == "hopf" else np.full((1, problem.rows), np.nan)
                times = orbit.period
            u = problem.unknowns(family, states[None], values)
            found[k] = marks[k]._replace(orbit=orbit._replace(u=u, times=times[None], tangent=np.full_like(u, np.nan)))
    return found


def crossings_of(timed: TimedProblem, points: Points) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return for each orbit the states at its upward crossings of the section, and the times from each to the next."""
    scene, section = timed.scene, timed.scene.section
    assert section is not None
    names = timed.moving
    sign, place = (1.0 if section.rising else -1.0), names.index(section.velocity)
    rows = [names.index(name) for name in scene.return_states]
    states, parts = timed.states(points.family, points.u), timed.cycles(points.u)
    period = timed.period(points.family, points.u)
    lanes = len(states)
    parameters = timed.parameters_at(points.family, points.u)

    def flow(lane: np.ndarray, part: np.ndarray, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return states and rates (segments, states) of orbits at a time after the beginning of a part."""
        p = {name: x[lane] for name, x in parameters.items()}
        end = timed.flow(p, states[lane, part].T, time)
        return np.asarray(end.state).T, np.asarray(end.jacobian)[:, len(names)].T

    lane, part, sample = (x.ravel() for x in np.indices((lanes, parts, SAMPLES)))
    step = period[lane] / (parts * SAMPLES)
    height = sign * flow(lane, part, sample * step)[0][:, place].reshape(lanes, parts * SAMPLES)
    lane, index = np.nonzero((height < 0) & (np.roll(height, -1, axis=1) >= 0))
    below, above = height[lane, index], np.roll(height, -1, axis=1)[lane, index]
    part, width = index // SAMPLES, period[lane] / (parts * SAMPLES)
    time = (index % SAMPLES + below / (below - above)) * width
    here = np.zeros((len(lane), len(names)))
    for _ in range(REFINEMENTS if len(lane) else 0):
        here, rate = flow(lane, part, np.maximum(time, 0.0))
        with np.errstate(all="ignore"):
            move = -here[:, place] / rate[:, place]
        time = time + np.where(np.isfinite(move), np.clip(move, -width, width), 0.0)
    at = part * (period[lane] / parts) + time
    result = []
    for k in range(lanes):
        own = np.flatnonzero(lane == k)
        own = own[np.argsort(at[own])]
        times = np.diff(np.append(at[own], at[own[:1]] + period[k]))
        result.append((here[own][:, rows], times))
    return result

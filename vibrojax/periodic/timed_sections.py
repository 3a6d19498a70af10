"""Orbits of families without a section, described by their crossings of the section, as datasets store them."""

import numpy as np

from vibrojax.periodic.flow_map import moving_names
from vibrojax.periodic.problem import Points, Problem
from vibrojax.periodic.segments import Mark
from vibrojax.periodic.timed_problem import TimedProblem

SAMPLES = 16
"""Samples of each part of an orbit among which crossings are searched."""

REFINEMENTS = 6
"""Newton steps for the time of a crossing."""


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
                place = [moving_names(timed.scene).index(name) for name in timed.scene.return_states]
                here = timed.states(family, orbit.u)[0, 0][place]
                states = here[None] if marks[k].kind == "hopf" else np.full((1, len(place)), np.nan)
                times = orbit.period
            u = problem.unknowns(family, states[None], values)
            found[k] = marks[k]._replace(orbit=orbit._replace(u=u, times=times[None], tangent=np.full_like(u, np.nan)))
    return found


def crossings_of(timed: TimedProblem, points: Points) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return for each orbit the states at its upward crossings of the section, and the times from each to the next."""
    scene, section = timed.scene, timed.scene.section
    assert section is not None
    names = moving_names(scene)
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

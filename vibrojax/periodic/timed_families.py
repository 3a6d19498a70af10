"""Orbits without a section: their description at equal parts of the period, and their families.

A family may shrink through zero amplitude or have an unbounded period. Datasets hold the states at the section.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from vibrojax.compile.xla import precision
from vibrojax.lazy import jnp
from vibrojax.periodic.arclength import VANISHED, Stop
from vibrojax.periodic.families import FamilyContinuation
from vibrojax.periodic.flow_map import flowed
from vibrojax.periodic.hopf import larger_orbits, timed_hopf_point
from vibrojax.periodic.orbits import Orbits
from vibrojax.periodic.problem import FAMILY_ACCURACY, Flags, Index, PerLane, Points, Problem
from vibrojax.periodic.return_map import Segments
from vibrojax.periodic.segments import Mark, Segment
from vibrojax.periodic.timed_problem import TimedProblem
from vibrojax.scenes import Scene

LONGEST_PERIOD = 1e3
"""Period, relative to that of the first orbit, at which a family ends: it leads to an orbit to an equilibrium."""

AT_REST = 1e-5
"""Least rate of change on an orbit, relative to the greatest, at which it leads to an orbit to an equilibrium, too."""

SAME_VALUE, CENTRE_POINTS = 1e-9, 60
"""Scaled change of the parameter that is none, and number of points without one at which a family ends: around a centre
there are orbits of every amplitude."""

SMALL = 1e-3
"""Amplitude, relative to the scales, below which orbits next to a Hopf point are left out."""


class TimedContinuation(FamilyContinuation):
    """Continuation of the families of a `TimedProblem`."""

    _problem: TimedProblem

    def stop(self, segments: list[Segment]) -> Stop:
        """Return the condition that the amplitude passes zero, that a period is too long, or that branches join."""
        begin = Points.join([segment.begin for segment in segments])
        deviations, rejoins = self._deviations(begin), super().stop(segments)
        first, count = begin.u[:, -1].copy(), np.zeros(len(begin.u), int)

        def ends(lanes: Index, now: Points) -> Flags:
            own = self._deviations(now)
            turned = np.einsum("ij,ij->i", own, deviations[lanes]) < 0
            deviations[lanes] = own
            count[lanes] = np.where(np.abs(now.u[:, -1] - first[lanes]) < SAME_VALUE, count[lanes] + 1, 0)
            endless = self._is_long(now) & (now.period > begin.period[lanes])
            return rejoins(lanes, now) | turned | endless | (count[lanes] >= CENTRE_POINTS)

        return ends

    def finish(self, segments: list[Segment]) -> list[Segment]:
        for segment in segments:
            deviations = self._deviations(segment.points.of(slice(-2, None)))
            if len(deviations) == 2 and deviations[0] @ deviations[1] < 0:
                segment.status = VANISHED
        return super().finish(segments)

    def hopf(self, segment: Segment) -> Points | None:
        """Return the Hopf point through which a segment has passed, or None; leave out its smallest orbits.

        Their parameter follows from amplitudes that may be as small as rounding errors.
        """
        pair, swing = segment.points.of(slice(-2, None)), segment.points.swing[:-1]
        segment.points = segment.points.of(slice(0, max(int((swing > SMALL).sum()), 1)))
        return timed_hopf_point(self._problem, pair)

    def stop_note(self, segment: Segment) -> str:
        if segment.doubled:
            return super().stop_note(segment)
        if self._is_long(segment.points.of([-1]))[0]:
            return "the period grows without limit"
        return "a centre: orbits of every amplitude at one value"

    def _is_long(self, points: Points) -> Flags:
        problem, parts = self._problem, self._problem.cycles(points.u)
        shift = problem.shift(points)[:, : parts * problem.rows].reshape(-1, parts, problem.rows)
        rates = np.linalg.norm(shift, axis=2)
        rests = rates.min(axis=1) < AT_REST * rates.max(axis=1)
        return np.asarray(rests | (points.period > LONGEST_PERIOD * problem.period_unit[points.family]))

    def _deviations(self, points: Points) -> np.ndarray:
        """Return the scaled states relative to their mean, flattened."""
        size = len(points.u), self._problem.cycles(points.u), self._problem.rows
        own = points.u[:, : -1 - len(self._problem.along)].reshape(size)
        return np.asarray((own - own.mean(axis=1, keepdims=True)).reshape(size[0], size[1] * size[2]))


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

    No distance grows by more than `GROWTH` in a part. `values` (orbits,): of the continuation parameter.
    """
    [along] = problem.along
    known = {name: x[families] for name, x in problem.parameters.items()} | {along: values}
    flow, parts = Segments(problem.scene, problem.along, FAMILY_ACCURACY, program=flowed), LEAST_PARTS
    while True:
        states, growth = [begin.T], 1.0
        least, greatest = begin.T.copy(), begin.T.copy()
        for _ in range(parts):
            end = flow(known, states[-1], period / parts)
            states.append(np.asarray(end.state))
            least, greatest = np.fmin(least, end.least), np.fmax(greatest, end.greatest)
            swing = (greatest - least) / 2
            own = np.moveaxis(np.asarray(end.jacobian)[:, : len(swing)], -1, 0)
            relative = own * swing.T[:, None, :] / np.maximum(swing.T[:, :, None], 1e-300)
            growth = max(growth, float(np.nan_to_num(np.linalg.norm(relative, ord=2, axis=(1, 2))).max()))
        if growth <= GROWTH or parts >= MOST_PARTS:
            break
        parts *= 2
    largest = swing.max(axis=0)
    scales = np.where(swing > 1e-6 * largest, swing, largest).T
    timed, states = TimedProblem.of(problem, families, scales, period, parts), states[:-1]
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
    sign = 1.0 if section.rising else -1.0
    rows = [names.index(name) for name in scene.return_states]
    states, parts = timed.states(points.family, points.u), timed.cycles(points.u)
    period = timed.period(points.family, points.u)
    lanes = len(states)
    parameters = timed.parameters_at(points.family, points.u)

    def flow(lane: np.ndarray, part: np.ndarray, time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return states of orbits (segments, states), and their heights above the section with the rates of these.

        `time`: from the beginning of a part.
        """
        p = {name: x[lane] for name, x in parameters.items()}
        end = timed.flow(p, states[lane, part].T, time)
        here = np.asarray(end.state)
        if section.velocity in names:
            place = names.index(section.velocity)
            return here.T, sign * here[place], sign * np.asarray(end.jacobian)[place, len(names)]
        height, rate = _function_of_section(scene, p, dict(zip(names, here, strict=True)))
        return here.T, sign * height, sign * rate

    lane, part, sample = (x.ravel() for x in np.indices((lanes, parts, SAMPLES)))
    step = period[lane] / (parts * SAMPLES)
    height = flow(lane, part, sample * step)[1].reshape(lanes, parts * SAMPLES)
    lane, index = np.nonzero((height < 0) & (np.roll(height, -1, axis=1) >= 0))
    below, above = height[lane, index], np.roll(height, -1, axis=1)[lane, index]
    part, width = index // SAMPLES, period[lane] / (parts * SAMPLES)
    time = (index % SAMPLES + below / (below - above)) * width
    here = np.zeros((len(lane), len(names)))
    for _ in range(REFINEMENTS if len(lane) else 0):
        here, off, rate = flow(lane, part, np.maximum(time, 0.0))
        with np.errstate(all="ignore"):
            move = -off / rate
        time = time + np.where(np.isfinite(move), np.clip(move, -width, width), 0.0)
    at = part * (period[lane] / parts) + time
    result = []
    for k in range(lanes):
        own = np.flatnonzero(lane == k)
        own = own[np.argsort(at[own])]
        times = np.diff(np.append(at[own], at[own[:1]] + period[k]))
        result.append((here[own][:, rows], times))
    return result


def _function_of_section(
    scene: Scene[Any], parameters: Mapping[str, PerLane], states: Mapping[str, PerLane]
) -> tuple[np.ndarray, np.ndarray]:
    """Return a section's function of the moving states, and its rate of change."""
    assert scene.section is not None
    place = scene.place(scene.section.velocity)
    with precision("float64"):
        none = jnp.zeros_like(next(iter(states.values())))
        whole = tuple(jnp.asarray(states.get(name, none)) for name in scene.state_names)
        c = scene.constants({name: jnp.asarray(x) for name, x in parameters.items()})
        c, mode = scene.scaled(c, whole), scene.mode_at(c, whole)
        whole = scene.on_surfaces(c, mode, whole)
        return np.asarray(whole[place]), np.asarray(scene.field(c, mode, whole)[place])

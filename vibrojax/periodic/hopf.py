"""Hopf points: where the amplitude of orbits shrinks to zero at an equilibrium, and small orbits next to them.

Orbits with very small amplitudes do not re-arm a section, so the continuation stalls before the Hopf point. The point
itself is located by the linear stability of the equilibrium: there, a pair of eigenvalues crosses the imaginary axis.
The branch leads to that point if the squares of its last amplitudes extrapolate to it (Kuznetsov, *Elements of Applied
Bifurcation Theory*, section 3.4). Without a section, orbits are continued through zero amplitude instead.
"""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from vibrojax.lazy import linalg
from vibrojax.periodic.brackets import LOCATED_WITHIN
from vibrojax.periodic.equilibria import Equilibrium, equilibrium_near, hopf_near, section_product
from vibrojax.periodic.problem import Points, Problem
from vibrojax.periodic.timed_problem import TimedProblem, transverse

SMALLEST_SWING = 3e-3
"""Amplitude, relative to the family's first orbit, at which a branch ends if it shrinks into an equilibrium. Its
distance from the bifurcation is about the square of that. The equilibrium satisfies the orbit's equations, too: without
an end, it would be continued as an orbit without amplitude."""

LEAST_SWING = 3e-4
"""Amplitude below which a point is not accepted as the end of such a branch: it may be the equilibrium itself, and the
tangent is inaccurate, because the multiplier differs from 1 by the square of the amplitude."""

ENCLOSED = 4.0
"""Largest distance of the equilibrium from the section's states, relative to `SMALLEST_SWING`."""

SHRINKING = 1.2
"""Smallest ratio of two amplitudes that are extrapolated to zero."""

EXTRAPOLATION_ERROR = 0.2
"""Largest distance of the Hopf point from the extrapolated one, relative to its distance from the branch's last point
or, if greater, to the distance between the points of the extrapolation, the last of which may be at the Hopf point
within rounding errors. The curvature of the branch contributes a few percent."""

SAME_FREQUENCY = 0.05
"""Largest relative difference between the frequencies of the last orbit and of the eigenvalues at the Hopf point."""

HOPF_PARTS = 16
"""Number of parts of orbits that begin at a Hopf point and still change much."""

AMPLITUDES = (2e-2, 5e-3, 1e-3)
"""Scaled amplitudes that are tried for the first orbit near a Hopf point."""

GROWN, MOST_GROWN = 1.5, 40
"""Ratio of the amplitudes of successive orbits that grow from a Hopf point, and their largest number."""


def hopf_point(problem: Problem, points: Points) -> Points | None:
    """Return the Hopf point to which the last points of one branch lead, or None if there is none.

    The residual and the margin of the point are zero, and one of its multipliers is 1.
    """
    last, scene = points.of([-1]), problem.scene
    if scene.section is None or last.times.shape[1] > 1 or not np.isfinite(last.times).all():
        return None
    if (last.signature >= 1).any():  # an event; a side that never changes counts 1/2
        return None
    family, [along] = last.family, problem.along
    extrapolated = _extrapolated(problem, points)
    if extrapolated is None:
        return None
    (predicted, base), (guess, scale, parameters) = extrapolated, _surroundings(problem, last)
    value, frequency = float(problem.values(family, last.u)[0, 0]), 2 * np.pi / float(last.times[0, 0])
    tolerance = LOCATED_WITHIN * float(problem.unit[family[0], 0])
    other = predicted if abs(predicted - value) > tolerance else value + 2 * tolerance
    hopf = hopf_near(scene, along, parameters, guess, scale, frequency, (value, other), tolerance)
    if hopf is None or not problem.first[family[0], 0] <= hopf[0] <= problem.last[family[0], 0]:
        return None
    located, known, eigenvalue, vector = hopf
    near = abs(located - predicted) < EXTRAPOLATION_ERROR * max(abs(located - value), base)
    if not near or abs(eigenvalue.imag / frequency - 1) > SAME_FREQUENCY:
        return None
    product = section_product(scene, known, eigenvalue, vector, problem.scales[family[0]])
    u = problem.unknowns(family, known.states[problem.places][None, None], np.array([[located]]))
    times = np.full_like(last.times, 2 * np.pi / eigenvalue.imag)
    off, margin = np.zeros_like(last.off), np.zeros_like(last.margin)
    return last._replace(u=u, off=off, times=times, product=product[None], margin=margin)


def timed_hopf_point(problem: TimedProblem, pair: Points) -> Points | None:
    """Return the Hopf point between two orbits on opposite sides of an equilibrium, or None."""
    last, [along] = pair.of([0]), problem.along
    family, number, unit = last.family, int(last.family[0]), float(problem.unit[last.family[0], 0])
    first, second = problem.values(pair.family, pair.u)[:, 0].tolist()
    if abs(first - second) < 1e-9 * unit:
        second = first + 1e-6 * unit
    multiple = last.times.shape[1]
    guess, size, parameters = _surroundings(problem, last)
    frequency = 2 * np.pi * multiple / float(pair.period.mean())
    hopf = hopf_near(problem.scene, along, parameters, guess, size, frequency, (first, second), 1e-14 * unit)
    if hopf is None or abs(hopf[0] - (first + second) / 2) > 0.5 * unit:
        return None
    located, known, eigenvalue, vector = hopf
    period = multiple * 2 * np.pi / eigenvalue.imag
    states = np.repeat(known.states[None, None], problem.cycles(pair.u), axis=1)
    u = problem.timed_unknowns(family, states, np.array([period]), np.array([[located]]))
    scale = problem.scales[number]
    whole = linalg.expm(known.jacobian * period) * scale / scale[:, None]
    product = transverse(whole[None, None], (vector.real / scale)[None, None])
    times = np.full_like(last.times, period / multiple)
    return last._replace(u=u, off=np.zeros_like(last.off), times=times, product=product)


def surrounds_equilibrium(problem: Problem, point: Points) -> bool:
    """Return whether an orbit of small amplitude surrounds an equilibrium, into which it may shrink.

    A forced motion has no equilibrium: it may be small, but its amplitude does not vanish along a family.
    """
    known = None if problem.scene.section is None else _equilibrium_inside(problem, point)
    if known is None:
        return False
    distance = np.abs(known.states[problem.places] - problem.states(point.family, point.u)[0])
    return bool((distance / problem.scales[point.family]).max() < ENCLOSED * SMALLEST_SWING)


def _surroundings(problem: Problem, point: Points) -> tuple[Float[np.ndarray, " states"], float, dict[str, float]]:
    """Return the mean of the states of an orbit, as moving states, their largest scale, and all parameters."""
    guess, parameters = np.zeros(len(problem.moving)), problem.parameters_at(point.family, point.u)
    guess[problem.places] = problem.states(point.family, point.u)[0].mean(axis=0)
    return guess, float(problem.scales[point.family].max()), {name: float(x[0]) for name, x in parameters.items()}


def _equilibrium_inside(problem: Problem, point: Points) -> Equilibrium | None:
    guess, scale, parameters = _surroundings(problem, point)
    return equilibrium_near(problem.scene, parameters, guess, scale)


def _extrapolated(problem: Problem, points: Points) -> tuple[float, float] | None:
    """Return the parameter value at which the squares of the last amplitudes extrapolate to zero, or None.

    The second result is the distance between the two values from which it is extrapolated.
    """
    squares: list[float] = []
    values = problem.values(points.family, points.u)[:, 0]
    for k in range(len(values) - 1, -1, -1):
        point = points.of([k])
        known = _equilibrium_inside(problem, point)
        if known is None or (point.signature != points.signature[-1]).any():
            return None
        apart = (problem.states(point.family, point.u)[0, 0] - known.states[problem.places]) / problem.scales[
            point.family
        ]
        squares.append(float((apart**2).sum()))
        if squares[-1] > SHRINKING**2 * squares[0]:
            change = float(values[-1] - values[k])
            return float(values[-1]) + squares[0] * change / (squares[-1] - squares[0]), abs(change)
    return None


def orbit_at_hopf(
    problem: Problem, known: Equilibrium, scales: Float[np.ndarray, " states"], value: float
) -> tuple[TimedProblem, np.ndarray] | None:
    """Return the equations and the unknowns of a small orbit around an equilibrium at a Hopf point, or None.

    The orbit begins as an ellipse in the plane of the critical eigenvector (Kuznetsov, *Elements of Applied Bifurcation
    Theory*, section 3.4), and the parameter follows from it.
    """
    pair = known.pair()
    if pair is None:
        return None
    (eigenvalue, vector), family = pair, np.zeros(1, int)
    period, vector = np.array([2 * np.pi / eigenvalue.imag]), vector / np.abs(vector / scales).max()
    timed = TimedProblem.of(problem, family, scales[None], period, HOPF_PARTS)
    ellipse = (vector * np.exp(2j * np.pi * np.arange(HOPF_PARTS) / HOPF_PARTS)[:, None]).real
    states = np.stack([np.broadcast_to(known.states, ellipse.shape), known.states + ellipse])[:, None]
    centre, orbit = (timed.timed_unknowns(family, x, period, np.array([[value]])) for x in states)
    for amplitude in AMPLITUDES:
        begin = _away_from(timed, centre, orbit, amplitude)
        if begin is not None and begin.swing[0] > amplitude / 10:
            return timed, begin.u[0]
    return None


def larger_orbits(timed: TimedProblem, u: np.ndarray) -> Iterator[Points]:
    """Yield orbits of the family that begins at a Hopf point, each larger than the one before; first that of `u`."""
    now: Points | None = timed.evaluate(np.zeros(1, int), u[None])
    for _ in range(MOST_GROWN):
        if now is None:
            return
        yield now
        states, values = timed.states(now.family, now.u), timed.values(now.family, now.u)
        mean = np.broadcast_to(states.mean(axis=1, keepdims=True), states.shape)
        now = _away_from(timed, timed.timed_unknowns(now.family, mean, now.period, values), now.u, GROWN)


def _away_from(timed: TimedProblem, centre: np.ndarray, orbit: np.ndarray, share: float) -> Points | None:
    """Return the orbit at a distance from the centre, `share` times that of another orbit; None without one."""
    guess = centre + share * (orbit - centre)
    row = (guess - centre) / np.linalg.norm(guess - centre)
    now, converged = timed.correct(np.zeros(1, int), guess, row, np.einsum("ij,ij->i", row, guess))
    return now if converged[0] else None

"""Families of orbits without a section, which may shrink through zero amplitude or have an unbounded period."""

import numpy as np

from vibrojax.periodic.arclength import VANISHED, Stop
from vibrojax.periodic.families import FamilyContinuation
from vibrojax.periodic.hopf import timed_hopf_point
from vibrojax.periodic.problem import Flags, Index, Points
from vibrojax.periodic.segments import Segment
from vibrojax.periodic.timed_problem import TimedProblem

LONGEST_PERIOD = 1e3
"""Period, relative to that of the first orbit, at which a family ends: it leads to an orbit to an equilibrium."""

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
        deviations, halves = self._deviations(begin), self._problem.halves(begin)
        first, count = begin.u[:, -1].copy(), np.zeros(len(begin.u), int)
        doubled = np.array([segment.departure is not None for segment in segments])

        def ends(lanes: Index, now: Points) -> Flags:
            own, other = self._deviations(now), self._problem.halves(now)
            turned = np.einsum("ij,ij->i", own, deviations[lanes]) < 0
            joins = doubled[lanes] & (np.einsum("ij,ij->i", other, halves[lanes]) < 0)
            deviations[lanes], halves[lanes] = own, other
            count[lanes] = np.where(np.abs(now.u[:, -1] - first[lanes]) < SAME_VALUE, count[lanes] + 1, 0)
            return joins | turned | self._is_long(now) | (count[lanes] >= CENTRE_POINTS)

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
        if segment.departure is not None:
            return super().stop_note(segment)
        if self._is_long(segment.points.of([-1]))[0]:
            return "the period grows without limit"
        return "a centre: orbits of every amplitude at one value"

    def _is_long(self, points: Points) -> Flags:
        return points.period > LONGEST_PERIOD * self._problem.period_unit[points.family]

    def _deviations(self, points: Points) -> np.ndarray:
        """Return the scaled states relative to their mean, flattened."""
        size = len(points.u), self._problem.cycles(points.u), self._problem.rows
        own = points.u[:, : -1 - len(self._problem.along)].reshape(size)
        return np.asarray((own - own.mean(axis=1, keepdims=True)).reshape(size[0], size[1] * size[2]))

    def _end_at_doublings(self, segments: list[Segment]) -> None:
        """Doubled branches end before the doubling at which they join another branch; the mark says so."""

"""Families of orbits without a section: branch points, hopf points, and orbits of unbounded period."""

import numpy as np
from scipy.linalg import expm
from scipy.optimize import newton

from vibrojax.periodic.arclength import STALLED, STOPPED, Stop
from vibrojax.periodic.families import FamilyContinuation
from vibrojax.periodic.hopf import Field
from vibrojax.periodic.problem import Flags, Index, Points
from vibrojax.periodic.segments import ENDINGS, Mark, Segment
from vibrojax.periodic.timed_problem import TimedProblem, transverse

LONGEST_PERIOD = 1e3
"""Period, relative to that of the first orbit, at which a family ends: it leads to an orbit to an equilibrium."""

SAME_VALUE, CENTRE_POINTS = 1e-9, 60
"""Scaled change of the parameter that is none, and number of points without one at which a family ends: around a centre
there are orbits of every amplitude."""

NEAR_HOPF = 1e-6
"""Scaled distance of the parameter from a Hopf point within which rounding errors decide whether it turns."""

SMALL = 1e-3
"""Amplitude, relative to the scales, below which orbits next to a Hopf point are left out."""

LONG_NOTE = "the period grows without limit"
CENTRE_NOTE = "a centre: orbits of every amplitude at one value"


class TimedContinuation(FamilyContinuation):
    """Continuation of the families of a `TimedProblem`."""

    def __init__(self, problem: TimedProblem, cycles: int) -> None:
        super().__init__(problem, cycles)
        self._timed = problem

    def stop(self, segments: list[Segment]) -> Stop:
        """Return the condition that the amplitude passes zero, that a period is too long, or that branches join."""
        begin = Points.join([segment.begin for segment in segments])
        deviations, halves = self._deviations(begin), self._timed.halves(begin)
        first, count = begin.u[:, -1].copy(), np.zeros(len(begin.u), int)
        doubled = np.array([segment.departure is not None for segment in segments])

        def ends(lanes: Index, now: Points) -> Flags:
            own = self._deviations(now)
            turned = np.einsum("ij,ij->i", own, deviations[lanes]) < 0
            other = self._timed.halves(now)
            joins = doubled[lanes] & (np.einsum("ij,ij->i", other, halves[lanes]) < 0)
            deviations[lanes], halves[lanes] = own, other
            count[lanes] = np.where(np.abs(now.u[:, -1] - first[lanes]) < SAME_VALUE, count[lanes] + 1, 0)
            return joins | turned | self._is_long(now) | (count[lanes] >= CENTRE_POINTS)

        return ends

    def finish(self, segments: list[Segment]) -> list[Segment]:
        following = []
        rest = []
        for segment in segments:
            last = segment.points.of(slice(-2, None))
            deviations = self._deviations(last)
            if len(last.u) == 2 and deviations[0] @ deviations[1] < 0:
                # The parameter of the last orbits follows from amplitudes that may be as small as rounding errors.
                kept = max(int((segment.points.swing[:-1] > SMALL).sum()), 1)
                segment.points = segment.points.of(slice(0, kept))
                inside = segment.special.place < len(segment.points.u) - 1
                self._add_marks(segment, segment.special.of(inside))
                hopf = self._hopf(last)
                if hopf is None:
                    segment.mark("end", "the amplitude shrinks to zero")
                else:
                    turns = [m for m in segment.marks if m.kind == "fold"]
                    near = [m for m in turns if np.abs(m.orbit.u[0, -1] - hopf.u[0, -1]) < NEAR_HOPF]
                    segment.marks = [m for m in segment.marks if not any(m is other for other in near)]
                    segment.marks.append(Mark(hopf, "hopf", "the amplitude is zero", len(segment.points.u) - 1))
                following += self._doubled_branches([segment]) + self._crossing_branches([segment])
            else:
                rest.append(segment)
        following += super().finish(rest) if rest else []
        for segment in rest:
            last = segment.points.of([-1])
            if segment.status == STOPPED and segment.departure is None:
                note = LONG_NOTE if self._is_long(last)[0] else CENTRE_NOTE
                segment.marks = [x._replace(note=note) if x.note == ENDINGS[STOPPED] else x for x in segment.marks]
        return following

    def _is_long(self, points: Points) -> Flags:
        return points.period > LONGEST_PERIOD * self._timed.period_unit[points.family]

    def _deviations(self, points: Points) -> np.ndarray:
        """Return the scaled states relative to their mean, flattened."""
        size = len(points.u), self._problem.cycles(points.u), self._problem.rows
        own = points.u[:, : -1 - len(self._problem.along)].reshape(size)
        return np.asarray((own - own.mean(axis=1, keepdims=True)).reshape(size[0], size[1] * size[2]))

    def _pass_stalls(self, segments: list[Segment]) -> list[Segment]:
        """Mark the ends of segments; there are no events beyond which they go on."""
        for segment in segments:
            segment.mark("end", ENDINGS[STALLED])
        return []

    def _end_at_doublings(self, segments: list[Segment]) -> None:
        """Doubled branches end before the doubling at which they join another branch; the mark says so."""

    def _hopf(self, pair: Points) -> Points | None:
        """Return the Hopf point between two orbits on opposite sides of an equilibrium."""
        problem, [along] = self._timed, self._problem.along
        family = pair.family[:1]
        number = int(family[0])
        values = problem.values(pair.family, pair.u)[:, 0]
        mean = problem.states(pair.family, pair.u).mean(axis=(0, 1))
        parameters = {name: x[number] for name, x in problem.parameters.items()}
        field = Field(problem.scene, parameters, mean, float(problem.scales[number].max()))
        multiple = pair.times.shape[1]
        frequency = 2 * np.pi / float(pair.period.mean() / multiple)

        def growth(at: float) -> float:
            known = field.equilibrium({along: at})
            return np.nan if known is None else known.pair(frequency)[0].real

        unit = float(problem.unit[number, 0])
        a, b = values
        if abs(a - b) < 1e-9 * unit:
            b = a + 1e-6 * unit
        with np.errstate(all="ignore"):
            located, _ = newton(growth, a, x1=b, tol=1e-14 * unit, maxiter=60, full_output=True, disp=False)
            known = field.equilibrium({along: located}) if np.isfinite(located) else None
        if known is None or abs(located - values.mean()) > 0.5 * unit:
            return None
        eigenvalue, vector = known.pair(frequency)
        period = multiple * 2 * np.pi / eigenvalue.imag
        parts = problem.cycles(pair.u)
        states = np.repeat(known.states[None, None], parts, axis=1)
        u = problem.unknowns_of(family, states, np.array([period]), np.array([[located]]))
        last, scale = pair.of([0]), problem.scales[number]
        whole = expm(known.jacobian * period) * scale / scale[:, None]
        product = transverse(whole[None, None], (vector.real / scale)[None, None])
        times, off = np.full_like(last.times, period / multiple), np.zeros_like(last.off)
        return last._replace(u=u, off=off, times=times, product=product)

"""The located stepper: Taylor steps within a mode, each of which ends on the first guard that its polynomial reaches.

Each lane has its own clock and step length. The solution of a mode's equations is expanded in a Taylor series
([vibrojax.stepping.series][]). The step ends where the polynomial crosses the first guard. There the state is set
exactly on the guard and the mode changes. The step length is a fixed fraction of the mode's time scale. It is reduced
if the last coefficients show that the series has not converged (Jorba and Zou 2005, section 3).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any

from vibrojax.errors import InputError, shown
from vibrojax.lazy import jnp, lax
from vibrojax.physics.arrays import Array, Real, keep
from vibrojax.scenes.scene import Scene
from vibrojax.stepping.event import Event, Landing, Trial, locate
from vibrojax.stepping.polynomial import rough_root, slope
from vibrojax.stepping.series import expand
from vibrojax.stepping.stepper import Accuracy, AccuracyRequest, Goal, Lane, Step, Stepper, taken, trial_length

COARSEST_TOLERANCE = 1e-6
"""Greatest tolerance. A greater tolerance saves little time, because most steps end at events. Moreover, the difference
from a coarser run would no longer estimate the error."""

COARSEST_DRIVEN_TOLERANCE = 1e-8
"""Greatest tolerance under a prescribed force. With a greater tolerance, nearly all steps under pulses would end at the
pulses' edges, so the steps would no longer depend on the tolerance."""

LEAST_TOLERANCE = {"float64": 1e-12, "float32": 3e-6}
"""Least tolerance by precision. It is also the least error that lanes meet: at this tolerance, the error estimates of
settled lanes have a median of 1e-13 and 3e-6 in vibro-impact, and are below in rotary and penetration."""

REST_ROUNDINGS = 512
"""Multiple of the speed scale's rounding error (machine epsilon) up to which a motion counts as rest."""

LOCATED_STRIDE = 2.0
"""Longest step in units of 1/rate; within such a step, no guard is reached and left twice."""

ORDER, HIGH_ORDER, HIGH_ORDER_ERROR = 10, 14, 1e-6
"""Order of the series, and order for accepted errors up to the third number. At 1e-4, order 14 takes 11 % less time for
errors three times as large; at 1e-6 and 1e-9 it takes 31 and 47 % less."""

CHANGE_TOLERANCES = 10.0
"""Greatest relative magnitude of the last terms in series of small changes, in tolerances of the motion."""

GUARD_TOLERANCES = 100.0
"""Greatest relative magnitude of the last terms in series of guards, in tolerances of the motion."""

LEAST_ORDER = 2
"""Least order of the series: the length of a step follows from the last two terms."""


@dataclass(frozen=True)
class Located(Stepper):
    """A stepper that integrates by Taylor series up to `order`, and ends a step at every event.

    Of the settings in `Accuracy`, the stepper `Located` uses `stride`, `tolerance` and `step`.

    **Example:**

    >>> method = vj.Located(order=14)
    >>> motion = vj.simulate("vibro-impact", method=method, gamma=0.75, delta=0.005, start="stuck", progress=False)
    >>> round(float(motion.period), 4)
    0.2296
    """

    order: int = ORDER

    name = "located"
    coarser_by = 10.0
    check_settles = 0.0
    rests = True

    def __post_init__(self) -> None:
        if isinstance(self.order, bool) or not isinstance(self.order, int) or not self.order >= LEAST_ORDER:
            raise InputError(f"Located: the order is {shown(self.order)}; give a whole number from {LEAST_ORDER} on")

    @property
    def degree(self) -> int:
        return self.order

    @property
    def error_share(self) -> float:
        # The error is of order 10/9 in the tolerance, so a fraction of 10^(-10/9) = 0.08 would be expected. With 0.4,
        # the estimate is an upper bound for 99 % of periodic lanes. At higher orders, more steps of both runs end at
        # events or at the stride, so that the difference is smaller.
        return 0.4 if self.order <= ORDER else 0.8

    def accuracy(self, request: AccuracyRequest, scene: Scene[Any]) -> Accuracy:
        coarsest = COARSEST_TOLERANCE if scene.autonomous else COARSEST_DRIVEN_TOLERANCE
        # The errors of period and impact velocity are mostly below the tolerance, but 100 times greater on hard lanes.
        tolerance = max(min(1e-3 * request.error, coarsest), LEAST_TOLERANCE[request.precision])
        return Accuracy(tolerance, LOCATED_STRIDE, request.step if request.step is not None else float("inf"))

    def least_error(self, request: AccuracyRequest) -> float:
        return LEAST_TOLERANCE[request.precision]

    def coarser(self, accuracy: Accuracy) -> Accuracy:
        return accuracy._replace(tolerance=accuracy.tolerance * self.coarser_by)

    def passing(
        self, event: Event, functions: list[list[Array]], polynomials: tuple[list[Array], ...], lane: Lane, reach: Array
    ) -> tuple[Event, list[list[Array]]]:
        """Return the event functions of a trial step; a subclass may let the motion pass some of their zeros."""
        return event, functions

    def narrowed(self, scene: Scene[Any], constants: Any, lane: Lane, h: Array, reach: Array, tolerance: Real) -> Array:
        """Return the part of a trial step of length `h` [s] over which all series have converged, at most `reach`."""
        return reach

    def step(
        self, scene: Scene[Any], constants: Any, lane: Lane, accuracy: Accuracy, goal: Goal, marked: bool = True
    ) -> tuple[Lane, Step]:
        h = trial_length(
            lane, accuracy.stride / scene.rate_along(constants, lane.mode, lane.state), accuracy.step, goal
        )
        states = expand(lambda y: scene.field(constants, lane.mode, y), lane.state, h, self.order)
        polynomials = tuple(series.arrays(self.order, h) for series in states)
        event = Event(scene, constants, lane.mode, marked)
        functions = [series.arrays(self.order, h) for series in event.functions(states)]
        terms, scale = scene.error_terms(constants, lane.mode, lane.state, polynomials)
        if scene.autonomous:
            # The lane moves only by rounding errors: one step covers the rest of the run, however stiff the contact.
            noise = REST_ROUNDINGS * jnp.finfo(scale.dtype).eps
            rest = keep(reduce(jnp.maximum, [jnp.abs(c) for series in terms for c in series]) <= noise * scale)
        else:
            rest = jnp.zeros_like(goal.moving)
        # The series counts as converged where its last two terms are below tolerance times scale.
        last = reduce(jnp.maximum, [jnp.abs(c) for series in terms for c in series[-2:]])
        converged = jnp.minimum(rough_root(accuracy.tolerance * scale / last, self.order - 1), 1.0)
        if scene.ends_at_once and scene.guard_names:
            converged = jnp.minimum(converged, self._described(scene, constants, lane, functions, accuracy.tolerance))
        trusted = jnp.where(rest, 1.0, converged)
        reach = self.narrowed(scene, constants, lane, h, trusted, accuracy.tolerance)
        event, functions = self.passing(event, functions, polynomials, lane, reach)
        validity = scene.validity(constants, lane.mode, polynomials, functions)
        reach = keep(lax.stop_gradient(reach if validity is None else jnp.minimum(reach, validity)))
        trial = Trial(polynomials, functions, h, reach, goal.moving & ~rest)
        landing = locate(event, trial)
        scales = scene.defect_scales(constants, lane.mode, lane.state, polynomials)
        if scales is not None:
            landing = self._confirmed(event, trial, landing, scales, accuracy.tolerance)
        h = jnp.where(goal.moving & rest, lane.clock.until(goal.end), h)
        return taken(event, lane, trial, h, landing)

    def _described(
        self, scene: Scene[Any], constants: Any, lane: Lane, functions: list[list[Array]], tolerance: Real
    ) -> Array:
        """Return the part of a trial step over which the series of guards have converged.

        A guard may change faster than the states, as that of a stop that vibrates. Its events would be missed.
        """
        sizes = scene.typical_guard_values(constants, lane.mode, lane.state)
        terms = []
        for size, (value, *_, before, last) in zip(sizes, functions, strict=False):
            scale = jnp.maximum(size, jnp.abs(value))
            terms.append(jnp.where(scale > 0, jnp.maximum(jnp.abs(before), jnp.abs(last)) / scale, 0.0))
        most = reduce(jnp.maximum, terms)
        return rough_root(GUARD_TOLERANCES * tolerance / most, self.order - 1)

    def _confirmed(
        self, event: Event, trial: Trial, landing: Landing, scales: Sequence[Array], tolerance: Array
    ) -> Landing:
        """Return the landing, rejected where the series do not solve the equations at the end of the step."""
        rates = keep(event.scene.field(event.constants, event.mode, landing.state))
        solved = jnp.ones_like(trial.moving)
        for polynomial, rate, scale in zip(trial.polynomials, rates, scales, strict=False):
            defect = jnp.abs(slope(polynomial, landing.tau) - trial.h * rate)
            solved = solved & ~(defect > tolerance * scale)  # true for NaN, which ends the lane
        rejected = keep(landing.accepted & trial.moving & ~solved & (landing.tau > 0))
        return landing._replace(
            tau=jnp.where(rejected, 0.5 * landing.tau, landing.tau),
            accepted=landing.accepted & ~rejected,
            hits={name: mask & ~rejected for name, mask in landing.hits.items()},
        )


@dataclass(frozen=True)
class Varied(Located):
    """The located stepper for motions whose derivatives are computed: the series of small changes converge, too.

    A change may move much faster than the motion. In a motion of two equal masses side by side, no series of the motion
    shows how the masses swing against each other.
    """

    def narrowed(self, scene: Scene[Any], constants: Any, lane: Lane, h: Array, reach: Array, tolerance: Real) -> Array:
        c, mode, state = lax.stop_gradient((constants, lane.mode, lane.state))
        begin, number = scene.small_changes(c, state), len(state)
        if not begin:
            return reach

        def field(series: tuple[Any, ...]) -> tuple[Any, ...]:
            y, changes = series[:number], series[number:]
            return (*scene.field(c, mode, y), *scene.changed_field(c, mode, y, changes))

        changes = [series.arrays(self.order, h) for series in expand(field, (*state, *begin), h, self.order)[number:]]
        sizes = [[jnp.abs(x) for x in series] for series in changes]
        last = reduce(jnp.maximum, [jnp.maximum(*series[-2:]) / (series[0] + series[1]) for series in sizes])
        known = jnp.where(jnp.isfinite(last), last, 0.0)  # a root has no derivative where it is zero
        return jnp.minimum(reach, rough_root(CHANGE_TOLERANCES * tolerance / known, self.order - 1))

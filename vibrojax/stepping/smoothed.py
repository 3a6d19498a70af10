"""The smoothed stepper: classical Runge-Kutta steps of fixed length, with the friction switch spread over a width.

The friction switch sgn u is replaced by u/sqrt(u² + width²). The bit therefore never sticks; instead it creeps. The
contact is not smoothed. Steps end on the section and on the beginning and end of contact, which are located on the
cubic Hermite interpolant of the step.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from vibrojax.lazy import jnp
from vibrojax.physics.arrays import Array, Real
from vibrojax.scenes.declared import Values
from vibrojax.scenes.scene import Scene
from vibrojax.stepping.event import Event, Trial, locate
from vibrojax.stepping.series import known
from vibrojax.stepping.stepper import Accuracy, AccuracyRequest, Goal, Lane, Step, Stepper, taken, trial_length

STICK_WIDTHS = 3.0
"""Sliding speed, in units of the smoothing width, below which the bit counts as sticking. At this speed, smoothed
friction has 95 % of its sharp value."""

LEAST_WIDTH = 1e-6
"""Least width of the friction switch that follows from the error tolerance [m/s]."""

ERROR_BY_WIDTH = 0.25
"""Least error estimate, as a fraction of width^(3/4) with the width in m/s. The parts of the error have different signs
and orders in the width. At widths where they cancel, the difference between two runs says nothing about either."""

COARSER_STRIDE = 1.25
"""Ratio of the check run's stride to that of the main run. As an error of fourth order, that of the steps in a contact
then differs between the two runs by 1.4 times the error of the main run."""

LEAST_FLOAT32_ERROR = 1e-4
"""Least accepted error in float32: the default. Rounding errors keep the estimates of settled lanes at about 5e-4,
which the certificate states; smaller requests are refused."""


def runge_kutta(rates: Callable[[Values], Values], state: Values, h: Real) -> tuple[Values, Values]:
    """Return the state after a classical fourth-order Runge-Kutta step of `h` [s], and the rates before the step."""

    def moved(k: Values, share: float) -> Values:
        return tuple(y + share * h * dy for y, dy in zip(state, k, strict=True))

    k1 = rates(state)
    k2 = rates(moved(k1, 0.5))
    k3 = rates(moved(k2, 0.5))
    k4 = rates(moved(k3, 1.0))
    mean = tuple((a + 2 * b + 2 * c + d) / 6 for a, b, c, d in zip(k1, k2, k3, k4, strict=True))
    return moved(mean, 1.0), k1


def _hermite(start: Array, end: Array, rate: Array, end_rate: Array) -> list[Array]:
    """Return the coefficients in tau of the cubic with the values and the derivatives at tau = 0 and tau = 1."""
    change = end - start
    return [start, rate, 3 * change - 2 * rate - end_rate, rate + end_rate - 2 * change]


@dataclass(frozen=True)
class Smoothed(Stepper):
    """A stepper that spreads the jump of dry friction over a width of speeds, with Runge-Kutta steps of fixed length.

    Of the settings in `Accuracy`, the stepper `Smoothed` uses `smoothing` [m/s], `step` [s] and, for a stiff contact,
    `stride`.

    **Example:**

    >>> point = {"gamma": 0.75, "delta": 0.005, "start": "stuck"}
    >>> motion = vj.simulate("vibro-impact", method=vj.Smoothed(), smoothing=1e-3, step=1e-4, **point, progress=False)
    >>> abs(float(motion.period) / 0.2296 - 1) < 0.01
    True
    """

    name = "smoothed"
    order = 4
    coarser_by = 2.0
    # The error is of order 3/4 in the width, so a factor of 1.5 would be expected. Next to grazing impacts, where the
    # error falls in jumps, 4.5 are needed.
    error_share = 5.0
    smooths = True

    @property
    def degree(self) -> int:
        return 3

    def accuracy(self, request: AccuracyRequest, scene: Scene[Any]) -> Accuracy:
        # In the reference cases, the error due to the width is at most width^(3/4), with the width in m/s. The error
        # due to a step of 0.3 s per m/s of width is far below.
        width = request.smoothing if request.smoothing is not None else max(request.error ** (4 / 3), LEAST_WIDTH)
        return Accuracy(0.0, 0.3, request.step if request.step is not None else 0.3 * width, width)

    def least_error(self, request: AccuracyRequest) -> float:
        # The error estimates of most settled lanes are between 0.25 and 0.8 times width^(3/4).
        if request.smoothing is not None:
            return float(min(request.smoothing, LEAST_WIDTH) ** (3 / 4))
        return LEAST_WIDTH ** (3 / 4) if request.precision == "float64" else LEAST_FLOAT32_ERROR

    def coarser(self, accuracy: Accuracy) -> Accuracy:
        step, width = self.coarser_by * accuracy.step, self.coarser_by * accuracy.smoothing
        return accuracy._replace(stride=COARSER_STRIDE * accuracy.stride, step=step, smoothing=width)

    def error_floor(self, accuracy: Accuracy) -> float:
        return float(ERROR_BY_WIDTH * accuracy.smoothing ** (3 / 4))

    def step(
        self, scene: Scene[Any], constants: Any, lane: Lane, accuracy: Accuracy, goal: Goal, marked: bool = True
    ) -> tuple[Lane, Step]:
        width = accuracy.smoothing
        mode = scene.smoothed_mode(constants, lane.mode, lane.state, STICK_WIDTHS * width)
        lane = lane._replace(mode=mode)
        # A stiff contact needs shorter steps than the setting `step`.
        h = trial_length(lane, accuracy.stride / scene.rate(constants, mode), accuracy.step, goal)

        def rates_at(state: Values) -> Values:
            return scene.smoothed_field(constants, mode, state, width)

        after, rates = runge_kutta(rates_at, lane.state, h)
        ends = zip(lane.state, after, rates, rates_at(after), strict=True)
        polynomials = tuple(_hermite(y, z, h * dy, h * dz) for y, z, dy, dz in ends)
        event = Event(scene, constants, mode, marked, smooths=True)
        series = event.functions(tuple(known(polynomial) for polynomial in polynomials))
        trial = Trial(polynomials, [f.arrays(self.degree, h) for f in series], h, jnp.ones_like(h), goal.moving)
        return taken(event, lane, trial, h, locate(event, trial))

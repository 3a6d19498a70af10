"""Lanes and the interface of steppers: the step, its settings, and the settings of a coarser check run."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

from vibrojax.lazy import jax, jnp, lax
from vibrojax.physics.arrays import Array, Flags, Lanes, Real, keep
from vibrojax.scenes.scene import Scene
from vibrojax.stepping.event import Event, Landing, Trial


class Clock(NamedTuple):
    """Time [s] as a sum of two floats, so that a million additions lose no digits even in float32."""

    high: Lanes
    low: Lanes

    def advanced(self, dt: Lanes) -> "Clock":
        """Return the clock advanced by `dt` [s] (Knuth's two-sum)."""
        small = dt + self.low
        high = self.high + small
        part = high - self.high
        return Clock(high, (self.high - (high - part)) + (small - part))

    def until(self, end: Array | float) -> Array:
        """Return the remaining time until `end` [s]."""
        return (end - self.high) - self.low


class Lane(NamedTuple):
    """A lane at one instant: clock, continuous state and discrete mode.

    The field `trial` [s] limits the length of the lane's next trial step. Every array has shape (lanes,).
    """

    clock: Clock
    state: tuple[Array, ...]
    mode: tuple[Array, ...]
    trial: Lanes


class Step(NamedTuple):
    """A completed time step, from which gauges compute their quantities.

    - `before`, `mode`: state and mode at the start of the step; `after`: state at the start of the next step.
    - `polynomials`: `polynomials[i][k]` is the coefficient of s^k in the polynomial of state i, where s = time/h runs
      from 0 to `tau`.
    - `h` [s]: time unit of `tau`; `dt` [s]: duration of the step, 0 if no step was taken.
    - `hits`: for each guard and marker, by name, a mask of the lanes whose step ended at a zero of this guard or
      marker.
    - `falling`: for each marker, a mask of the lanes in which the marker crosses zero downwards.
    """

    before: tuple[Array, ...]
    mode: tuple[Array, ...]
    polynomials: tuple[list[Array], ...]
    h: Lanes
    tau: Lanes
    dt: Lanes
    after: tuple[Array, ...]
    hits: Mapping[str, Flags]
    falling: Mapping[str, Flags]


def lane_at(scene: Scene[Any], constants: Any, state: tuple[Array, ...]) -> Lane:
    """Return the lane at t = 0 with the initial `state`, a tuple of arrays (lanes,)."""
    zero: jax.Array = jnp.zeros_like(state[0])
    mode = scene.mode_at(constants, state)
    state = scene.on_surfaces(constants, mode, state)
    return Lane(Clock(zero, zero), state, mode, jnp.full_like(zero, jnp.inf))


class Accuracy(NamedTuple):
    """Settings that determine the length of steps, as numbers or arrays that can change without recompilation.

    - `tolerance`: for the located stepper, the relative magnitude of the last Taylor terms above which a step is
      shortened.
    - `stride`: longest step in units of 1/(rate of the mode); `step`: longest step [s].
    - `smoothing`: for the smoothed stepper, the width in sliding velocity [m/s] of the smoothed friction.
    """

    tolerance: Any
    stride: Any
    step: Any
    smoothing: Any = 0.0

    def described(self) -> dict[str, float]:
        """Return the settings that are positive and finite, by name, as JSON values for a dataset."""
        return {name: value for name, value in self._asdict().items() if 0 < value < float("inf")}


class AccuracyRequest(NamedTuple):
    """The accuracy that the user requests.

    - `error`: relative error tolerance.
    - `step` [s], `smoothing` [m/s]: values chosen by the user, or None to derive them from `error`.
    - `precision`: "float64" or "float32".
    """

    error: float = 1e-4
    step: float | None = None
    smoothing: float | None = None
    precision: str = "float64"


class Goal(NamedTuple):
    """The limit of an integration: its `end` [s], and `moving`, a mask of the lanes that have not finished."""

    end: Real
    moving: Flags


class Stepper(ABC):
    """A time integration method for many lanes at once.

    A new stepper defines the abstract members and the attributes below. Stepper objects are static arguments of
    compiled programs, so a stepper is a frozen dataclass without arrays.

    - `name`: name of the stepper in sweep files.
    - `order`: order of the integration method; `degree`: degree of the polynomials that describe a step.
    - `coarser_by`: tolerance (or smoothing width) of the check run divided by that of the main run; the error is
      estimated from the check run.
    - `check_settles`: how much longer a lane settles in its check run than in its main run, as a fraction of the
      settling time. Choose zero only if coarser steps hardly change the motion.
    - `smooths`: True if the stepper smooths dry friction over a width, so that the bit never sticks.
    - `rests`: True if the stepper treats motion within rounding error as rest, and rejects lanes that are too stiff or
      too slow for the floating-point precision.

    **Example:**

    >>> class Short(vj.Located):  # located steps, half as long
    ...     name = "short"
    ...
    ...     def accuracy(self, wanted, scene):
    ...         usual = super().accuracy(wanted, scene)
    ...         return usual._replace(stride=usual.stride / 2)
    >>> isinstance(Short(), vj.Stepper)
    True
    >>> motion = vj.simulate("vibro-impact", method=Short(), start="stuck", duration=4.0, progress=False)
    """

    name: ClassVar[str]
    order: int
    coarser_by: ClassVar[float]
    check_settles: ClassVar[float] = 0.5
    smooths: ClassVar[bool] = False
    rests: ClassVar[bool] = False

    @property
    @abstractmethod
    def degree(self) -> int:
        """Degree of the polynomials that describe a step."""

    @property
    @abstractmethod
    def error_share(self) -> float:
        """Ratio of the estimated error of the main run to the difference between main run and check run."""

    @abstractmethod
    def step(
        self, scene: Scene[Any], constants: Any, lane: Lane, accuracy: Accuracy, goal: Goal, marked: bool = True
    ) -> tuple[Lane, Step]:
        """Return the lanes after one step, and the step, which ends at a guard or, if `marked` is true, at a marker."""

    @abstractmethod
    def accuracy(self, request: AccuracyRequest, scene: Scene[Any]) -> Accuracy:
        """Return the settings that reach the requested error in a scene, with the values that the user chose."""

    def least_error(self, request: AccuracyRequest) -> float:
        """Return the least error tolerance that lanes can meet with the other settings in `request`; 0 if unknown."""
        return 0.0

    @abstractmethod
    def coarser(self, accuracy: Accuracy) -> Accuracy:
        """Return the settings of the coarser check run, from which the error is estimated."""

    def error_floor(self, accuracy: Accuracy) -> float:
        """Return the error that main run and check run may have in common, which their difference does not show."""
        return 0.0


def trial_length(lane: Lane, nominal: Array, longest: Real, goal: Goal) -> "jax.Array":
    """Return the length of the next trial step [s], 0 for lanes that do not move.

    It is the least of `nominal`, `longest`, the limit from a rejected trial, and the time until `goal.end`.
    """
    h = jnp.minimum(jnp.minimum(nominal, longest), jnp.minimum(lane.trial, lane.clock.until(goal.end)))
    # The motion does not depend on where a step ends, so derivatives do not propagate through the step length.
    return lax.stop_gradient(jnp.where(goal.moving, h, 0.0))


def taken(event: Event, lane: Lane, trial: Trial, h: Lanes, landing: Landing) -> tuple[Lane, Step]:
    """Return the lane after a trial step, and the step; `h`: unit of tau [s]; `landing`: end of the trial step."""
    scene, accepted = event.scene, landing.accepted
    hits, falling = scene.joined(lane.mode, landing.hits, landing.falling)
    dt = jnp.where(accepted, landing.tau * h, 0.0)
    reached = tuple(jnp.where(accepted, new, old) for new, old in zip(landing.state, lane.state, strict=True))
    mode, state = keep(scene.after_event(event.constants, lane.mode, reached, hits))
    tau = jnp.where(accepted, landing.tau, 0.0)
    step = Step(lane.state, lane.mode, trial.polynomials, h, tau, dt, state, hits, falling)
    return Lane(lane.clock.advanced(dt), state, mode, jnp.where(accepted, jnp.inf, landing.tau * h)), step

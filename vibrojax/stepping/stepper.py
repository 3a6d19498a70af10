"""The interface of steppers: how they step, from what their steps follow, and how a coarser run shows their error."""

from abc import ABC, abstractmethod
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from vibrojax.models.arrays import Array, Flags, Lanes, Real, keep
from vibrojax.models.scenes.scene import Scene
from vibrojax.stepping.event import Event, Landing, Trial
from vibrojax.stepping.lane import Lane, Step


class Accuracy(NamedTuple):
    """Settings that determine the steps, as numbers or arrays: a change of them compiles nothing.

    - `tolerance`: relative size of the last terms of a step's series above which it is shortened (located).
    - `stride`: the longest step in units of 1/rate of the mode; `step`: the longest step [s].
    - `smoothing`: width of the friction switch [m/s] (smoothed).
    """

    tolerance: Any
    stride: Any
    step: Any
    smoothing: Any = 0.0

    def described(self) -> dict[str, float]:
        """Return the finite settings above zero as JSON values for a dataset."""
        return {name: value for name, value in self._asdict().items() if 0 < value < float("inf")}


class AccuracyRequest(NamedTuple):
    """The user's requirements.

    - `error`: the accepted relative error.
    - `step` [s], `smoothing` [m/s]: the user's choice; None: they follow from the error.
    - `precision`: "float64" or "float32".
    """

    error: float = 1e-4
    step: float | None = None
    smoothing: float | None = None
    precision: str = "float64"


class Goal(NamedTuple):
    """The time `end` [s] to which the lanes in the mask `moving` step; the others stand still."""

    end: Real
    moving: Flags


class Stepper(ABC):
    """A method of stepping many lanes at once.

    A new stepper defines the abstract members and the attributes below. Its objects are static arguments of programs,
    so it is a frozen dataclass that holds no arrays.

    - `name`: its name in sweep files.
    - `order`: of its error in the step; `degree`: of its steps' polynomials.
    - `coarser_by`: factor by which the check run's tolerance or width is coarser.
    - `error_share`: part of the difference of the two runs that is taken as the finer run's error.
    - `smooths`: True if it spreads the friction switch over a width, so that nothing sticks.
    - `rests`: True if it treats motion within roundings as rest. Lanes that are too stiff or too slow for their
      precision are then refused.

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
    error_share: ClassVar[float]
    smooths: ClassVar[bool] = False
    rests: ClassVar[bool] = False

    @property
    @abstractmethod
    def degree(self) -> int:
        """Degree of its steps' polynomials."""

    @abstractmethod
    def step(
        self, scene: Scene[Any], constants: Any, lane: Lane, accuracy: Accuracy, goal: Goal, marked: bool = True
    ) -> tuple[Lane, Step]:
        """Return every lane after one step, and the step; it also ends on markers if `marked`."""

    @abstractmethod
    def accuracy(self, wanted: AccuracyRequest, scene: Scene[Any]) -> Accuracy:
        """Return the settings that keep the accepted error in `scene`, unless the user chose them."""

    @abstractmethod
    def coarser(self, accuracy: Accuracy) -> Accuracy:
        """Return the settings of the check run, which estimates the error."""


def trial_length(lane: Lane, nominal: Array, longest: Real, goal: Goal) -> jax.Array:
    """Return the next trial step's length [s], limited by the mode, by a rejected trial and by the end of the run."""
    h = jnp.minimum(jnp.minimum(nominal, longest), jnp.minimum(lane.trial, lane.clock.until(goal.end)))
    # The motion does not depend on where a step ends, so no derivative goes through its length.
    return lax.stop_gradient(jnp.where(goal.moving, h, 0.0))


def taken(event: Event, lane: Lane, trial: Trial, h: Lanes, landing: Landing) -> tuple[Lane, Step]:
    """Return the lane after its trial step of `h` [s] per unit of tau, which ended in `landing`, and the step."""
    scene, accepted = event.scene, landing.accepted
    dt = jnp.where(accepted, landing.tau * h, 0.0)
    reached = tuple(jnp.where(accepted, new, old) for new, old in zip(landing.state, lane.state, strict=True))
    mode, state = keep(scene.after_event(event.constants, lane.mode, reached, landing.hits))
    tau = jnp.where(accepted, landing.tau, 0.0)
    step = Step(lane.state, lane.mode, trial.polynomials, h, tau, dt, state, landing.hits, landing.falling)
    return Lane(lane.clock.advanced(dt), state, mode, jnp.where(accepted, jnp.inf, landing.tau * h)), step

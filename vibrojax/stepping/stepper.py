"""What a stepper is: how it steps, what its steps follow from, and how its error follows from a coarser run."""

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
    """What the steps follow from; numbers, or arrays in a program: changing them compiles nothing.

    - `tolerance`: relative size of the last terms of a step's series that shortens it (located).
    - `stride`: the longest step in units of 1/rate of the mode; `step`: the longest step [s].
    - `smoothing`: width of the friction switch [m/s] (smoothed).
    """

    tolerance: Any
    stride: Any
    step: Any
    smoothing: Any = 0.0

    def described(self) -> dict[str, float]:
        """What a dataset says of it, as JSON values: what is finite and not zero."""
        return {name: value for name, value in self._asdict().items() if 0 < value < float("inf")}


class Wanted(NamedTuple):
    """What the user asks for.

    - `error`: the accepted relative error.
    - `step` [s], `smoothing` [m/s]: chosen by the user; None: they follow from the error.
    - `precision`: "float64" or "float32".
    """

    error: float = 1e-4
    step: float | None = None
    smoothing: float | None = None
    precision: str = "float64"


class Goal(NamedTuple):
    """Where lanes go: to the time `end` [s], those that are `moving`; the others stand still."""

    end: Real
    moving: Flags


class Stepper(ABC):
    """A way to step many lanes at once.

    A new one provides the abstract members below, and says what follows; everything else just works. Its objects are
    static arguments of programs, so it is a frozen dataclass that holds no arrays.

    - `name`: what sweep files call it.
    - `order`: of its error in the step; `degree`: of its steps' polynomials.
    - `coarser_by`: the check run's tolerance or width is this many times coarser.
    - `error_share`: part of the two runs' difference that the finer one's error is taken for.
    - `smooths`: whether it spreads the friction switch over a width, so that nothing sticks.
    - `rests`: whether what moves by no more than roundings is at rest for it, so that lanes that are too stiff or too
      slow for their precision must be refused.

    **Example:**

    >>> class Short(vj.Located):  # located steps, half as long
    ...     name = "short"
    ...
    ...     def accuracy(self, wanted, scene):
    ...         asked = super().accuracy(wanted, scene)
    ...         return asked._replace(stride=asked.stride / 2)
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
        """One step of every lane: the lane after it, and the step; `marked`: whether it also ends on markers."""

    @abstractmethod
    def accuracy(self, wanted: Wanted, scene: Scene[Any]) -> Accuracy:
        """Steps that keep the accepted error in `scene`, unless the user chose them."""

    @abstractmethod
    def coarser(self, accuracy: Accuracy) -> Accuracy:
        """The accuracy of the check run, with which the error is estimated."""


def trial_length(lane: Lane, nominal: Array, longest: Real, goal: Goal) -> jax.Array:
    """Length [s] of the next trial step: the mode's own, what a rejected trial left, or what is left of the run."""
    h = jnp.minimum(jnp.minimum(nominal, longest), jnp.minimum(lane.trial, lane.clock.until(goal.end)))
    # Where a step ends says nothing of the motion, so no derivative goes through it.
    return lax.stop_gradient(jnp.where(goal.moving, h, 0.0))


def taken(event: Event, lane: Lane, trial: Trial, h: Lanes, landing: Landing) -> tuple[Lane, Step]:
    """The lane after its trial step, which takes `h` [s] to tau = 1, has ended in `landing`; and the step."""
    scene, accepted = event.scene, landing.accepted
    dt = jnp.where(accepted, landing.tau * h, 0.0)
    reached = tuple(jnp.where(accepted, new, old) for new, old in zip(landing.state, lane.state, strict=True))
    mode, state = keep(scene.after_event(event.constants, lane.mode, reached, landing.hits))
    step = Step(
        before=lane.state,
        mode=lane.mode,
        polynomials=trial.polynomials,
        h=h,
        tau=jnp.where(accepted, landing.tau, 0.0),
        dt=dt,
        after=state,
        hits=landing.hits,
        falling=landing.falling,
    )
    return Lane(lane.clock.advanced(dt), state, mode, jnp.where(accepted, jnp.inf, landing.tau * h)), step

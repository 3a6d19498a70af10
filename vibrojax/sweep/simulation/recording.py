"""One point's motion, recorded step by step and measured: what `simulate` samples, and what answers a click."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from vibrojax.compile.devices import precision
from vibrojax.errors import Place
from vibrojax.measures import Records
from vibrojax.models.arrays import Array
from vibrojax.models.scenes import HasFriction, Scene
from vibrojax.models.scenes.declared import Values
from vibrojax.progress import Progress, timed
from vibrojax.stepping import Accuracy, Stepper
from vibrojax.sweep.engine.compiler import lane_function
from vibrojax.sweep.engine.parallel import in_parallel
from vibrojax.sweep.engine.validity import unresolved
from vibrojax.sweep.input.point import Point
from vibrojax.sweep.simulation.dense_output import MOST_STEPS, Record, record
from vibrojax.sweep.simulation.features import compile_measures, found_in, measured, recorder_of, window


class Recorded(NamedTuple):
    """A motion: the steps taken, and what was found along them, as variables of its dataset, by name."""

    steps: Record
    found: dict[str, tuple[tuple[()], np.ndarray, dict[str, Any]]]


def recorded(
    point: Point,
    stepper: Stepper,
    constants: Any,
    accuracy: Accuracy,
    duration: float,
    tell: Callable[[float], None] | None = None,
    most_steps: int = MOST_STEPS,
    progress: bool = False,
) -> Recorded:
    """Step a point from t = 0 to `duration` [s], and measure what its last part holds (see `window`).

    **Arguments:** `constants`: from `constants_at`; `tell(t)` hears often how far it is, and what it raises ends the
    motion; `progress`: whether to say that it compiles.

    **Raises:** `InputError` where all this takes over `most_steps`.
    """
    scene = point.system
    with precision("float64"):
        state = scene.start(constants, point.start, (1,))
        recorder = recorder_of(scene)
        _compile(scene, recorder, stepper, constants, state, accuracy, progress)
        begin, observe = window(duration)
        with timed("step"):
            end, pause = jnp.asarray(duration), jnp.asarray(begin)
            steps = record(scene, stepper, constants, state, accuracy, end, tell, most_steps, pause)
        if recorder is None:
            return Recorded(steps, {})
        with timed("measure"):
            features = measured(scene, recorder, constants, state, steps, begin, observe)
        return Recorded(steps, found_in(scene, point.parameters, features, accuracy.tolerance))


_compiled: set[tuple[Scene[Any], Stepper]] = set()
"""What this process has compiled."""


def _compile(
    scene: Scene[Any],
    recorder: Records | None,
    stepper: Stepper,
    constants: Any,
    state: Values,
    accuracy: Accuracy,
    progress: bool,
) -> None:
    """Compile the programs that step a motion and measure it, side by side, where that has not been done."""
    if (scene, stepper) in _compiled:
        return
    Progress(1, "motion", progress).say(f"compiling the scene {scene.name}, if it is not in the cache")
    at_once = jnp.asarray(0.0)

    def step() -> None:
        with precision("float64"):
            record(scene, stepper, constants, state, accuracy, at_once)

    def measure() -> None:
        if recorder is not None:
            compile_measures(scene, recorder, stepper, constants, state)

    with timed("compile"):
        for _ in in_parallel(lambda _, program: program(), [step, measure], [0, 1]):
            pass
    _compiled.add((scene, stepper))


def constants_at(place: Place, point: Point, stepper: Stepper | None) -> Any:
    """The scene's constants at the point, each of shape (1,); raises `InputError` where it cannot be run."""
    scene = point.system
    p = {name: np.full(1, value) for name, value in point.parameters.items()}
    refusal = scene.refused(p)
    if refusal is not None and bool(refusal[1][0]):
        raise place.error(f"the point cannot be run: {refusal[0].replace('-', ' ')}")
    exact = stepper is not None and stepper.rests
    if exact and isinstance(scene, HasFriction) and bool(unresolved(scene, point.parameters, "float64")):
        advice = "give a smaller k0, c0, c2 or gamma, or a greater beta"
        raise place.error(f"the point cannot be run: too stiff, so that nothing moves in a step; {advice}")
    return _compiled_constants(scene, p)


@lane_function(static=1)
def _compiled_constants(scene: Scene[Any], p: dict[str, Array]) -> Any:
    return scene.constants(p)

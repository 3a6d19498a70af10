"""The motion of one point, recorded step by step and measured, for `simulate` and for the explorer."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from vibrojax.compile.devices import precision
from vibrojax.errors import Place
from vibrojax.models.arrays import Array
from vibrojax.models.scenes import HasFriction, Scene
from vibrojax.progress import Progress, timed
from vibrojax.stepping import Accuracy, Stepper
from vibrojax.sweep.engine.compiler import lane_function
from vibrojax.sweep.engine.parallel import in_parallel
from vibrojax.sweep.engine.validity import unresolved
from vibrojax.sweep.input.point import Point
from vibrojax.sweep.simulation.dense_output import RECORD_MAX_STEPS, Record, record
from vibrojax.sweep.simulation.features import compile_measures, labelled_features, measured, recorder_of, window

_compiled: set[tuple[Scene[Any], Stepper]] = set()
"""Pairs of scene and stepper whose programs have been compiled in this process."""


class Recorded(NamedTuple):
    """A recorded motion.

    - `steps`: its steps.
    - `found`: its features as variables of the dataset, by name.
    """

    steps: Record
    found: dict[str, tuple[tuple[()], np.ndarray, dict[str, Any]]]


def recorded(
    point: Point,
    stepper: Stepper,
    constants: Any,
    accuracy: Accuracy,
    duration: float,
    report: Callable[[float], None] | None = None,
    most_steps: int = RECORD_MAX_STEPS,
    progress: bool = False,
) -> Recorded:
    """Step a point from t = 0 to `duration` [s], and measure the last part of the motion (see `window`).

    **Arguments:**

    - `constants`: constants from `constants_at`.
    - `report(t)`: is called after each batch of steps. An exception from this function aborts the motion.
    - `progress`: whether to announce the compilation on stderr.

    **Raises:** `InputError` if the motion takes more than `most_steps` steps.
    """
    scene = point.system
    with precision("float64"):
        state = scene.start(constants, point.start, (1,))
        recorder = recorder_of(scene)

        def compile_steps() -> None:
            with precision("float64"):
                record(scene, stepper, constants, state, accuracy, jnp.asarray(0.0))

        def compile_recorder() -> None:
            if recorder is not None:
                compile_measures(scene, recorder, stepper, constants, state)

        if (scene, stepper) not in _compiled:
            Progress(1, "motion", progress).say(f"compiling the scene {scene.name}, if it is not in the cache")
            with timed("compile"):
                for _ in in_parallel(lambda _, program: program(), [compile_steps, compile_recorder], [0, 1]):
                    pass
            _compiled.add((scene, stepper))
        begin, observe = window(duration)
        with timed("step"):
            end, pause = jnp.asarray(duration), jnp.asarray(begin)
            steps = record(scene, stepper, constants, state, accuracy, end, report, most_steps, pause)
        if recorder is None:
            return Recorded(steps, {})
        with timed("measure"):
            features = measured(scene, recorder, constants, state, steps, begin, observe)
        return Recorded(steps, labelled_features(scene, point.parameters, features, accuracy.tolerance))


def constants_at(place: Place, point: Point, stepper: Stepper | None) -> Any:
    """Return the scene's constants at the point, each (1,); raise `InputError` if the point cannot be run."""
    scene = point.system
    p = {name: np.full(1, value) for name, value in point.parameters.items()}
    refusal = scene.refused(p)
    if refusal is not None and bool(refusal[1][0]):
        raise place.error(f"the point cannot be run: {refusal[0].replace('-', ' ')}")
    is_exact = stepper is not None and stepper.rests
    if is_exact and isinstance(scene, HasFriction) and bool(unresolved(scene, point.parameters, "float64")):
        advice = "give a smaller k0, c0, c2 or gamma, or a greater beta"
        raise place.error(f"the point cannot be run: too stiff, so that nothing moves in a step; {advice}")
    return _compiled_constants(scene, p)


@lane_function(static=1)
def _compiled_constants(scene: Scene[Any], p: dict[str, Array]) -> Any:
    return scene.constants(p)

"""Recording of one point: its steps, samples of them, and the features of the last part of the motion."""

import warnings
from collections.abc import Callable
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float

from vibrojax.compile.xla import precision
from vibrojax.errors import InputError, Place, shown
from vibrojax.io.variables import VARIABLES
from vibrojax.lanes.compiler import lane_function
from vibrojax.lanes.drift import drift
from vibrojax.lanes.labels import measured_besides, regime_variables, regimes, unresolved, with_radius
from vibrojax.lanes.record import RECORD_MAX_STEPS, Record, SampledMotion, record, window
from vibrojax.lazy import jax, jnp
from vibrojax.maps.read import Point
from vibrojax.measures import recorder_for
from vibrojax.measures.labels import derived
from vibrojax.measures.recorder import Features, Records
from vibrojax.periodic.problem import OF_STATES
from vibrojax.physics.arrays import Array
from vibrojax.progress import Progress, timed
from vibrojax.scenes import HasContact, HasFriction, HasRock, Scene
from vibrojax.scenes.declared import Values
from vibrojax.stepping import Accuracy, Stepper

if TYPE_CHECKING:
    from diffrax import AbstractSolver


@lane_function(static=1)
def default_sampling(scene: Scene[Any], constants: Any) -> Array:
    """Return the default sampling interval [s], which resolves the oscillations of contact and rock."""
    _, observe = scene.usual_times
    shortest: Any = jnp.asarray(observe / 8000)
    if isinstance(scene, HasContact):
        shortest = jnp.minimum(shortest, scene.contact_time(constants) / 20)
    if isinstance(scene, HasRock):
        shortest = jnp.minimum(shortest, 0.2 * scene.rock_period(constants))
    return shortest


def adaptive(
    scene: Scene[Any],
    constants: Any,
    state: Values,
    times: Float[np.ndarray, " samples"],
    accuracy: Accuracy,
    solver: "str | AbstractSolver",
    tolerance: float,
) -> tuple[SampledMotion, int, str]:
    """Integrate with a diffrax solver. Return the motion, the number of steps, and the solver's name."""
    from vibrojax.stepping.adaptive import adaptive_trajectory, solver_named  # diffrax takes a second to import

    kind, width = solver_named(solver), accuracy.smoothing
    scalars, start = jax.tree.map(lambda value: value[0], (constants, state))
    states, steps = adaptive_trajectory(
        scene, scalars, start, jnp.asarray(times), width, kind, tolerance, accuracy.step
    )
    modes = scene.smoothed_mode(scalars, scene.mode_at(scalars, states), states, 3 * width)
    columns = (np.stack([np.asarray(x) for x in values]) for values in (states, modes))
    return SampledMotion(times, *columns), int(steps), type(kind).__name__


_compiled: set[tuple[Scene[Any], Stepper]] = set()
"""Pairs of scene and stepper whose programs have been compiled in this process."""


class Recorded(NamedTuple):
    """A recorded motion: its steps, and its features as variables of the dataset by name."""

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

    **Arguments:** `constants`: see `constants_at`; `report(t)`: is called after each batch of steps, and an exception
    from it aborts the motion; `progress`: whether to announce the compilation on stderr.

    **Raises:** `InputError` if the motion takes more than `most_steps` steps.
    """
    scene = point.system
    with precision("float64"):
        state = scene.start(constants, point.start, (1,))
        recorder = _recorder_of(scene)

        def run(duration: float, report: Callable[[float], None] | None, most_steps: int) -> tuple[Record, Features]:
            begin, _ = window(scene, duration)
            return record(scene, stepper, constants, state, accuracy, duration, report, most_steps, recorder, begin)

        if (scene, stepper) not in _compiled:
            Progress(1, "motion", progress).say(f"compiling the scene {scene.name}, if it is not in the cache")
            with timed("compile"):
                run(0.0, None, RECORD_MAX_STEPS)
            _compiled.add((scene, stepper))
        with timed("step"):
            steps, features = run(duration, report, most_steps)
        ended = np.flatnonzero(np.isnan(steps.after).any(axis=1))
        # The modes after a step are those before the next.
        fault = int(scene.fault(tuple(steps.mode[min(ended[0] + 1, len(steps.mode) - 1)])) or 0) if ended.size else 0
        if fault:
            last, why = ended[0], scene.fault_reasons[fault].replace("-", " ")
            end = steps.start[last] + steps.dt[last]
            raise Place("simulate").error(f"the motion of {scene.name} ends at t = {end:.6g} s: {why}")
        if (lost := np.flatnonzero(~np.isfinite(steps.after).all(axis=1))).size:
            begin = steps.start[lost[0]]
            warnings.warn(f"simulate: the motion of {scene.name} is not finite after t = {begin:.6g} s", stacklevel=2)
        with timed("measure"):
            return Recorded(steps, labelled_features(point, features, accuracy.tolerance))


def constants_at(place: Place, point: Point, stepper: Stepper | None) -> Any:
    """Return the scene's constants at the point, each (1,); raise `InputError` if the point cannot be run."""
    scene = point.system
    p: dict[str, Array] = {name: np.full(1, value) for name, value in point.parameters.items()}
    refusal = scene.refused(p)
    if refusal is not None and bool(refusal[1][0]):
        raise place.error(f"the point cannot be run: {refusal[0].replace('-', ' ')}")
    given = (0.0,) * len(scene.start_states) if point.start is None or isinstance(point.start, str) else point.start
    for code, fault, mask in scene.start_faults(p, tuple(np.full(1, x) for x in given)):
        if bool(np.ravel(mask)[0]):
            here = place.at("start").error(f"{shown(point.start)}: {fault}")
            raise here if code in OF_STATES else place.error(fault)
    is_exact = stepper is not None and stepper.rests
    if is_exact and isinstance(scene, HasFriction) and bool(unresolved(scene, point.parameters, "float64")):
        advice = "give a smaller k0, c0, c2 or gamma, or a greater beta"
        raise place.error(f"the point cannot be run: too stiff, so that nothing moves in a step; {advice}")
    return _compiled_constants(scene, p)


@lane_function(static=1)
def _compiled_constants(scene: Scene[Any], p: dict[str, Array]) -> Any:
    return scene.constants(p)


@lru_cache
def _recorder_of(scene: Scene[Any]) -> Records | None:
    """Return the recorder of a scene, or None if the scene has nothing to measure or its declarations are invalid."""
    try:
        return recorder_for(scene)
    except InputError:
        return None


def labelled_features(
    point: Point, features: dict[str, np.ndarray], tolerance: float
) -> dict[str, tuple[tuple[()], np.ndarray, dict[str, Any]]]:
    """Return the features (see `record`) as scalar variables of a motion's dataset, named as in a sweep.

    `tolerance`: error tolerance of the steps.
    """
    scene = point.system
    features = dict(features)
    if scene.section is not None and "cycles" in features:
        swing = scene.section.swings[0].amplitude
        if {swing, "trend"} <= set(features):
            values = {name: np.array([value]) for name, value in point.parameters.items()}
            sound = {"finite": np.isfinite(features[swing]), "finished": np.array([True])}
            features["regime"] = regimes(scene, values, features | sound)
        features["drift_estimate"] = drift(features, scene.section, "float64", tolerance)
    features |= derived(scene, features, point.hole_radius)
    known = VARIABLES | regime_variables(scene) | measured_besides(scene) | with_radius(point.hole_radius)
    numbers = {}
    for name, variable in known.items():
        if name in features and features[name].ndim == 1:
            value = features[name][0]
            whole = np.issubdtype(variable.dtype, np.integer)
            numbers[name] = variable.entry((), np.nan_to_num(value) if whole else value)
    return numbers

"""Features and label (regime) of a recorded motion, from the code that measures and labels a sweep's lanes.

The scene's recorder processes the recorded steps one by one, as in a sweep whose `settle` and `observe` are the times
of `window`.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from vibrojax.compile.xla import precision
from vibrojax.io.variables import VARIABLES
from vibrojax.measures.recorder import Features, Records
from vibrojax.models.arrays import Array
from vibrojax.models.scenes import Scene
from vibrojax.models.scenes.declared import Values
from vibrojax.stepping import Clock, Lane, Step, Stepper
from vibrojax.sweep.engine.compiler import lane_function
from vibrojax.sweep.engine.drift import drift
from vibrojax.sweep.engine.labelled import measured_besides, regime_variables, regimes
from vibrojax.sweep.simulation.dense_output import BATCH, Record, begun

OBSERVED_SHARE = 1 / 6
"""Observed part of a motion, as a fraction of its duration: that of a sweep's defaults."""


def window(scene: Scene[Any], duration: float) -> tuple[float, float]:
    """Return the beginning and the length of the observation of a motion with this `duration` [s].

    The observation has at least the scene's usual length, or half of a short motion.
    """
    observe = max(OBSERVED_SHARE * duration, min(scene.usual_times[1], duration / 2))
    return duration - observe, observe


def measured(
    scene: Scene[Any], recorder: Records, constants: Any, state: Values, steps: Record, begin: float, observe: float
) -> dict[str, np.ndarray]:
    """Return the features of one recorded lane by name, each (1,), or (1, returns) for the last section crossings.

    **Arguments:** `constants`, `state`: the scene's constants and the state at t = 0, each (1,); `steps`: steps of the
    motion, one of which ends at the time `begin`; `begin`, `observe`: beginning and length of the observation [s].
    """
    constants, lane = begun(scene, constants, state)
    middle = int(np.searchsorted(steps.start + steps.dt / 2, begin))
    before, after = (Record(*(x[part] for x in steps)) for part in (slice(middle), slice(middle, None)))
    settled = recorder.settling(scene, lane)
    if middle:
        # Recorded steps end on the section throughout. A sweep's steps do so only during the observation.
        carry = _begin(scene, recorder, constants, lane, settled)
        carry = _observe_all(scene, recorder, constants, carry, before, 0.0, begin)
        settled = recorder.settled(settled, carry)
        lane = _as_step(scene, Record(*(x[middle - 1][..., None] for x in steps)))[1]
        lane = lane._replace(mode=tuple(mode[None] for mode in after.mode[0]))
    carry = _begin(scene, recorder, constants, lane, settled)
    carry = _observe_all(scene, recorder, constants, carry, after, begin, observe)
    features = _read(scene, recorder, constants, carry)
    return {name: np.moveaxis(np.asarray(x), -1, 0) for name, x in features.items()}


def compile_measures(scene: Scene[Any], recorder: Records, stepper: Stepper, constants: Any, state: Values) -> None:
    """Compile the programs of `measured` by calling it for two steps of a lane at rest."""
    states, none = len(scene.states), np.zeros(2)
    polynomials, mode, after = (
        np.zeros((2, *n)) for n in ((states, stepper.degree + 1), (len(scene.modes),), (states,))
    )
    flags = (np.zeros((2, len(names)), bool) for names in (scene.event_names, scene.marker_names))
    still = Record(np.array([0.0, 1.0]), none, none, polynomials, mode, after, *flags)
    with precision("float64"):
        measured(scene, recorder, constants, state, still, 0.5, 1.0)


def labelled_features(
    scene: Scene[Any], parameters: dict[str, float], features: dict[str, np.ndarray], tolerance: float
) -> dict[str, tuple[tuple[()], np.ndarray, dict[str, Any]]]:
    """Return the features (see `measured`) as scalar variables of a motion's dataset, named as in a sweep.

    `tolerance`: error tolerance of the steps.
    """
    features = dict(features)
    if scene.section is not None and "cycles" in features:
        swing = scene.section.swings[0].amplitude
        if {swing, "trend"} <= set(features):
            values = {name: np.array([value]) for name, value in parameters.items()}
            sound = {"finite": np.isfinite(features[swing]), "finished": np.array([True])}
            features["regime"] = regimes(scene, values, features | sound)
        features["drift_estimate"] = drift(features, scene.section, "float64", tolerance)
    numbers = {}
    for name, variable in (VARIABLES | regime_variables(scene) | measured_besides(scene)).items():
        if name in features and features[name].ndim == 1:
            value = features[name][0]
            value = np.nan_to_num(value) if np.issubdtype(variable.dtype, np.integer) else value
            numbers[name] = ((), np.asarray(value, variable.dtype), variable.attributes())
    return numbers


def _observe_all(
    scene: Scene[Any], recorder: Records, c: Any, carry: Any, steps: Record, begin: float, observe: float
) -> Any:
    """Pass steps through the recorder in batches of equal size. Steps of a lane at rest fill the last batch."""
    for first in range(0, len(steps.dt), BATCH):
        batch = Record(*(x[first : first + BATCH] for x in steps))
        if missing := BATCH - len(batch.dt):
            last = Record(*(x[-1:] for x in batch))
            still = Record(*map(np.zeros_like, last))._replace(
                start=last.start + last.dt, h=last.h, mode=last.mode, after=last.after
            )
            still.polynomials[..., 0] = last.after
            pairs = zip(batch, still, strict=True)
            batch = Record(*(np.concatenate([x, np.repeat(rest, missing, axis=0)]) for x, rest in pairs))
        carry = _observe(scene, recorder, c, carry, Record(*(x[..., None] for x in batch)), begin, observe)
    return carry


@lane_function(static=2)
def _begin(scene: Scene[Any], recorder: Records, c: Any, lane: Lane, settled: Any) -> Any:
    return recorder.begin(scene, c, lane, settled)


@lane_function(static=2)
def _observe(
    scene: Scene[Any], recorder: Records, c: Any, carry: Any, steps: Record, begin: float, observe: float
) -> Any:
    def observe_step(carry: Any, recorded: Record) -> tuple[Any, None]:
        step, lane = _as_step(scene, recorded)
        carry = recorder.step(scene, c, carry, lane, step)
        share = (lane.clock.high - begin) / observe
        return recorder.take_returns(scene, c, carry, lane, share), None

    return jax.lax.scan(observe_step, carry, steps)[0]


@lane_function(static=2)
def _read(scene: Scene[Any], recorder: Records, c: Any, carry: Any) -> Features:
    return recorder.read(scene, c, carry)


def _as_step(scene: Scene[Any], recorded: Record) -> tuple[Step, Lane]:
    """Return a recorded step, whose last axis is the lane axis, and the lane after this step.

    The mode of the lane is that at the beginning of the step, because the record does not contain the new mode.
    """

    def split(x: Array) -> tuple[Array, ...]:
        return tuple(x[i] for i in range(len(x)))

    polynomials = tuple(list(split(coefficients)) for coefficients in split(recorded.polynomials))
    mode, after = split(recorded.mode), split(recorded.after)
    h, dt = recorded.h, recorded.dt
    step = Step(
        before=tuple(series[0] for series in polynomials),
        mode=mode,
        polynomials=polynomials,
        h=h,
        tau=jnp.where(dt > 0, dt / jnp.where(h > 0, h, 1), 0),
        dt=dt,
        after=after,
        hits=dict(zip(scene.event_names, split(recorded.hits), strict=True)),
        falling=dict(zip(scene.marker_names, split(recorded.falling), strict=True)),
    )
    end = recorded.start + recorded.dt
    return step, Lane(Clock(end, jnp.zeros_like(end)), after, mode, jnp.full_like(end, jnp.inf))

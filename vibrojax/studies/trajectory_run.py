"""Simulation and recording of one point: the trajectory, and the features of its last part."""

import json
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Float

from vibrojax.compile.xla import precision
from vibrojax.errors import Place, shown
from vibrojax.io.kinds import dataset_attributes
from vibrojax.io.variables import VARIABLES, Variable
from vibrojax.lanes.agreement import recorder_of
from vibrojax.lanes.certificate import drift
from vibrojax.lanes.compiler import lane_function
from vibrojax.lanes.labels import measured_besides, regime_variables, regimes, unresolved, with_radius
from vibrojax.lanes.programs import LaneArguments
from vibrojax.lanes.record import (
    KINDS,
    RECORD_MAX_STEPS,
    Events,
    Record,
    SampledMotion,
    along_time,
    check_size,
    events,
    forces,
    record,
    sample,
    states_shown,
    window,
)
from vibrojax.maps.read import Point, read_point
from vibrojax.measures.labels import derived
from vibrojax.measures.recorder import Features
from vibrojax.physics.arrays import Array
from vibrojax.physics.parameters import differing, positive
from vibrojax.progress import LOG, Progress, timed
from vibrojax.scenes import HasContact, HasFriction, HasRock, Scene
from vibrojax.scenes.declared import Values
from vibrojax.settings.run_settings import check_error
from vibrojax.settings.values import quantity
from vibrojax.stepping import STEPPERS, Accuracy, AccuracyRequest, Smoothed, Stepper, stepper_named
from vibrojax.stepping.located import LEAST_TOLERANCE

if TYPE_CHECKING:
    from diffrax import AbstractSolver

TRAJECTORY_MAX_SAMPLES = 2_000_000
"""Maximum number of samples: some 200 MB of states and forces, more than any plot can show."""


def simulate(
    scene: str | Scene[Any],
    *,
    start: str | Sequence[float] | None = None,
    duration: float | None = None,
    method: str | Stepper | None = None,
    solver: "str | AbstractSolver | None" = None,
    step: float | None = None,
    smoothing: float | None = None,
    error: float = 1e-4,
    sampling: float | None = None,
    progress: bool = True,
    **parameters: Any,
) -> xr.Dataset:
    """Simulate one point of a scene.

    **Arguments:**

    - `scene`: "rotary", "vibro-impact", "penetration", "drilling" or "coupled-drilling", or a scene object.
    - `parameters`: parameters of the scene in SI units, `friction` (name of a friction law), `pulse_shape`, `rock`.
    - `start`: initial condition, "drive" (default), "stuck", "touching", or a vector [x1, x1', x2, x2'] [m, m/s].
    - `duration`: simulated time [s]; by default 20 s, or 50 cycles of a `vj.System`.
    - `method`: "located" (default), "smoothed", or "diffrax".
    - `solver`: for "diffrax", a diffrax solver or its name, by default "Tsit5". Specifying `solver` selects "diffrax".
    - `error`: accepted relative error, from which step sizes and tolerances follow, unless the next two are specified.
    - `step`: maximum step size, or the step size of the smoothed method [s].
    - `smoothing`: width of the friction switch [m/s].
    - `sampling`: interval of the samples [s]; by default a twentieth of the contact's duration, 1 ms without contact.
    - `progress`: whether to show progress on stderr.

    **Returns:** a dataset along `time`: x1, v1, x2, v2, friction_force, impact_force [N], stuck; with rock also x3, x4,
    v3, rock_force and applied_force [N]. Along `event`, the dataset has the times and kinds of events. Scalar variables
    describe the last part of the motion, with the same names and definitions as in a sweep: regime, period and so on,
    with rock the rate of penetration. The attribute `run` contains the settling and observation times. The observation
    takes a sixth of the duration, or half of a short duration. A diffrax solver gives neither events nor these scalars.

    **Raises:** `InputError` if a name or value is wrong, or, before the simulation, if steps or samples are too many.

    **Example:**

    >>> motion = vj.simulate("vibro-impact", beta=0.4, gamma=0.75, delta=0.005, start="stuck", progress=False)
    >>> f"{float(motion.period):.4f} s, {float(motion.impact_velocity):.3f} m/s"
    '0.2296 s, 2.238 m/s'
    >>> sorted(motion[["x1", "v1", "x2", "v2", "impact_force"]].data_vars)
    ['impact_force', 'v1', 'v2', 'x1', 'x2']
    """
    return simulate_point(
        read_point(Place("simulate"), scene, parameters, start),
        duration=duration,
        method=method,
        solver=solver,
        step=step,
        smoothing=smoothing,
        error=error,
        sampling=sampling,
        progress=progress,
    )


def simulate_point(
    point: Point,
    *,
    duration: float | None = None,
    method: str | Stepper | None = None,
    solver: "str | AbstractSolver | None" = None,
    step: float | None = None,
    smoothing: float | None = None,
    error: float = 1e-4,
    sampling: float | None = None,
    progress: bool = True,
) -> xr.Dataset:
    """Simulate a point; see `simulate`."""
    place, system = Place("simulate"), point.system
    method = method or ("diffrax" if solver is not None else "located")
    methods = (*STEPPERS, "diffrax")
    if not isinstance(method, Stepper) and method not in methods:
        raise place.at("method").error(f'"{method}" is unknown; choose from {", ".join(methods)}')
    if solver is not None and method != "diffrax":
        raise place.at("solver").error(f'has no use with method "{method}"; leave one of them out')
    stepper = None if method == "diffrax" else stepper_named(method)
    if smoothing is not None and stepper is not None and not stepper.smooths:
        raise place.at("smoothing").error(
            f'has no use with method "{stepper.name}"; leave it out, or set method = "smoothed"'
        )

    def setting(name: str, value: float, unit: str) -> float:
        return quantity(place.at(name), value, positive(name, 1.0, unit, name, name))

    duration = sum(system.usual_times) * (5 / 12) if duration is None else duration
    duration, error = setting("duration", duration, "s"), setting("error", error, "1")
    step = None if step is None else setting("step", step, "s")
    smoothing = None if smoothing is None else setting("smoothing", smoothing, "m s-1")
    sampling = None if sampling is None else setting("sampling", sampling, "s")
    wanted = AccuracyRequest(error, step, smoothing)
    if stepper is not None or smoothing is None:
        least_error = (stepper or Smoothed()).least_error(wanted)
    else:
        least_error = LEAST_TOLERANCE[wanted.precision]  # as measured with diffrax's Tsit5 at a width of 1 cm/s
    check_error(place.at("error"), stepper.name if stepper else "diffrax", wanted, least_error)
    if duration < np.finfo(float).tiny:  # the clock rounds it to zero
        raise place.at("duration").error(f"{duration:g} s is too short; give a longer one")
    if stepper is None and isinstance(system, HasRock):
        raise place.at("method").error('"diffrax" supports no rock that yields; choose from located, smoothed')
    progress_bar = Progress(duration, "s simulated", progress and sys.stderr.isatty(), pace=False)
    with precision("float64"):
        constants = constants_at(place, point, stepper)
        times = _times(place, system, constants, duration, sampling)
        accuracy = (stepper or Smoothed()).accuracy(wanted, system)
        most_steps = check_size(place, system, constants, duration, accuracy, stepper, len(times))
        event_list = record = step_of = None
        numbers: dict[str, Any] = {}
        solver_text: dict[str, Any] = {"method": stepper.name if stepper else "diffrax"}
        if stepper is None:
            state = system.start(constants, point.start, (1,))
            motion, steps, kind = _adaptive(system, constants, state, times, accuracy, solver or "Tsit5", 1e-3 * error)
        else:
            record, numbers = recorded(
                point, stepper, constants, accuracy, duration, progress_bar.reach, most_steps, progress
            )
            states, modes, step_of = sample(record, times)
            motion, steps = SampledMotion(times, states, modes), len(record.dt)
            event_list = events(system, constants, record)
        smooth = stepper is None or stepper.smooths
        along_time = states_shown(system, motion, record, step_of)
        along_time |= forces(system, constants, motion, accuracy.smoothing if smooth else None)
    solver_text |= {"steps": int(steps), **accuracy.described()}
    if stepper is None:
        solver_text["solver"] = kind
    LOG.info("chosen: %s, %d samples", json.dumps(solver_text), len(times))
    dataset = trajectory_dataset(point, system, motion, along_time, event_list, solver_text)
    if not numbers:
        return dataset
    begin, observe = window(system, duration)
    return dataset.assign(numbers).assign_attrs(run=json.dumps({"settle": begin, "observe": observe}))


def _times(
    place: Place, scene: Scene[Any], constants: Any, duration: float, sampling: float | None
) -> Float[np.ndarray, " samples"]:
    """Return the times of the samples [s], evenly spaced from 0 to `duration`."""
    if sampling is None:
        sampling = float(np.ravel(_default_sampling(scene, constants))[0])
        sampling = min(max(sampling, duration / TRAJECTORY_MAX_SAMPLES), duration)
    intervals = duration / sampling
    if not 0.5 < intervals <= TRAJECTORY_MAX_SAMPLES:
        shortest, most = duration / TRAJECTORY_MAX_SAMPLES, TRAJECTORY_MAX_SAMPLES
        raise place.at("sampling").error(
            f"{sampling:g} s gives {intervals:.7g} samples in {duration:g} s; between 1 and {most} are needed, "
            f"so {shortest:.3g} to {duration:g} s"
        )
    count = round(intervals)
    return np.arange(count + 1) * (duration / count)


@lane_function(static=1)
def _default_sampling(scene: Scene[Any], constants: Any) -> Array:
    """Return the default sampling interval [s], which resolves the oscillations of contact and rock."""
    _, observe = scene.usual_times
    shortest: Any = jnp.asarray(observe / 8000)
    if isinstance(scene, HasContact):
        shortest = jnp.minimum(shortest, scene.contact_time(constants) / 20)
    if isinstance(scene, HasRock):
        shortest = jnp.minimum(shortest, 0.2 * scene.rock_period(constants))
    return shortest


def _adaptive(
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

    kind = solver_named(solver)
    scalars, start = jax.tree.map(lambda value: value[0], (constants, state))
    width = accuracy.smoothing
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
        recorder = recorder_of(scene)

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
    for _, fault, mask in scene.start_faults(p, tuple(np.full(1, x) for x in given)):
        if bool(np.ravel(mask)[0]):
            raise place.at("start").error(f"{shown(point.start)}: {fault}")
    is_exact = stepper is not None and stepper.rests
    if is_exact and isinstance(scene, HasFriction) and bool(unresolved(scene, point.parameters, "float64")):
        advice = "give a smaller k0, c0, c2 or gamma, or a greater beta"
        raise place.error(f"the point cannot be run: too stiff, so that nothing moves in a step; {advice}")
    # A kernel is compared with XLA on the lanes among its arguments: on this motion, not on a block at rest at zero.
    named = isinstance(point.start, str) and point.start in scene.starts
    states = () if point.start is None or isinstance(point.start, str) else tuple(np.full(1, x) for x in given)
    start = scene.starts.index(str(point.start)) if named else len(scene.starts) if states else 0
    return _compiled_constants(scene, LaneArguments(p, np.full(1, start, np.int32), states))


@lane_function(static=1)
def _compiled_constants(scene: Scene[Any], given: LaneArguments) -> Any:
    return scene.constants(given.parameters)


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
            value = np.nan_to_num(value) if np.issubdtype(variable.dtype, np.integer) else value
            numbers[name] = ((), np.asarray(value, variable.dtype), variable.attributes())
    return numbers


def trajectory_dataset(
    point: Point,
    scene: Scene[Any],
    motion: SampledMotion,
    sampled: Mapping[str, xr.Variable],
    event_list: Events | None,
    solver: Mapping[str, object],
) -> xr.Dataset:
    """Return the dataset of a trajectory, with variables along `time` (`sampled`) and along `event`."""
    variables = dict(sampled)
    if isinstance(scene, HasFriction):
        stuck = (motion.modes[scene.mode_place("slip")] == 0).astype(np.int8)
        variables["stuck"] = along_time(stuck, "1", "whether the bit sticks to the rock", ("slides", "sticks"))
    if event_list is not None:
        about = Variable("s", "time of the event"), Variable("1", "what happened", flags=KINDS)
        variables["event_time"], variables["event_kind"] = (
            xr.Variable("event", x, of_events.attributes()) for x, of_events in zip(event_list, about, strict=True)
        )
    start = point.start
    written = {} if start is None else {"start": start if isinstance(start, str) else json.dumps(list(start))}
    attributes = {
        **dataset_attributes("trajectory", f"{point.scene}: trajectory", f"simulate {point.scene}", scene=point.scene),
        "parameters": json.dumps(point.parameters),
        "differing": json.dumps(differing(point.system.parameters(), point.parameters)),
        **point.options,
        **written,
        "solver": json.dumps(solver),
    }
    times = {"time": ("time", motion.times, {"units": "s", "long_name": "time"})}
    return xr.Dataset(variables, times, attributes)

"""The analysis `trajectory`: one motion over time, its pictures and its summary."""

import json
import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from jaxtyping import Float

from vibrojax.compile.xla import precision
from vibrojax.errors import Place, counted, shown
from vibrojax.io.attributes import attribute_of, flags, hole_radius_of, parameters_of, run_of
from vibrojax.io.variables import Variable
from vibrojax.lanes.record import (
    KINDS,
    SampledMotion,
    along_time,
    check_size,
    events,
    forces,
    moving,
    sample,
    states_shown,
    window,
)
from vibrojax.maps.dataset import attributes_of_parameters
from vibrojax.maps.read import Point, read_point
from vibrojax.measures.labels import FEWEST_RETURNS
from vibrojax.pictures.axes import pretty_unit, scale
from vibrojax.pictures.hole import pulses, response
from vibrojax.pictures.motion import states_over_time, trajectory, unsettled_text
from vibrojax.progress import LOG, Progress
from vibrojax.scenes import HasFriction, HasRock, Scene
from vibrojax.settings.code_identity import code_identity
from vibrojax.settings.fields import setting
from vibrojax.settings.run_settings import check_error
from vibrojax.settings.values import choice
from vibrojax.stepping import STEPPERS, AccuracyRequest, Smoothed, Stepper, stepper_named
from vibrojax.stepping.located import LEAST_TOLERANCE
from vibrojax.studies.analysis import PictureRule, SummaryPart
from vibrojax.studies.subjects import MachineAnalysis, answered
from vibrojax.studies.sweep import frequency_part
from vibrojax.studies.trajectory_recording import adaptive, constants_at, default_sampling, recorded

if TYPE_CHECKING:
    from diffrax import AbstractSolver

TRAJECTORY_MAX_SAMPLES = 2_000_000
"""Maximum number of samples: some 200 MB of states and forces, more than any plot can show."""

DURATION_MARGIN = 1.15
"""Ratio of the recommended duration to the shortest sufficient duration."""


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
    - `parameters`: values of the scene's parameters by name, in SI units. The parameters `friction`, `pulse_shape` and
      `rock` take names.
    - `start`: initial condition: "drive" (default), "stuck", "touching", or a vector [x1, x1', x2, x2'] [m, m/s].
    - `duration`: simulated time [s]; by default 20 s, or 50 cycles of a `vj.System`.
    - `method`: "located" (default; steps end exactly at events), "smoothed" (friction without a jump), or "diffrax" (a
      solver of that package).
    - `solver`: for "diffrax", a diffrax solver or its name, by default "Tsit5".
    - `error`: accepted relative error, which determines step sizes and tolerances unless `step` or `smoothing` is
      given.
    - `step`: maximum step size, or the step size of the smoothed method [s].
    - `smoothing`: sliding velocity [m/s] over which the smoothed method spreads the jump of dry friction.
    - `sampling`: sampling interval [s]; by default a twentieth of the duration of an impact, or 1 ms if the scene has
      no impacts.

    **Returns:** a dataset. The variables along `time` are x1, v1, x2, v2, friction_force, impact_force [N], and stuck
    (1 while the bit sticks); scenes with rock also have x3, x4, v3, rock_force and applied_force [N]. The variables
    along `event` are the times and kinds of events. Scalar variables, such as regime and period, describe the last part
    of the motion (the observation). The attribute `run` contains the settling and observation times. Datasets of a
    diffrax solver have neither events nor scalar variables.

    **Raises:** `InputError` if a name or value is wrong, or if the simulation would need too many steps or samples.

    **Example:**

    >>> motion = vj.simulate("vibro-impact", beta=0.4, gamma=0.75, delta=0.005, start="stuck", progress=False)
    >>> f"{float(motion.period):.4f} s, {float(motion.impact_velocity):.3f} m/s"
    '0.2296 s, 2.238 m/s'
    >>> sorted(motion[["x1", "v1", "x2", "v2", "impact_force"]].data_vars)
    ['impact_force', 'v1', 'v2', 'x1', 'x2']
    """
    values = {
        "start": start,
        "duration": duration,
        "method": method,
        "solver": solver,
        "step": step,
        "smoothing": smoothing,
        "error": error,
        "sampling": sampling,
    }
    return answered(Trajectories, scene, values, parameters, progress)


def _named(place: Place, value: Any) -> Any:
    """Return a name, or the object that is given in place of one."""
    if value == "" or isinstance(value, int | float):
        raise place.error(f"{shown(value)} is not a name; write one")
    return value


@dataclass(frozen=True, kw_only=True)
class Trajectories(MachineAnalysis[Point]):
    """Simulate one point: write its trajectory as a dataset, and a picture."""

    kind, command = "trajectory", "simulate"
    view = "motion"
    run_settings = ()
    file, lists = "SCENE.nc, SCENE-2.nc, ...", False
    pictures = (
        PictureRule("motion", lambda held: held.bit_on_rock and held.swept_sine, response),
        PictureRule("motion", lambda held: held.bit_on_rock, pulses),
        PictureRule("motion", lambda held: held.drill, trajectory),
        PictureRule("motion", lambda held: held.run, states_over_time),
    )

    duration: float | None = setting(None, "simulated time, s", unit="s", above=0.0)
    sampling: float | None = setting(None, "interval of the samples, s", unit="s", above=0.0)
    error: float | None = setting(None, "accepted relative error; default: 0.0001", above=0.0)
    method: str | Stepper | None = setting(None, "located, smoothed or diffrax", read=_named)
    solver: str | Any | None = setting(None, "name of a diffrax solver", read=_named)
    step: float | None = setting(None, "longest step, s", unit="s", above=0.0)
    smoothing: float | None = setting(
        None, "velocity over which the smoothed method spreads the jump of friction, m/s", unit="m s-1", above=0.0
    )

    def machines(
        self, place: Place, scene: object, parameters: Mapping[str, object], start: object, run: Mapping[str, object]
    ) -> Point:
        return read_point(place, scene, parameters, start)

    def identity(self, point: Point) -> dict[str, object]:
        given = {name: value for name, value in vars(self).items() if value is not None}
        return {**point.identity(), **given, **code_identity(point.system, point.options)}

    def file_name(self, point: Point) -> str:
        return f"{point.scene}.nc"

    def compute(self, point: Point, progress: bool = True) -> xr.Dataset:
        place, system = Place("simulate"), point.system
        stepper, request = self._resolution(place, system)
        duration = sum(system.usual_times) * (5 / 12) if self.duration is None else self.duration
        if duration < np.finfo(float).tiny:  # the clock rounds it to zero
            raise place.at("duration").error(f"{duration:g} s is too short; give a longer one")
        solver: dict[str, object] = {"method": stepper.name if stepper else "diffrax"}
        about: dict[str, Any] = dict(point.options)
        with precision("float64"):
            constants = constants_at(place, point, stepper)
            times = self._times(place, system, constants, duration)
            accuracy = (stepper or Smoothed()).accuracy(request, system)
            most_steps = check_size(place, system, constants, duration, accuracy, stepper, len(times))
            if stepper is None:
                state = system.start(constants, point.start, (1,))
                rest = accuracy, self.solver or "Tsit5", 1e-3 * request.error
                motion, count, kind = adaptive(system, constants, state, times, *rest)
                solver |= {"steps": count, **accuracy.described(), "solver": kind}
                sampled = states_shown(system, motion, None, None)
            else:
                bar = Progress(duration, "s simulated", progress and sys.stderr.isatty(), pace=False)
                steps, recording = recorded(
                    point, stepper, constants, accuracy, duration, bar.reach, most_steps, progress
                )
                whole = moving(steps)
                states, modes, step_of = sample(whole, times)
                motion = SampledMotion(times, states, modes)
                solver |= {"steps": len(steps.dt), **accuracy.described()}
                [(moments, kinds)] = events(system, constants, steps)
                sampled = states_shown(system, motion, whole, step_of)
                begin, observe = window(system, duration)
                about |= {"run": json.dumps({"settle": begin, "observe": observe})} if recording else {}
            variables: dict[str, Any] = {name: along_time(*state) for name, state in sampled.items()}
            smooth = stepper is None or stepper.smooths
            variables |= forces(system, constants, motion, accuracy.smoothing if smooth else None)
        LOG.info("chosen: %s, %d samples", json.dumps(solver), len(times))
        if isinstance(system, HasFriction):
            stuck = (motion.modes[system.mode_place("slip")] == 0).astype(np.int8)
            variables["stuck"] = along_time(stuck, "1", "whether the bit sticks to the rock", ("slides", "sticks"))
        if stepper is not None:
            variables["event_time"] = Variable("s", "time of the event").entry("event", moments)
            variables["event_kind"] = Variable("1", "what happened", np.int8, KINDS).entry("event", kinds)
            variables |= recording
        about |= attributes_of_parameters(system, point.parameters)
        if point.start is not None:
            about["start"] = point.start if isinstance(point.start, str) else json.dumps(list(point.start))
        return self.dataset(
            variables,
            {"time": ("time", motion.times, {"units": "s", "long_name": "time"})},
            title=f"{point.scene}: trajectory",
            scene=point.scene,
            solver=json.dumps(solver),
            **about,
        )

    def _resolution(self, place: Place, system: Scene[Any]) -> tuple[Stepper | None, AccuracyRequest]:
        """Return the stepper, None for diffrax, and the requested accuracy; raise `InputError` if they do not fit."""
        method = self.method or ("diffrax" if self.solver is not None else "located")
        if not isinstance(method, Stepper):
            choice(place.at("method"), method, (*STEPPERS, "diffrax"))
        if self.solver is not None and method != "diffrax":
            raise place.at("solver").error(f'has no use with method "{method}"; leave one of them out')
        stepper = None if method == "diffrax" else stepper_named(method)
        if self.smoothing is not None and stepper is not None and not stepper.smooths:
            unused = f'has no use with method "{stepper.name}"'
            raise place.at("smoothing").error(f'{unused}; leave it out, or set method = "smoothed"')
        request = AccuracyRequest(1e-4 if self.error is None else self.error, self.step, self.smoothing)
        if stepper is not None or self.smoothing is None:
            least_error = (stepper or Smoothed()).least_error(request)
        else:
            least_error = LEAST_TOLERANCE[request.precision]  # as measured with diffrax's Tsit5 at a width of 1 cm/s
        check_error(place.at("error"), stepper.name if stepper else "diffrax", request, least_error)
        if stepper is None and isinstance(system, HasRock):
            raise place.at("method").error('"diffrax" supports no rock that yields; choose from located, smoothed')
        return stepper, request

    def _times(self, place: Place, scene: Scene[Any], constants: Any, duration: float) -> Float[np.ndarray, " samples"]:
        """Return the times of the samples [s], evenly spaced from 0 to `duration`."""
        sampling, most = self.sampling, TRAJECTORY_MAX_SAMPLES
        if sampling is None:
            sampling = float(np.ravel(default_sampling(scene, constants))[0])
            sampling = min(max(sampling, duration / most), duration)
        intervals = duration / sampling
        if not 0.5 < intervals <= most:
            raise place.at("sampling").error(
                f"{sampling:g} s gives {intervals:.7g} samples in {duration:g} s; between 1 and {most} are needed, "
                f"so {duration / most:.3g} to {duration:g} s"
            )
        count = round(intervals)
        return np.arange(count + 1) * (duration / count)

    def facts(self, ds: xr.Dataset, point: Point) -> Mapping[str, object]:
        return {
            "scene": point.scene,
            **point.options,
            "start": point.start,
            "parameters": point.parameters,
            **({"bit_radius": point.hole_radius} if isinstance(point.system, HasRock) else {}),
            "duration": float(ds["time"][-1]),
            "run": attribute_of(ds, "run"),
            "found": features(ds),
            **frequency_part(ds).facts,
            "solver": attribute_of(ds, "solver"),
        }

    def summary(self, ds: xr.Dataset) -> list[SummaryPart]:
        return [SummaryPart("found", feature_lines(ds), {"found": features(ds)}), frequency_part(ds)]


def features(ds: xr.Dataset) -> dict[str, Any]:
    """Return the scalar variables of a trajectory by name; flags are replaced by their meanings."""
    single = {str(name): data for name, data in ds.data_vars.items() if data.ndim == 0}
    return {name: flags(data)[int(data)] if flags(data) else data.item() for name, data in single.items()}


def feature_lines(ds: xr.Dataset) -> list[str]:
    """Describe regime, period, impacts and rate of penetration; return no lines if nothing was measured."""
    run = run_of(ds)
    if not {"settle", "observe"} <= set(run) or "time" not in ds.dims:
        return []
    values = features(ds)
    lines = [_regime_line(ds, values)] if "regime" in values else []
    if "rate_of_penetration" in values:
        lines += _penetration_lines(ds, values)
    if not lines:
        return []
    quantities = []
    for name in ("impact_power", "specific_energy", "stick_slip_index"):
        if math.isfinite(values.get(name, math.nan)) and (name != "impact_power" or values[name] > 0):
            factor, unit = scale(ds[name])
            radius = hole_radius_of(ds) if name == "specific_energy" else None
            hole = "" if radius is None else f" (hole of radius {radius:g} m)"
            quantity = name.replace("stick_slip", "stick-slip").replace("_", " ")
            quantities.append(f"{quantity} {factor * values[name]:.4g} {pretty_unit(unit)}".rstrip() + hole)
    lines += [", ".join(quantities)] if quantities else []
    last = f"measured from {run['settle']:.4g} s to the end at {run['settle'] + run['observe']:.4g} s"
    if "returns" in values:
        last += f": {counted(int(values['returns']), 'return')} to the section"
        last += " (the bit overtakes the drive)" * ("x1" in ds)
    return [*lines, "; ".join(filter(None, [last, unsettled_text(values.get("drift_estimate", math.nan))]))]


def _regime_line(ds: xr.Dataset, values: dict[str, Any]) -> str:
    regime, returns, cycles = values["regime"], int(values["returns"]), int(values["cycles"])
    period = values.get("period", math.nan)
    if regime == "equilibrium":
        speed = parameters_of(ds).get("v") if "x1" in ds else None
        moves = "nothing moves" if speed is None else f"the bit moves steadily with the drive, at {speed:.4g} m/s"
        return f"equilibrium: {'the bit rests' if speed == 0 else moves}"
    if regime == "undecided" and returns < FEWEST_RETURNS:
        still = parameters_of(ds).get("v") == 0 and "x1" in ds
        at_rest = "the drive is at rest: give v above 0; a longer duration shows how the motion dies out"
        advice = at_rest if still else "give a longer duration"
        if returns > 1:
            observed, last = run_of(ds)["observe"], float(ds["time"][-1])
            advice = f"give duration={DURATION_MARGIN * (FEWEST_RETURNS + 1) * period / observed * last:.3g}"
        count = ("no return is", "one return is")[returns] if returns < 2 else f"{returns} returns to the section are"
        repeats = f"so far it repeats in each period of {cycles * period:.5g} s; " if cycles else ""
        return f"undecided: {count} too few to judge by, {FEWEST_RETURNS} are needed; {repeats}{advice}"
    if regime == "undecided":
        return "undecided: the amplitude steadily grows or decays; a longer duration shows what it ends in"
    if regime == "failed":
        return "failed: the motion does not stay finite"
    if "impacts" not in values:
        repeats = {0: "does not repeat", 1: "repeats"}.get(cycles, f"repeats after {cycles} returns")
        return f"{regime}: {repeats}, with {period:.5g} s from return to return"
    blows = values["impacts"]
    energy = f" and {values['impact_energy']:.4g} J" if "impact_energy" in values else ""
    unit = pretty_unit(str(ds["impact_velocity"].attrs.get("units", "m s-1"))) if blows else ""
    strength = f", at {values['impact_velocity']:.4g} {unit}{energy}" if blows else ""
    mean = ", on average" if blows > 1 or not cycles else ""
    if not cycles:
        often = f"a blow every {period / blows:.4g} s" if blows else "no blow"
        return f"{regime}: it does not repeat; {often}{mean + strength if blows else ''}"
    each = f"each period of {period:.5g} s" if cycles == 1 else f"each repeat, of {cycles} periods of {period:.5g} s"
    count = {0: "no blow", 1: "one blow"}.get(int(blows), f"{blows:.0f} blows")
    return f"{regime}: {count} in {each}{mean if blows else ''}{strength}"


def _penetration_lines(ds: xr.Dataset, values: dict[str, Any]) -> list[str]:
    rate, relief, slip = (values.get(name, math.nan) for name in ("rate_of_penetration", "relief", "slip_per_impact"))
    threshold = parameters_of(ds)["threshold"]
    event = "pulse" if "regime" not in values else "blow"
    force = f"mean force {values['mean_force'] / 1e3:.4g} kN over the {threshold / 1e3:.4g} kN at which the rock yields"
    lines = [f"relief P/D {relief:.4g}: {force}"] if math.isfinite(relief) else []
    if not math.isfinite(rate):
        return [f"no whole {event} was observed, so there is no rate of penetration; give a longer duration", *lines]
    if rate != 0:
        growth = f", {1e3 * slip:.4g} mm for each {event} (slip)" if math.isfinite(slip) else ""
        return [f"rate of penetration {rate:.4g} m/s ({3600 * rate:.4g} m/h){growth}", *lines]
    why, run = "the rock does not yield", run_of(ds)
    is_observed = (ds["time"] >= run["settle"]) & (ds["time"] <= run["settle"] + run["observe"])
    # Not the contact force, which may exceed D: the inertia of the bit takes a part of it.
    peak = float(ds["rock_force"].where(is_observed).max()) if "rock_force" in ds else math.nan
    if math.isfinite(peak):
        change = "a greater v" if "impact_velocity" in ds else "a greater force"
        why = (
            f"the rock force reaches {peak / 1e3:.4g} kN, {peak / threshold:.3g} of the threshold D = "
            f"{threshold / 1e3:.4g} kN at which the rock yields; a softer rock or {change} raises it"
        )
    return [f"no penetration: {why}", *lines]

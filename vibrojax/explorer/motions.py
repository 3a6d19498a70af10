"""Motions on demand: what a user selects in the explorer page is simulated and measured as by `vj.simulate`."""

import json
import time
import warnings
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr

from vibrojax.compile.xla import precision
from vibrojax.errors import InputError, Place, shown
from vibrojax.explorer.document import Document, given_of, one_line, options_of, run_seconds, start_of
from vibrojax.explorer.encoding import Cell, encode, pack
from vibrojax.explorer.recording import cell_of_record, event_times, finite, last_excerpt, repeated_pulses
from vibrojax.explorer.views import sweep_of
from vibrojax.io.attributes import text_of
from vibrojax.lanes.inputs import LaneInputs
from vibrojax.lanes.record import BATCH, Record, check_size, window
from vibrojax.maps.executor import compute
from vibrojax.maps.read import Point, read_point
from vibrojax.maps.rerun import rerun_problem
from vibrojax.maps.run import joined
from vibrojax.maps.sweep import Sweep
from vibrojax.periodic.lane_stages import lane_run
from vibrojax.physics.parameters import Parameter, substitutes
from vibrojax.pictures.axes import pretty_unit, scale, with_unit
from vibrojax.pictures.motion import unsettled_text
from vibrojax.scenes import Scene
from vibrojax.scenes.capabilities import HasRock
from vibrojax.settings.names import Names, read_names
from vibrojax.settings.values import UnusualValue
from vibrojax.stepping import AccuracyRequest, Located
from vibrojax.studies.trajectory_recording import Recorded, constants_at, recorded

PLACE = Place("explore")
BOX = PLACE.at("box")

ANSWER_ACCURACY = 1e-4  # error tolerance of a motion; the page shows no more digits
MOTION_MAX_SECONDS = 60.0  # longest simulated time, also of a sweep that settles for longer: it appears at once
MOTION_MAX_STEPS = 400_000  # more would take seconds and gigabytes; a typical motion has a few thousand
BOX_MAX_SIDE = 50  # maximum number of values along an axis of a box; more cells would take minutes
LOG_SLIDER_RATIO = 30.0  # smallest ratio of the greatest to the least value of a logarithmic slider


class LiveMotions:
    """Motions of one scene on demand; a request contains only the values that differ from those of a parameter point.

    - `values`: parameters (SI), names that replace them, radius of the hole, and options that differ from the defaults.
    - `start`: initial condition unless a request specifies another; None for the scene's first.
    - `duration` [s]: simulated time; its last part is observed.
    - `axes`: values by parameter that the slider of the parameter must include.
    - `sweep`: a sweep whose lanes can also be requested.
    """

    def __init__(
        self,
        scene: str | Scene[Any],
        values: Mapping[str, object],
        start: object = None,
        duration: float = 48.0,
        axes: Mapping[str, np.ndarray] | None = None,
        sweep: Sweep | None = None,
    ) -> None:
        self.point: Point = read_point(PLACE, scene, values, start)
        self.values = self.point.parameters | _radius(self.point)
        self.names: Names = read_names(PLACE.at("scene"), self.point.system)
        self.duration, self.whole = min(duration, MOTION_MAX_SECONDS), duration
        self.axes, self.sweep = dict(axes or {}), sweep
        self._stepper = Located()

    def answer(self, request: Mapping[str, Any], check: Callable[..., None]) -> bytes:
        """Return the requested motion, encoded for the explorer page.

        `request` is `lane`, the number of a lane; `lane` and `box`, see `box_of`, with an answer in JSON; or
        `parameters` by name, and `start`, the name or the vector of an initial condition. `check` is called often; an
        exception that it raises ends the simulation.
        """
        if set(request) == {"lane"}:
            return encode([self.lane(request["lane"], check)])
        if set(request) == {"box", "lane"}:
            box = box_of(self.sweep, self._number(request["lane"]), request["box"], check) if self.sweep else {}
            return json.dumps(box, allow_nan=False).encode()
        unknown = set(request) - {"parameters", "start"}
        if unknown:
            raise PLACE.at(min(unknown)).error("there is no such thing to ask for; give lane, or parameters and start")
        parameters = request.get("parameters", {})
        if not isinstance(parameters, dict):
            raise PLACE.at("parameters").error(f"{shown(parameters)} is not a table; give numbers by name")
        return encode([self.cell(parameters, request.get("start"), check)])

    def cell(
        self, parameters: Mapping[str, object], start: object = None, check: Callable[..., None] | None = None
    ) -> Cell:
        """Return the motion of the point with other `parameters`; its note lists unusual values."""
        start = self.point.start if start is None else start
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", UnusualValue)
            point = read_point(PLACE, self.point.system, self.values | dict(parameters), start)
        steps = 0

        def count_steps(reached: float) -> None:
            nonlocal steps
            steps += BATCH
            if check is not None:
                check()
            if steps > MOTION_MAX_STEPS:
                raise PLACE.error(
                    f"over {MOTION_MAX_STEPS} steps led to {reached:.3g} s of {self.duration:g} s; "
                    "give a softer contact, or less damping"
                )

        with precision("float64"):
            constants = constants_at(PLACE, point, self._stepper)
            accuracy = self._stepper.accuracy(AccuracyRequest(ANSWER_ACCURACY, None, None), point.system)
            check_size(PLACE, point.system, constants, self.duration, accuracy, self._stepper, 0)
            motion = recorded(point, self._stepper, constants, accuracy, self.duration, count_steps)
        cell = _cell_of_motion(point.system, constants, motion, self.duration)
        drift = motion.found["drift_estimate"][1] if "drift_estimate" in motion.found else np.nan
        unusual = (str(w.message) for w in caught if issubclass(w.category, UnusualValue))
        return replace(cell, note="; ".join(filter(None, (cell.note, unsettled_text(float(drift)), *unusual))))

    def lane(self, number: object, check: Callable[..., None] | None = None) -> Cell:
        """Return the motion of a lane of the sweep from its start, with the numbers of the dataset."""
        number = self._number(number)
        assert self.sweep is not None
        lane = self.sweep.inputs_of(np.array([number]))
        start: object = None
        if self.names.has_starts:
            index, names = int(lane.start[0]), lane.start_names
            start = names[index] if index < len(names) else [float(x[0]) for x in lane.states]
        values = {name: float(x[0]) for name, x in lane.parameters.items()} | _radius(lane)
        cell = self.cell(values, start, check)
        carried = "" if self.sweep.run.carry is None else "from the start, not carried on from the point before"
        note = "; ".join(text for text in (cell.note, carried) if text)
        return replace(cell, lane=number, numbers=None, note=note, point={"parameters": values, "start": start})

    def _number(self, number: object) -> int:
        lanes = self.sweep.lanes if self.sweep is not None else 0
        if type(number) is not int or not 0 <= number < lanes:
            raise PLACE.at("lane").error(f"{shown(number)} is not a lane; there are {lanes}, from 0")
        return number

    def warm(self) -> None:
        """Compile the programs, which all motions share, by simulating one motion."""
        self.cell({})

    def offered(self) -> dict[str, Any]:
        """Return a JSON description of the possible requests: sliders, the parameter point, and what a start may be."""
        system = self.names.system
        units = {state.name: state.unit for state in system.states}
        return {
            "parameters": [self._slider(parameter) for parameter in self.names.parameters.values()],
            "values": self.values,
            "starts": list(self.names.starts),
            "states": list(system.start_states),
            "state_labels": [with_unit(f"{name} at the start", units[name]) for name in system.start_states],
            "start": list(self.point.start) if isinstance(self.point.start, tuple) else self.point.start,
            "duration": self.duration,
            "whole": self.whole,
            "lanes": self.sweep.lanes if self.sweep is not None else 0,
            "rocks": self.names.presets.get("rock", {}),
        }

    def _slider(self, parameter: Parameter) -> dict[str, Any]:
        """Return the slider of a parameter, whose range includes the usual values, the default, point and axes.

        Without usual values, it extends to three times the greater magnitude of the default and the point's value.
        """
        value, default = self.point.parameters[parameter.name], parameter.default
        size = 3 * max(abs(default), abs(value)) or 1.0
        usual = parameter.usual or ((0.0, size) if default >= 0 else (-size, 0.0))
        known = np.array([*usual, default, value, *self.axes.get(parameter.name, ())], float)
        low, high = float(known.min()), float(known.max())
        if parameter.open_below and parameter.lowest is not None and low <= parameter.lowest:
            low = parameter.lowest + (high - parameter.lowest) / 1000
        about = {"units": parameter.unit, "symbol": parameter.symbol, "long_name": parameter.long_name}
        factor, unit = scale(xr.DataArray([low, high], name=parameter.name, attrs=about))
        return {
            "name": parameter.name,
            "label": one_line(parameter.long_name),
            "symbol": parameter.symbol,
            "units": pretty_unit(unit),
            "factor": factor,
            "low": low,
            "high": high,
            "log": low > 0 and high / low >= LOG_SLIDER_RATIO,
            "default": default,
        }


def box_of(sweep: Sweep, lane: int, box: object, check: Callable[..., None]) -> Document:
    """Return the variables of a sweep over a box of two of its axes, as JSON.

    `lane` is the number of a lane with the box's other parameters and initial condition; `box` contains [low, high] in
    SI units by axis. The result has `axes`, values by name, and `variables`, packed arrays over these axes by name.
    """
    if sweep.run.carry is not None or sweep.points is not None:
        raise BOX.error("only grids of independent lanes have boxes")
    if not isinstance(box, dict) or len(box) != 2 or not set(box) <= set(sweep.axes):
        raise BOX.error(f"{shown(box)} is not a table of two of the axes {', '.join(sweep.axes)}")
    axes = {name: _values_between(BOX.at(name), box[name], known) for name, known in sweep.axes.items() if name in box}
    (values, index), radius = sweep.lane_values(lane, lane + 1), _radius(sweep.inputs_of(np.array([lane])))
    fixed = {name: float(x[0]) for name, x in values.items() if name not in axes}
    starts = sweep.starts
    if starts is not None and len(starts):
        starts = replace(starts, number=starts.number[index], vectors=starts.vectors[index])
    run = replace(sweep.run, orbits=False, keep_returns=0)
    part = replace(
        sweep, axes=axes, parameters=sweep.parameters | fixed, given=sweep.given | radius, starts=starts, run=run
    )
    if problem := rerun_problem(part):
        raise BOX.error(f"it has {problem}")
    began, lanes = time.monotonic(), lane_run(part.inputs(0, 1), part.plan)
    whole = joined(part, lanes, dict(compute(part, lanes, range(part.chunks), check)), began)
    ds = whole.isel({name: 0 for name in whole.dims if name not in axes}, drop=True)
    arrays = {str(name): x.transpose(*axes) for name, x in ds.data_vars.items() if set(x.dims) == set(axes)}
    return {
        "axes": {name: x.tolist() for name, x in axes.items()},
        "variables": {name: pack(x.values) for name, x in arrays.items() if x.dtype.kind in "fiu"},
    }


def _values_between(place: Place, ends: Any, known: np.ndarray) -> np.ndarray:
    """Return evenly spaced values of an axis between two ends, at most a step outside its `known` values."""
    if known.dtype.kind != "f" or not isinstance(ends, list) or len(ends) != 2:
        raise place.error("give [low, high] of an axis of numbers")
    step = np.ptp(known) / max(len(known) - 1, 1)
    numbers = all(isinstance(x, (int, float)) and np.isfinite(x) for x in ends)
    if not numbers or not known.min() - step <= ends[0] < ends[1] <= known.max() + step:
        raise place.error(f"{shown(ends)} is not an interval within that of the map")
    return np.linspace(ends[0], ends[1], min(len(known), BOX_MAX_SIDE))


def motions_for(ds: xr.Dataset, own: Sweep | None = None) -> LiveMotions:
    """Return the motions on demand for a dataset: for its sweep if there is one, else for its parameter point."""
    sweep, _ = sweep_of(ds, own)
    if sweep is not None:
        return motions_of(sweep)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UnusualValue)
        return LiveMotions(text_of(ds, "scene"), given_of(ds) | options_of(ds), start_of(ds), run_seconds(ds))


def motions_of(sweep: Sweep) -> LiveMotions:
    """Return the motions on demand for the lanes of a sweep and for other parameters."""
    first = sweep.inputs_of(np.zeros(1, int))
    values = {name: float(x[0]) for name, x in first.parameters.items()} | _radius(first)
    axes = {name: x for name, x in {**sweep.axes, **(sweep.points or {})}.items() if x.dtype.kind == "f"}
    start = sweep.starts[0] if sweep.starts is not None and len(sweep.starts) else None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UnusualValue)  # reported when the sweep was read
        return LiveMotions(sweep.system, values, start, sweep.run.settle + sweep.run.observe, axes, sweep)


def _radius(machine: Point | LaneInputs) -> dict[str, float]:
    """Return the radius of the hole [m] by name if it may be given in the scene."""
    scene = machine.system if isinstance(machine, Point) else machine.scene
    drills = isinstance(scene, HasRock) and "bit_radius" in substitutes(scene.parameters())
    return {"bit_radius": float(np.ravel(machine.hole_radius)[0])} if drills else {}


def _cell_of_motion(scene: Scene[Any], constants: Any, motion: Recorded, duration: float) -> Cell:
    """Return the last period of a recorded motion, or some of its last section crossings, with its features."""
    if not np.isfinite(motion.steps.after).all():
        raise InputError("explore: the motion is not finite; give values nearer to the usual ones")
    observed = window(scene, duration)[0]
    late = motion.steps.start >= observed
    record = Record(*(np.asarray(x)[late] for x in motion.steps))
    with precision("float64"):
        [moments] = event_times(scene, constants, record)
    if "cycles" in motion.found:
        cycles = int(motion.found["cycles"][1])
    else:
        after = np.asarray(record.after)[:, [scene.place(name) for name in scene.driving_part().return_states]]
        passed = after[np.searchsorted(record.start + record.dt, moments["section"])]
        cycles = repeated_pulses(passed, np.ptp(after, axis=0) / 2)
    cell = cell_of_record(scene, record, moments, last_excerpt(moments["section"], cycles, observed, duration))
    return replace(cell, numbers=finite({name: value.item() for name, (_, value, _) in motion.found.items()}))

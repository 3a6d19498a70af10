"""What a click is answered with: the motion at a point, simulated and measured as `vj.simulate` does it, as a cell."""

import warnings
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr

from vibrojax.compile.devices import precision
from vibrojax.errors import InputError, Place, shown
from vibrojax.explorer.cells import Cell, encode
from vibrojax.explorer.recorded import events_of
from vibrojax.explorer.run import options_of, start_of, window_of
from vibrojax.explorer.sampled import PASSED, SHOWN, STILL, Begin, cell_of_steps
from vibrojax.io.attributes import differing_of, text_of
from vibrojax.models.physics.parameters import ROTATION, Parameter
from vibrojax.models.physics.rock import ROCKS
from vibrojax.models.scenes import Scene
from vibrojax.plot.axes import pretty_unit, scale
from vibrojax.stepping import Located, Wanted
from vibrojax.sweep.input.definition import Sweep, rock_values
from vibrojax.sweep.input.names import Names, read_names
from vibrojax.sweep.input.plausible import UnusualValue
from vibrojax.sweep.input.point import Point, read_point
from vibrojax.sweep.input.starts import Start
from vibrojax.sweep.simulation.dense_output import BATCH, check_size
from vibrojax.sweep.simulation.features import window
from vibrojax.sweep.simulation.recording import Recorded, constants_at, recorded

PLACE = Place("explore")

LONGEST = 60.0
"""Seconds that are simulated at most, also where a sweep settles for longer."""

MOST_STEPS = 400_000
"""Of one motion, so that none takes seconds and gigabytes; a usual one has some thousands."""

SAME, MOST_CYCLES = 1e-3, 8
"""How near the states at pulses are to those that they repeat, over half their swings, and after how many pulses."""

WIDE = 30.0
"""How many times the least usual value the greatest is where a slider is logarithmic."""


class Motions:
    """Motions of one scene, each from a few values that differ from a point's.

    **Arguments:**

    - `scene`: its name, or a scene.
    - `given`: parameters (SI) that are not the defaults, and options such as `friction`.
    - `start`: the start that motions have of themselves; None: the scene's first.
    - `duration` [s]: how long they are simulated; the last part is observed.
    - `axes`: values between which parameters vary at least, by name.
    - `sweep`: of whose lanes motions are asked for too.

    **Raises:** `InputError`.
    """

    def __init__(
        self,
        scene: str | Scene[Any],
        given: Mapping[str, object],
        start: object = None,
        duration: float = 48.0,
        axes: Mapping[str, np.ndarray] | None = None,
        sweep: Sweep | None = None,
    ) -> None:
        self.point: Point = read_point(PLACE, scene, given, start)
        self.names: Names = read_names(PLACE.at("scene"), self.point.system)
        self.duration, self.whole = min(duration, LONGEST), duration
        self.axes, self.sweep = dict(axes or {}), sweep
        self._stepper = Located()

    def answer(self, asked: Mapping[str, Any], check: Callable[..., None]) -> bytes:
        """The motion that a request asks for, as a block of one cell.

        **Arguments:** `asked`: `lane`, the number of a lane; or `parameters`, numbers by name (others are the point's),
        and `start`, a name or a vector; `check` is called often, and what it raises ends the motion.

        **Raises:** `InputError` where something is not right, or the motion takes too long.
        """
        if set(asked) == {"lane"}:
            return encode([self.lane(asked["lane"], check)])
        unknown = set(asked) - {"parameters", "start"}
        if unknown:
            raise PLACE.at(min(unknown)).error("there is no such thing to ask for; give lane, or parameters and start")
        parameters = asked.get("parameters", {})
        if not isinstance(parameters, dict):
            raise PLACE.at("parameters").error(f"{shown(parameters)} is no table; give numbers by name")
        return encode([self.cell(parameters, asked.get("start"), check)])

    def cell(
        self, parameters: Mapping[str, object], start: object = None, check: Callable[..., None] | None = None
    ) -> Cell:
        """The motion where `parameters` differ from the point's, as a cell; its note is what is unusual about them."""
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always", UnusualValue)
            point = read_point(PLACE, self.point.system, self.point.parameters | dict(parameters), self._start(start))
        done, constants = self.recorded(point, check)
        note = "; ".join(str(one.message) for one in said if issubclass(one.category, UnusualValue))
        return _cell(point.system, constants, done, self.duration, note)

    def lane(self, number: object, check: Callable[..., None] | None = None) -> Cell:
        """The motion of a lane of the sweep, simulated from its start; its numbers are the dataset's."""
        lanes = self.sweep.lanes if self.sweep is not None else 0
        if type(number) is not int or not 0 <= number < lanes or self.sweep is None:
            raise PLACE.at("lane").error(f"{shown(number)} is no lane; there are {lanes}, from 0")
        values, _ = self.sweep.lane_values(number, number + 1)
        found = self.cell({name: float(x[0]) for name, x in values.items()}, self._start_of(self.sweep, number), check)
        carried = "" if self.sweep.run.carry is None else "from the start, not carried on from the point before"
        return replace(found, lane=number, numbers=None, note="; ".join(text for text in (found.note, carried) if text))

    def _start_of(self, sweep: Sweep, number: int) -> object:
        """The start of a lane: a name, or a vector."""
        if not self.names.has_starts:
            return None
        start, vectors = sweep.lane_starts(number, number + 1)
        if int(start[0]) < len(sweep.start_names):
            return sweep.start_names[int(start[0])]
        return [float(x[0]) for x in vectors]

    def recorded(self, point: Point, check: Callable[..., None] | None = None) -> tuple[Recorded, Any]:
        """A point's motion, and the scene's constants at it."""
        with precision("float64"):
            constants = constants_at(PLACE, point, self._stepper)
            accuracy = self._stepper.accuracy(Wanted(1e-4, None, None), point.system)
            check_size(PLACE, point.system, constants, self.duration, accuracy, self._stepper, 0)
            steps = 0

            def tell(reached: float) -> None:
                nonlocal steps
                steps += BATCH
                if check is not None:
                    check()
                if steps > MOST_STEPS:
                    raise PLACE.error(
                        f"over {MOST_STEPS} steps led to {reached:.3g} s of {self.duration:g} s; "
                        "give a softer contact, or less damping"
                    )

            return recorded(point, self._stepper, constants, accuracy, self.duration, tell), constants

    def warm(self) -> None:
        """Compile what motions need, by one of them."""
        self.cell({})

    def offered(self) -> dict[str, Any]:
        """What may be asked for, as JSON: `parameters` with their usual ranges, `starts`, `states` of a vector, and the
        point's own `values` and `start`; numbers in SI, `factor` to the unit that is shown."""
        return {
            "scene": self.point.scene,
            "parameters": [self._slider(one) for one in self.names.parameters.values()],
            "values": self.point.parameters,
            "starts": list(self.names.starts),
            "states": list(self.names.system.start_states),
            "start": list(self.point.start) if isinstance(self.point.start, tuple) else self.point.start,
            "duration": self.duration,
            "whole": self.whole,
            "observed": window(self.duration)[1],
            "lanes": self.sweep.lanes if self.sweep is not None else 0,
            "rocks": {name: rock_values(name) for name in ROCKS} if self.names.has_rock else {},
            "bit_radius": ROTATION["bit_radius"].default,
        }

    def _start(self, start: object) -> object:
        return self.point.start if start is None else start

    def _slider(self, one: Parameter) -> dict[str, Any]:
        """A parameter between its usual values and all that occur; without usual ones, to three times its default."""
        value = self.point.parameters[one.name]
        size = 3 * max(abs(one.default), abs(value)) or 1.0
        usual = one.usual or ((0.0 if one.default >= 0 else -size), size if one.default >= 0 else 0.0)
        known = np.array([*usual, one.default, value, *self.axes.get(one.name, ())], float)
        low, high = float(known.min()), float(known.max())
        if one.open_below and one.lowest is not None and low <= one.lowest:
            low = one.lowest + (high - one.lowest) / 1000
        factor, unit = scale(xr.DataArray([low, high], attrs={"units": one.unit}))
        return {
            "name": one.name,
            "label": one.long_name,
            "symbol": one.symbol,
            "units": pretty_unit(unit),
            "factor": factor,
            "low": low,
            "high": high,
            "log": low > 0 and high / low >= WIDE,
            "default": one.default,
        }


def motions_of(sweep: Sweep) -> Motions:
    """The motions around the lanes of a sweep."""
    values = {name: float(x[0]) for name, x in sweep.lane_values(0, 1)[0].items()}
    axes = {name: x for name, x in {**sweep.axes, **(sweep.points or {})}.items() if x.dtype.kind == "f"}
    start: Start | None = sweep.starts[0] if sweep.starts is not None and len(sweep.starts) else None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UnusualValue)  # said when the sweep was read
        return Motions(sweep.system, values, start, sweep.run.settle + sweep.run.observe, axes, sweep)


def motions_around(ds: xr.Dataset) -> Motions:
    """The motions around what a dataset holds, by its attributes; raises `InputError` where they name no scene."""
    given: dict[str, object] = {one["name"]: one["value"] for one in differing_of(ds)}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UnusualValue)
        return Motions(text_of(ds, "scene"), given | options_of(ds), start_of(ds), sum(window_of(ds)))


def _cell(scene: Scene[Any], constants: Any, done: Recorded, duration: float, note: str) -> Cell:
    """A recorded motion's last repeat, or some of its last returns, and its numbers."""
    steps = done.steps
    if not np.isfinite(steps.after).all():
        raise InputError("explore: the motion is not finite; give values nearer to the usual ones")
    late = steps.start >= window(duration)[0]
    last = {name: np.asarray(x)[late, ..., None] for name, x in steps._asdict().items()}
    with precision("float64"):
        events = events_of(scene, constants, last)
    ends = (last["start"] + last["dt"])[events["section"]]
    if "cycles" in done.found:
        cycles = int(done.found["cycles"][1])
    else:
        cycles = _repeats(last["after"][..., 0], events["section"][:, 0], scene)
    begin = _begin(ends, cycles, duration)
    alone = {name: x[..., 0] for name, x in last.items()}
    cell = cell_of_steps(scene, alone, {name: mask[:, 0] for name, mask in events.items()}, begin)
    numbers = {name: _plain(value) for name, (_, value, _) in done.found.items()}
    return replace(cell, note="; ".join(text for text in (cell.note, note) if text), numbers=numbers)


def _repeats(after: np.ndarray, returns: np.ndarray, scene: Scene[Any]) -> int:
    """After how many pulses the states repeat, as returns do; 0 where they do not.

    **Arguments:** `after`: the states after each step (steps, states); `returns`: which of the steps a pulse ends on.
    """
    columns = after[:, [scene.place(name) for name in scene.driving_part().return_states]]
    passed, swing = columns[returns], np.maximum(np.ptp(columns, axis=0), np.finfo(float).tiny) / 2
    for cycles in range(1, MOST_CYCLES + 1):
        away = np.abs(passed[cycles:] - passed[:-cycles]) / swing
        if len(passed) > 3 * cycles and (away < SAME).all():
            return cycles
    return 0


def _begin(returns: np.ndarray, cycles: int, duration: float) -> Begin:
    """What is shown of a motion with these `returns` [s]: of one that repeats the last repeat."""
    nothing = np.zeros(0)
    if len(returns) < 2:
        still = min(STILL, duration / 2)
        return Begin(nothing, np.array(False), *map(np.asarray, (duration - still, still, duration, 0)))
    if 0 < cycles < len(returns):
        first, end = returns[-1 - cycles], returns[-1]
        return Begin(nothing, np.array(True), *map(np.asarray, (first, end - first, end, cycles)))
    first = max(len(returns) - 1 - PASSED, 0)
    end = min(first + SHOWN, len(returns) - 1)
    span = returns[end] - returns[first]
    return Begin(nothing, np.array(False), *map(np.asarray, (returns[first], span, duration, end - first)))


def _plain(value: np.ndarray) -> float | int | None:
    one = value.item()
    return one if isinstance(one, int) or np.isfinite(one) else None

"""What a click is answered with: the motion at a point, simulated and measured as `vj.simulate` does it, as a cell."""

import warnings
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import xarray as xr

from vibrojax.devices import precision
from vibrojax.errors import InputError, Place, shown
from vibrojax.explorer.cells import Cell, encode
from vibrojax.explorer.motions import PASSED, SHOWN, STILL, Begin
from vibrojax.explorer.motions import _cell as cell_of
from vibrojax.explorer.motions import _events as events_of
from vibrojax.input.definition import Sweep
from vibrojax.input.names import Names, read_names
from vibrojax.input.plausible import UnusualValue
from vibrojax.input.point import Point, read_point
from vibrojax.input.starts import Start
from vibrojax.physics.parameters import Parameter
from vibrojax.plot._axes import pretty_unit, scale
from vibrojax.scenes import Scene
from vibrojax.simulation._measured import window
from vibrojax.simulation._record import Record, check_size
from vibrojax.simulation._recorded import Recorded, constants_at, recorded
from vibrojax.stepping import Located, Wanted

PLACE = Place("explore")

LONGEST = 60.0
"""Seconds that are simulated at most, also where a sweep settles for longer."""

MOST_STEPS = 400_000
"""Of one motion, so that none takes seconds and gigabytes; a usual one has some thousands."""

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

    **Raises:** `InputError`.
    """

    def __init__(
        self,
        scene: str | Scene[Any],
        given: Mapping[str, object],
        start: object = None,
        duration: float = 48.0,
        axes: Mapping[str, np.ndarray] | None = None,
    ) -> None:
        self.point: Point = read_point(PLACE, scene, given, start)
        self.names: Names = read_names(PLACE.at("scene"), self.point.system)
        self.duration = min(duration, LONGEST)
        self.axes = dict(axes or {})
        self._stepper = Located()

    def answer(self, asked: Mapping[str, Any], check: Callable[..., None]) -> bytes:
        """The motion that a request asks for, as a block of one cell.

        **Arguments:** `asked`: `parameters`, numbers by name (others are the point's), and `start`, a name or a vector;
        `check` is called often, and what it raises ends the motion.

        **Raises:** `InputError` where something is not right, or the motion takes too long.
        """
        unknown = set(asked) - {"parameters", "start"}
        if unknown:
            raise PLACE.at(str(min(unknown))).error("there is no such thing to ask for; give parameters and start")
        parameters = asked.get("parameters")
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

    def recorded(self, point: Point, check: Callable[..., None] | None = None) -> tuple[Recorded, Any]:
        """A point's motion, and the scene's constants at it."""
        with precision("float64"):
            constants = constants_at(PLACE, point, self._stepper)
            accuracy = self._stepper.accuracy(Wanted(1e-4, None, None), point.system)
            most = check_size(PLACE, point.system, constants, self.duration, accuracy, self._stepper, 0)
            most = min(most, MOST_STEPS)
            return recorded(point, self._stepper, constants, accuracy, self.duration, check, most), constants

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
            "observed": window(self.duration)[1],
        }

    def _start(self, start: object) -> object:
        return self.point.start if start is None else start

    def _slider(self, one: Parameter) -> dict[str, Any]:
        """A parameter between its usual values and all that occur; without usual ones, up to three times its default."""
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
        return Motions(sweep.system, values, start, sweep.run.settle + sweep.run.observe, axes)


def _cell(scene: Scene[Any], constants: Any, done: Recorded, duration: float, note: str) -> Cell:
    """A recorded motion's last repeat, or some of its last returns, and its numbers."""
    from dataclasses import replace

    steps = done.steps
    if not np.isfinite(steps.after).all():
        raise InputError("explore: the motion is not finite; give values nearer to the usual ones")
    late = steps.start >= window(duration)[0]
    last = Record(*(x[late, ..., None] for x in steps))
    with precision("float64"):
        events = events_of(scene, constants, last)
    ends = (last.start + last.dt)[events["section"]]
    cycles = int(done.found["cycles"][1]) if "cycles" in done.found else 0
    begin = _begin(ends, cycles, duration)
    alone = Record(*(x[..., 0] for x in last))
    cell = cell_of(scene, alone, {name: mask[:, 0] for name, mask in events.items()}, begin)
    numbers = {name: _plain(value) for name, (_, value, _) in done.found.items()}
    return replace(cell, note="; ".join(text for text in (cell.note, note) if text), numbers=numbers)


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

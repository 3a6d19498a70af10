"""A validated sweep: fixed values, axes or points, and the values of any of its lanes."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import prod
from typing import Any

import numpy as np

from vibrojax.lanes.inputs import LaneInputs, Plan
from vibrojax.maps.starts import VECTOR, Starts
from vibrojax.measures.labels import HOLE_RADIUS
from vibrojax.periodic.lane_stages import plan_of
from vibrojax.physics.parameters import resolved, substitutes
from vibrojax.scenes import HasRock, Scene
from vibrojax.settings.code_identity import code_identity
from vibrojax.settings.run_settings import RunSettings

DIRECTIONS = ("up", "down")
"""Directions of a continuation along an axis, in which each lane begins in the final state of the previous lane."""

CARRIED_MIN_ROWS = 64
"""Minimum number of rows per chunk. Rows run in parallel, and fewer would leave blocks of lanes partly empty."""

_MAX_LISTED = 8
"""Maximum length of a column whose values are listed in the identity. Longer columns are represented by a checksum."""


@dataclass(frozen=True, eq=False)
class Sweep:
    """The content of a sweep file, completed with defaults.

    - `name`: file name of the output, without extension.
    - `text`: the sweep as TOML.
    - `title`: free text.
    - `file`: name of the sweep file, which error messages state.
    - `scene`: name of the scene. `system`: the scene object.
    - `options`: chosen value of each option of the scene, such as the name of the friction law.
    - `starts`: initial conditions, as names or vectors such as (x1, x1', x2, x2') [m, m/s]; None for a scene with a
      single initial condition. `own_starts`: True if point i of the table has its own initial condition, `starts[i]`.
    - `parameters`: all fixed parameters by name, in SI units. `given`: the parameters that the user specified.
    - `axes`: arrays of the values of each axis of the grid, by name in the order of the file; empty if only the initial
      condition varies.
    - `points`: the columns of a table of points by name, as arrays (points,); None without such a table.
    - `run`: settings of the run.

    Fixed values of `rpm` and `bit_radius` are converted to `v` in `parameters`.
    """

    name: str
    text: str
    title: str
    scene: str
    options: dict[str, str]
    system: Scene[Any]
    starts: Starts | None
    parameters: dict[str, float]
    given: dict[str, float]
    axes: dict[str, np.ndarray] = field(default_factory=dict)
    points: dict[str, np.ndarray] | None = None
    own_starts: bool = False
    run: RunSettings = field(default_factory=RunSettings)
    file: str = "sweep"

    @property
    def friction(self) -> str | None:
        """Name of the friction law, or None for a scene without friction."""
        return self.options.get("friction")

    @property
    def dims(self) -> tuple[str, ...]:
        """Names of the dimensions: the axes or "point", followed by "start" or "direction" if lanes differ in these."""
        last = ("direction",) if self.run.carry is not None else ("start",) if self.crosses_starts else ()
        return (*self.axes, *(("point",) if self.points is not None else ()), *last)

    @property
    def shape(self) -> tuple[int, ...]:
        return self._sizes(self.dims)

    @property
    def counted(self) -> tuple[str, ...]:
        """Names of the dimensions in the order in which lanes are numbered: `dims`, but with a carried axis last."""
        return tuple(sorted(self.dims, key=lambda name: name == self.run.carry))

    @property
    def lanes(self) -> int:
        """Number of lanes, a Python integer, so that it cannot overflow."""
        return prod(self.shape)

    @property
    def crosses_starts(self) -> bool:
        """True if every point is run from each initial condition."""
        return self.starts is not None and not self.own_starts and self.run.carry is None

    @property
    def start_names(self) -> tuple[str, ...]:
        return self.starts.names if self.starts is not None else ()

    @property
    def start_columns(self) -> dict[str, np.ndarray]:
        """Columns of the points that give each its own start: its states, or the index of its name."""
        if not self.own_starts or self.starts is None:
            return {}
        return self.starts.columns if self.starts.has_vectors else {"start": self.starts.number}

    def over_dims(self, lanes: np.ndarray) -> np.ndarray:
        """Reshape an array over all lanes (lanes, ...) to the dimensions of the sweep, `(*shape, ...)`."""
        grid = lanes.reshape(*self._sizes(self.counted), *lanes.shape[1:])
        order = [self.counted.index(name) for name in self.dims]
        return grid.transpose(*order, *range(len(order), grid.ndim))

    def lane_values(self, first: int, end: int) -> tuple[dict[str, np.ndarray], np.ndarray]:
        """Return parameters and initial conditions of the lanes from `first` (inclusive) to `end` (exclusive).

        Lanes are numbered in row-major order over `counted`. Memory grows with end - first only.

        **Returns:** the scene's parameters by name (float64), and the index into `starts` (zeros for a scene without
        initial conditions), arrays (end - first,).
        """
        return self.values_of(np.arange(first, end))

    def values_of(self, numbers: np.ndarray) -> tuple[dict[str, np.ndarray], np.ndarray]:
        """Return the values of `lane_values` for the lanes with these numbers (lanes,)."""
        varied, start = self._varied(numbers)
        values = with_substitutes(self.system, self.parameters | varied)
        values = {name: np.broadcast_to(values[name], len(numbers)).astype(float) for name in self.system.parameters()}
        return values, start

    def _varied(self, numbers: np.ndarray) -> tuple[dict[str, np.ndarray], np.ndarray]:
        """Return the values of axes and columns by name, and the index into `starts`, for the lanes `numbers`."""
        places = np.unravel_index(numbers, self._sizes(self.counted))
        indices = dict(zip(self.counted, places, strict=True))
        varied = {name: axis[indices[name]] for name, axis in self.axes.items()}
        varied |= {name: column[indices["point"]] for name, column in (self.points or {}).items()}
        name = "point" if self.own_starts else "start" if self.crosses_starts else ""
        return varied, np.asarray(indices[name] if name else np.zeros(len(numbers), int))

    @property
    def hole_radius(self) -> float | None:
        """Radius of the hole [m] that `specific_energy` is computed with; None if it varies among the lanes."""
        varies = "bit_radius" in (self.points or self.axes)
        return None if varies else self.given.get("bit_radius", HOLE_RADIUS)

    def inputs_of(self, numbers: np.ndarray) -> LaneInputs:
        """Return the lanes with these numbers (lanes,) as independent lanes."""
        values, start = self.values_of(numbers)
        states: tuple[np.ndarray, ...] = ()
        if self.starts is not None:
            if self.starts.has_vectors:  # the states of a named initial condition are not used
                states = tuple(np.nan_to_num(self.starts.vectors[start]).T)
            start = self.starts.number[start]
        radius: float | np.ndarray | None = self.hole_radius
        if radius is None:
            radius = self._varied(numbers)[0]["bit_radius"]
        return LaneInputs(self.system, self.run, values, start, self.start_names, states, radius)

    def inputs(self, first: int = 0, end: int | None = None) -> LaneInputs:
        """Return the lanes from `first` to `end` (exclusive), by default all; with `carry`, give complete rows."""
        lanes = np.arange(first, self.lanes if end is None else end)
        if self.run.carry is None:
            return self.inputs_of(lanes)
        row = len(self.axes[self.run.carry])
        upwards = lanes[::row] // row % len(DIRECTIONS) == DIRECTIONS.index("up")
        return replace(self.inputs_of(lanes), row=row, upwards=upwards)

    @cached_property
    def plan(self) -> Plan:
        """Facts of the whole run, which every chunk needs. With `carry`, chunks consist of complete rows."""
        starts = 1.0
        if self.crosses_starts:
            starts = float(self.shape[-1])
        elif self.own_starts and not self.start_names:  # points listed with their states: the average
            columns = [column.tolist() for column in (self.points or {}).values()]
            starts = self.lanes / max(len(set(zip(*columns, strict=True))), 1)
        plan = plan_of(self.system, self.run, self.lanes, starts)
        if self.run.carry is None:
            return plan
        row = len(self.axes[self.run.carry])
        size = self.run.chunk or max(plan.chunk, CARRIED_MIN_ROWS * row)
        return replace(plan, chunk=max(size // row, 1) * row)

    @property
    def chunks(self) -> int:
        """Number of chunks in which the lanes are computed."""
        return -(-self.lanes // self.plan.chunk)

    def chunk(self, index: int) -> tuple[int, int]:
        """Return the first lane of a chunk, and the end of its lanes."""
        size = self.plan.chunk
        return index * size, min((index + 1) * size, self.lanes)

    def identity(self) -> dict[str, object]:
        """Return everything that determines the results as flat JSON values, equal for sweeps with the same lanes.

        Long columns are represented by their checksum, the code of the user's own scenes, laws and steppers by a
        digest. Chunk size, title and wording of the file are not included.
        """
        columns = (self.points or {}) | self.start_columns
        varied = {f"grid.{name}": axis for name, axis in self.axes.items()}
        varied |= {f"points.{name}": column for name, column in columns.items()}
        starts: object = None
        if self.own_starts:
            starts = list(self.start_names) or None
        elif self.starts is not None and self.starts.listed:
            starts = [start if isinstance(start, str) else list(start) for start in self.starts]
        elif self.starts is not None:
            varied |= {f"starts.{name.removeprefix(VECTOR)}": x for name, x in self.starts.columns.items()}
        fixed = {"scene": self.scene, **self.options, "dims": list(self.dims), "starts": starts}
        fixed |= code_identity(self.system, self.options, method=self.run.stepper)
        fixed |= {f"parameters.{name}": value for name, value in self.parameters.items()}
        if isinstance(self.system, HasRock) and "bit_radius" in self.given:
            fixed["parameters.bit_radius"] = self.given["bit_radius"]
        for name, column in varied.items():
            if column.size <= _MAX_LISTED:
                fixed[name] = column.tolist()
            elif column.dtype.kind == "U":
                digest = hashlib.sha256("\n".join(column.tolist()).encode()).hexdigest()[:16]
                fixed[name] = f"{column.size} names, sha256 {digest}"
            else:
                digest = hashlib.sha256(np.ascontiguousarray(column).astype("<f8").tobytes()).hexdigest()[:16]
                fixed[name] = f"{column.size} values from {column[0]:g} to {column[-1]:g}, sha256 {digest}"
        return fixed | {f"run.{name}": value for name, value in self.run.described().items()}

    def _sizes(self, dims: tuple[str, ...]) -> tuple[int, ...]:
        columns = [*(self.points or {}).values(), *self.start_columns.values()]
        sizes = {name: len(axis) for name, axis in self.axes.items()}
        sizes |= {"point": len(columns[0]) if columns else 0, "start": len(self.starts or ())}
        sizes |= {"direction": len(DIRECTIONS)}
        return tuple(sizes[name] for name in dims)


def with_substitutes(scene: Scene[Any], values: Mapping[str, Any]) -> dict[str, Any]:
    """Return `values` with presets (names, or arrays of names), rotation and frequencies replaced by parameters.

    See [vibrojax.physics.parameters.resolved][]; presets are replaced by the parameters that they set.
    """
    values = dict(values)
    for preset, parameters in scene.presets.items():
        if preset in values:
            rows = [parameters[str(name)] for name in values.pop(preset)]
            values |= {name: np.array([row[name] for row in rows]) for name in rows[0]}
    return resolved(values, substitutes(scene.parameters()))

"""A checked sweep: fixed values, axes or points, and the values of any of its lanes."""

import hashlib
from dataclasses import dataclass, field
from math import prod
from typing import Any

import numpy as np

from vibrojax.models.scenes import Scene
from vibrojax.sweep.input.names import rock_values as rock_values
from vibrojax.sweep.input.names import with_substitutes
from vibrojax.sweep.input.run_settings import RunSettings
from vibrojax.sweep.input.starts import Starts

DIRECTIONS = ("up", "down")
"""Directions in which lanes are carried along an axis."""

_MAX_LISTED = 8
"""Longest column whose values the identity lists; of a longer one it has the checksum."""


@dataclass(frozen=True, eq=False)
class Sweep:
    """The content of a sweep file, complete with defaults.

    - `name`: the stem of its output; `text`: its TOML; `title`: free text; `file`: its name in messages.
    - `scene`: its name; `options`: the names of its options, such as the friction law; `system`: the scene itself.
    - `starts`: names, and vectors such as (x1, x1', x2, x2') [m, m/s]; None for a scene without starts.
    - `parameters`: all fixed values by name, SI; `given`: those among them that the user wrote.
    - `axes`: the grid, each axis of shape (values,), in the file's order; empty if only the start varies.
    - `points`: columns of shape (points,) in place of a grid. With them, `point_starts` may name the start of each
      point, or `point_vectors` give its states, by the names of their columns, each (points,), in the scene's order.
      There are no other starts then.
    - `run`: the settings of the run.

    Fixed `rpm` and `bit_radius` are in `parameters` as `v`. If one of the two varies, `v` is in neither `parameters`
    nor `axes`, but in the values of the lanes.
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
    point_starts: list[str] | None = None
    point_vectors: dict[str, np.ndarray] | None = None
    run: RunSettings = field(default_factory=RunSettings)
    file: str = "sweep"

    @property
    def friction(self) -> str | None:
        """Name of the friction law; None for a scene that does not slide."""
        return self.options.get("friction")

    @property
    def dims(self) -> tuple[str, ...]:
        """Names of the dimensions: the axes or "point", if any, then "start" or "direction" if there is one."""
        last = ("direction",) if self.run.carry is not None else ("start",) if self.crosses_starts else ()
        return (*self.axes, *(("point",) if self.points is not None else ()), *last)

    @property
    def shape(self) -> tuple[int, ...]:
        """Sizes of the dimensions."""
        return self._sizes(self.dims)

    @property
    def counted(self) -> tuple[str, ...]:
        """The dimensions in the order in which lanes are counted: as in `dims`, but the carried one comes last."""
        return tuple(sorted(self.dims, key=lambda name: name == self.run.carry))

    @property
    def lanes(self) -> int:
        """Number of lanes, as a Python integer, which does not overflow."""
        return prod(self.shape)

    @property
    def crosses_starts(self) -> bool:
        """True if every point runs from each of the starts."""
        return self.starts is not None and self.point_starts is None and self.run.carry is None

    @property
    def start_names(self) -> tuple[str, ...]:
        """The starts that have names."""
        return self.starts.names if self.starts is not None else ()

    def over_dims(self, lanes: np.ndarray) -> np.ndarray:
        """Return an array over all lanes, (lanes, ...), over the dimensions, `(*shape, ...)`."""
        grid = lanes.reshape(*self._sizes(self.counted), *lanes.shape[1:])
        order = [self.counted.index(name) for name in self.dims]
        return grid.transpose(*order, *range(len(order), grid.ndim))

    def lane_values(self, first: int, end: int) -> tuple[dict[str, np.ndarray], np.ndarray]:
        """Return the scene's parameters, and the index into `starts`, of the lanes from `first` to before `end`.

        Lanes are counted in row-major order over `counted`. The arrays have shape (end - first,): float64 by name, and
        integer (zeros for a scene without starts). Memory grows with end - first only.
        """
        return self.values_of(np.arange(first, end))

    def values_of(self, numbers: np.ndarray) -> tuple[dict[str, np.ndarray], np.ndarray]:
        """Return the same as `lane_values` for lanes of any numbers (lanes,)."""
        places = np.unravel_index(numbers, self._sizes(self.counted))
        indices = dict(zip(self.counted, places, strict=True))
        varied = {name: axis[indices[name]] for name, axis in self.axes.items()}
        if self.points is not None:
            varied |= {name: column[indices["point"]] for name, column in self.points.items()}
        values = with_substitutes(self.parameters | varied)
        values = {name: np.broadcast_to(values[name], len(numbers)).astype(float) for name in self.system.parameters()}
        if self.point_starts is not None:
            return values, self._start_of_point()[indices["point"]]
        return values, np.asarray(indices["start"] if self.crosses_starts else np.zeros(len(numbers), int))

    def lane_starts(self, first: int, end: int) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
        """Return the starts of the lanes from `first` to before `end`: indices and states, each (end - first,).

        An index points into `start_names`; for a start without a name it is their number, and the states count. The
        states are empty if all starts have names.
        """
        start = self.lane_values(first, end)[1]
        if self.point_vectors is not None:
            return start, tuple(column[first:end] for column in self.point_vectors.values())
        if self.starts is None or not self.starts.has_vectors:
            return start, ()
        # The states of a named start are not used.
        return self.starts.number[start], tuple(np.nan_to_num(self.starts.vectors[start]).T)

    def identity(self) -> dict[str, object]:
        """Return all that the results depend on as flat JSON values, equal for two sweeps that compute the same lanes.

        Long columns stand in it by their checksum. The chunk, the title and the wording of the file are not in it.
        """
        columns = {**(self.points or {}), **(self.point_vectors or {})}
        if self.point_starts is not None:
            columns["start"] = self._start_of_point()
        varied = {f"grid.{name}": axis for name, axis in self.axes.items()}
        varied |= {f"points.{name}": column for name, column in columns.items()}
        starts: object = None
        if self.starts is not None and self.starts.listed:
            starts = [start if isinstance(start, str) else list(start) for start in self.starts]
        elif self.starts is not None:
            varied |= {f"starts.{name}": x for name, x in zip(self.starts.states, self.starts.vectors.T, strict=True)}
        fixed = {"scene": self.scene, **self.options, "dims": list(self.dims), "starts": starts}
        fixed |= {f"parameters.{name}": value for name, value in self.parameters.items()}
        fixed |= {name: _outline(column) for name, column in varied.items()}
        return fixed | {f"run.{name}": value for name, value in self.run.described().items()}

    def _sizes(self, dims: tuple[str, ...]) -> tuple[int, ...]:
        columns = [*(self.points or {}).values(), *(self.point_vectors or {}).values(), self.point_starts or ()]
        sizes = {name: len(axis) for name, axis in self.axes.items()}
        sizes |= {"point": len(columns[0]), "start": len(self.starts or ()), "direction": len(DIRECTIONS)}
        return tuple(sizes[name] for name in dims)

    def _start_of_point(self) -> np.ndarray:
        """Return the index into `starts` of each point."""
        index = {name: number for number, name in enumerate(self.start_names)}
        return np.array([index[name] for name in self.point_starts or ()], dtype=int)


def _outline(column: np.ndarray) -> object:
    """Return a column as JSON: its values if short, else its ends and checksum."""
    if column.size <= _MAX_LISTED:
        return column.tolist()
    if column.dtype.kind == "U":
        digest = hashlib.sha256("\n".join(column.tolist()).encode()).hexdigest()[:16]
        return f"{column.size} names, sha256 {digest}"
    digest = hashlib.sha256(np.ascontiguousarray(column).astype("<f8").tobytes()).hexdigest()[:16]
    return f"{column.size} values from {column[0]:g} to {column[-1]:g}, sha256 {digest}"

"""A sweep, read and checked: what is fixed, what varies, and the values of any lanes of it."""

import hashlib
from dataclasses import dataclass, field
from math import pi, prod
from typing import Any

import numpy as np

from vibrojax.models.physics.rock import ROCKS
from vibrojax.models.scenes import Scene
from vibrojax.sweep.input.run_settings import RunSettings
from vibrojax.sweep.input.starts import Starts

DIRECTIONS = ("up", "down")
"""The ways along an axis along which lanes are carried."""


@dataclass(frozen=True, eq=False)
class Sweep:
    """A sweep file's content, complete with defaults.

    - `name`: what its output is called; `text`: its TOML; `title`: free text; `file`: what messages call it.
    - `scene`: its name; `options`: the names of what is chosen in it, such as the friction law; `system`: itself.
    - `starts`: names, and vectors such as (x1, x1', x2, x2') [m, m/s]; None for a scene without.
    - `parameters`: all that is fixed, by name, SI; `given`: those of them that the user wrote.
    - `axes`: the grid, each of shape (values,), in the file's order, none where only the start varies; or
      `points`: columns of shape (points,), and
      `point_starts`: the name of each point's start, where the list has it, or `point_vectors`: the states that each
      starts from, by the names of their columns, each (points,), in the scene's order. There is then no other start.
    - `run`: how it is run.

    Where `rpm` and `bit_radius` stand for `v`, fixed ones are in `parameters` as `v`; if one of the two varies, `v` is
    in neither `parameters` nor `axes`, but in the values of the lanes.
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
        """Names of the dimensions: the axes or "point", if any, then "start" where there are several each."""
        listed = self.points is not None or self.point_starts is not None or self.point_vectors is not None
        each = ("direction",) if self.run.carry is not None else ("start",) if self.crosses_starts else ()
        return (*self.axes, *(("point",) if listed else ()), *each)

    @property
    def shape(self) -> tuple[int, ...]:
        """Sizes of the dimensions."""
        return self._sizes(self.dims)

    @property
    def counted(self) -> tuple[str, ...]:
        """The dimensions in the order in which lanes are counted, row by row: as in `dims`, but one along which lanes
        are carried comes last."""
        return tuple(sorted(self.dims, key=lambda name: name == self.run.carry))

    def over_dims(self, lanes: np.ndarray) -> np.ndarray:
        """What is known of all lanes, (lanes, ...), over the dimensions, `(*shape, ...)`."""
        grid = lanes.reshape(*self._sizes(self.counted), *lanes.shape[1:])
        order = [self.counted.index(name) for name in self.dims]
        return grid.transpose(*order, *range(len(order), grid.ndim))

    def _sizes(self, dims: tuple[str, ...]) -> tuple[int, ...]:
        sizes = {name: len(axis) for name, axis in self.axes.items()}
        sizes |= {"point": self._points, "start": len(self.starts or ()), "direction": len(DIRECTIONS)}
        return tuple(sizes[name] for name in dims)

    @property
    def lanes(self) -> int:
        """How many lanes there are, by Python's integers, which do not overflow."""
        return prod(self.shape)

    @property
    def crosses_starts(self) -> bool:
        """Whether every point runs from each of the starts."""
        return self.starts is not None and self.point_starts is None and self.run.carry is None

    @property
    def _points(self) -> int:
        columns = [len(column) for column in {**(self.points or {}), **(self.point_vectors or {})}.values()]
        return columns[0] if columns else len(self.point_starts or ())

    @property
    def _start_of_point(self) -> np.ndarray:
        """Index into `starts` of each point."""
        index = {name: number for number, name in enumerate(self.start_names)}
        return np.array([index[name] for name in self.point_starts or ()], dtype=int)

    def lane_values(self, first: int, end: int) -> tuple[dict[str, np.ndarray], np.ndarray]:
        """All of the scene's parameters, and the index into `starts`, of the lanes from `first` to before `end`.

        Lanes are counted in row-major order over `counted`. Returns float64 arrays of shape (end - first,) by name, and
        an integer array of that shape (zeros for a scene without starts). Memory grows with end - first only.
        """
        return self.values_of(np.arange(first, end))

    def values_of(self, numbers: np.ndarray) -> tuple[dict[str, np.ndarray], np.ndarray]:
        """The same of any lanes, by their numbers (lanes,)."""
        places = np.unravel_index(numbers, self._sizes(self.counted))
        indices = dict(zip(self.counted, places, strict=True))
        lanes = len(numbers)
        varied = {name: axis[indices[name]] for name, axis in self.axes.items()}
        if self.points is not None:
            varied |= {name: column[indices["point"]] for name, column in self.points.items()}
        if "rock" in varied:
            varied |= rock_values(varied.pop("rock"))
        values = with_drive_speed(self.parameters | varied)
        values = {name: np.broadcast_to(values[name], lanes).astype(float) for name in self.system.parameters()}
        if self.point_starts is not None:
            return values, self._start_of_point[indices["point"]]
        return values, np.asarray(indices["start"] if self.crosses_starts else np.zeros(lanes, int))

    @property
    def start_names(self) -> tuple[str, ...]:
        """The starts that have names."""
        return self.starts.names if self.starts is not None else ()

    def lane_starts(self, first: int, end: int) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
        """(index into `start_names`, their number for a start without a name; the states that such a one starts from)
        of the lanes from `first` to before `end`, each (end - first,); no states where all starts have names."""
        start = self.lane_values(first, end)[1]
        if self.point_vectors is not None:
            return start, tuple(column[first:end] for column in self.point_vectors.values())
        if self.starts is None or not self.starts.has_vectors:
            return start, ()
        # Where a start has a name, its states are not asked for.
        return self.starts.number[start], tuple(np.nan_to_num(self.starts.vectors[start]).T)

    def identity(self) -> dict[str, object]:
        """What the results depend on, as flat JSON values: equal for two sweeps that compute the same lanes.

        Long columns stand in it by their checksum. The chunk, the title and the wording of the file are no part of it.
        """
        varied = {f"grid.{name}": axis for name, axis in self.axes.items()}
        varied |= {f"points.{name}": column for name, column in (self.points or {}).items()}
        varied |= {f"points.{name}": column for name, column in (self.point_vectors or {}).items()}
        if self.point_starts is not None:
            varied["points.start"] = self._start_of_point
        run = {f"run.{name}": value for name, value in self.run.described().items()}
        parameters = {f"parameters.{name}": value for name, value in self.parameters.items()}
        starts: object = None
        if self.starts is not None and self.starts.listed:
            starts = [start if isinstance(start, str) else list(start) for start in self.starts]
        elif self.starts is not None:
            varied |= {f"starts.{name}": x for name, x in zip(self.starts.states, self.starts.vectors.T, strict=True)}
        fixed = {"scene": self.scene, **self.options, "dims": list(self.dims), "starts": starts}
        return fixed | parameters | {name: _outline(column) for name, column in varied.items()} | run


def rock_values(name: str | np.ndarray) -> dict[str, Any]:
    """threshold [N] and k3 [N/m] of a rock of Table 4.5, or of an array of their names."""
    if isinstance(name, str):
        return {"threshold": ROCKS[name].threshold, "k3": ROCKS[name].k3}
    rocks = [ROCKS[one] for one in name]
    return {"threshold": np.array([rock.threshold for rock in rocks]), "k3": np.array([rock.k3 for rock in rocks])}


def with_drive_speed(values: dict) -> dict:
    """`values` with v = 2 pi rpm/60 bit_radius [m/s] in place of rpm and bit_radius, where it has them."""
    if "rpm" not in values or "bit_radius" not in values:
        return values
    rest = {name: value for name, value in values.items() if name not in ("rpm", "bit_radius")}
    return rest | {"v": 2 * pi / 60 * values["rpm"] * values["bit_radius"]}


def _outline(column: np.ndarray) -> object:
    """A column as JSON: itself where short, else its ends and checksum."""
    if column.size <= 8:
        return column.tolist()
    if column.dtype.kind == "U":
        digest = hashlib.sha256("\n".join(column.tolist()).encode()).hexdigest()[:16]
        return f"{column.size} names, sha256 {digest}"
    digest = hashlib.sha256(np.ascontiguousarray(column).astype("<f8").tobytes()).hexdigest()[:16]
    return f"{column.size} values from {column[0]:g} to {column[-1]:g}, sha256 {digest}"

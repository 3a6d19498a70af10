"""All stable single impacts of a plane: from those that lanes settle on to every point that they can be followed to."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from vibrojax.analyses.borders.edges import Edges, Followed, followed
from vibrojax.models.scenes import Scene

SAME = 1e-4
"""Distance over the scales within which two orbits at one point are the same."""

MOST_PER_POINT = 6
"""Stable single impacts at one point."""

Cell = tuple[int, int, int]
"""A point: number of its plane, and of its values along the plane's two axes."""

Step = tuple[int, int]
"""To a neighbour: which axis of the plane, and which way."""

STEPS: tuple[Step, ...] = ((0, 1), (0, -1), (1, 1), (1, -1))


class Planes(NamedTuple):
    """Planes of a sweep: the names and values of their two axes, and all `parameters` by name (planes, xs, ys)."""

    names: tuple[str, str]
    values: tuple[np.ndarray, np.ndarray]
    parameters: Mapping[str, Float[np.ndarray, "planes xs ys"]]

    @property
    def shape(self) -> tuple[int, int, int]:
        """Numbers of planes, and of points along the two axes."""
        planes, xs, ys = next(iter(self.parameters.values())).shape
        return planes, xs, ys

    def neighbour(self, cell: Cell, step: Step) -> Cell | None:
        """The next point along an axis; None at the plane's edge."""
        at = list(cell)
        at[1 + step[0]] += step[1]
        return (at[0], at[1], at[2]) if 0 <= at[1 + step[0]] < self.shape[1 + step[0]] else None

    def value(self, cell: Cell, axis: int) -> float:
        """Where a point lies along an axis."""
        return float(self.values[axis][cell[1 + axis]])


class Loss(NamedTuple):
    """Where an orbit ceases to be a stable single impact on an edge: the `kind` as a flag, the `value` on its axis."""

    kind: int
    value: float


@dataclass
class Orbits:
    """Stable single impacts: where each is, its state and scales; at which point which are; what they lead to by each
    of `STEPS`: another's number, or a `Loss`."""

    cells: list[Cell] = field(default_factory=list)
    states: list[np.ndarray] = field(default_factory=list)
    scales: list[np.ndarray] = field(default_factory=list)
    at: dict[Cell, list[int]] = field(default_factory=dict)
    leads: list[dict[Step, int | Loss]] = field(default_factory=list)

    def known(self, cell: Cell, state: np.ndarray) -> int | None:
        """The number of an orbit at a point; None where there is none such."""
        for number in self.at.get(cell, ()):
            if np.abs((self.states[number] - state) / self.scales[number]).max() < SAME:
                return number
        return None

    def add(self, cell: Cell, state: np.ndarray, scale: np.ndarray) -> int:
        """Enter an orbit."""
        number = len(self.cells)
        self.cells.append(cell)
        self.states.append(state)
        self.scales.append(scale)
        self.leads.append({})
        self.at.setdefault(cell, []).append(number)
        return number


def spread(scene: Scene[Any], planes: Planes, orbits: Orbits, most_steps: float) -> None:
    """Follow all orbits to all neighbours, and those that are found there, until none is new."""
    front = list(range(len(orbits.cells)))
    while front:
        new: list[int] = []
        for axis in (0, 1):
            asked = [
                (number, step)
                for number in front
                for step in STEPS
                if step[0] == axis and step not in orbits.leads[number] and planes.neighbour(orbits.cells[number], step)
            ]
            if asked:
                edges = _edges(planes, orbits, asked, axis)
                new += _enter(planes, orbits, asked, followed(scene, planes.names[axis], edges, most_steps))
        front = new


def _edges(planes: Planes, orbits: Orbits, asked: list[tuple[int, Step]], axis: int) -> Edges:
    numbers = [number for number, _ in asked]
    cells = np.array([orbits.cells[number] for number in numbers])
    ends = [planes.neighbour(orbits.cells[number], step) for number, step in asked]
    return Edges(
        parameters={name: x[tuple(cells.T)] for name, x in planes.parameters.items()},
        begin=planes.values[axis][cells[:, 1 + axis]],
        end=planes.values[axis][np.array([end[1 + axis] for end in ends if end is not None])],
        states=np.array([orbits.states[number] for number in numbers]),
        scales=np.array([orbits.scales[number] for number in numbers]),
    )


def _enter(planes: Planes, orbits: Orbits, asked: list[tuple[int, Step]], found: Followed) -> list[int]:
    """Enter what was found; the orbits that are new."""
    new = []
    for k, (number, step) in enumerate(asked):
        if not found.reached[k]:
            orbits.leads[number][step] = Loss(int(found.kind[k]), float(found.value[k]))
            continue
        cell = planes.neighbour(orbits.cells[number], step)
        assert cell is not None
        other = orbits.known(cell, found.states[k])
        if other is None:
            if len(orbits.at.get(cell, ())) >= MOST_PER_POINT:
                continue
            other = orbits.add(cell, found.states[k], orbits.scales[number])
            new.append(other)
        orbits.leads[number][step] = other
        orbits.leads[other].setdefault((step[0], -step[1]), number)
    return new

"""Machines: one or several points of a scene, each from one start, as functions and commands of analyses take them."""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from vibrojax.errors import Place, shown
from vibrojax.lazy import jax
from vibrojax.maps.read import Point, read_point, read_sweep
from vibrojax.maps.sweep import Sweep
from vibrojax.settings.names import Names, read_names
from vibrojax.settings.run_settings import read_settings
from vibrojax.settings.values import UnusualValue, warn_if_far


@dataclass(frozen=True, eq=False)
class Machines:
    """Checked points of one scene.

    - `place`: where errors occur, the name of the analysis.
    - `first`: the first machine.
    - `sweep`: sweep with one lane for each machine; `several`: whether a list of them was given.
    """

    place: Place
    first: Point
    sweep: Sweep
    several: bool


def read_machines(
    place: Place,
    scene: object,
    parameters: Mapping[str, object],
    start: object = None,
    run: Mapping[str, object] | None = None,
    begin: Mapping[str, float] | None = None,
) -> Machines:
    """Validate one or several points of a scene.

    **Arguments:**

    - `scene`, `start`: as for [vibrojax.maps.read.read_point][]; `parameters`: the same, or sequences of equal length.
    - `run`: settings of the run; None stands for the default.
    - `begin`: validated values of parameters along which machines are changed, which become columns of the points.

    **Raises:** `InputError`.
    """
    several, fixed = several_and_single(parameters)
    begin, run = begin or {}, {name: value for name, value in (run or {}).items() if value is not None}
    names = read_names(place.at("scene"), scene, dict(fixed), place)
    read_settings(place, run, names.system)
    number = _count(place, names, several)
    first = {name: column[0] for name, column in several.items()}
    with warnings.catch_warnings():  # all values are checked below
        warnings.simplefilter("ignore", UnusualValue)
        point = read_point(place, scene, {**fixed, **first, **begin}, start)
    for name, value in (fixed | several).items():
        if name in names.writable:
            warn_if_far(place.at(name), names.writable[name], value)
    columns = {name: [value] * number for name, value in begin.items()} | several
    several_given = bool(columns)
    if not columns and point.start is None:  # one lane without a start: its point is listed
        name = next(iter(point.parameters))
        columns, fixed = {name: [point.parameters[name]]}, {key: x for key, x in fixed.items() if key != name}
    tables: dict[str, Any] = {"scene": scene, "parameters": fixed, "unusual": True, "run": run}
    tables |= {"points": columns} if columns else {}
    if point.start is not None:
        tables["starts"] = [point.start if isinstance(point.start, str) else list(point.start)]
    return Machines(place, point, read_sweep(tables), several_given)


def several_and_single(parameters: Mapping[str, object]) -> tuple[dict[str, list[Any]], dict[str, object]]:
    """Split parameters into those with several values, returned as lists, and those with a single value."""
    several = {
        name: list(x)
        for name, x in parameters.items()
        if isinstance(x, (list, tuple)) or (isinstance(x, (np.ndarray, jax.Array)) and x.ndim > 0)
    }
    return several, {name: x for name, x in parameters.items() if name not in several}


def _count(place: Place, names: Names, several: Mapping[str, list[Any]]) -> int:
    """Check the values in which machines differ, and return the number of machines."""
    for name, column in several.items():
        if name in names.options:
            raise place.at(name).error(f"{shown(column)} is a list; it is chosen once for all")
        if not column:
            raise place.at(name).error("is empty; give a value")
        for index, value in enumerate(column):
            item = place.at(name).item(index)
            if name in names.presets:
                names.preset(item, name, value)
            else:
                names.quantity(item, name, value)
    sizes = {name: len(column) for name, column in several.items()}
    if len(set(sizes.values())) > 1:
        lengths = ", ".join(f"{name} {size}" for name, size in sizes.items())
        raise place.error(
            f"lists of different lengths ({lengths}); give one machine's values at the same place of each"
        )
    return next(iter(sizes.values()), 1)

"""Specification of families: initial parameter points, and the continuation parameter."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from vibrojax.errors import Place, shown, suggestion
from vibrojax.measures.ledger import MOST_CYCLES
from vibrojax.models.physics.parameters import not_negative, positive
from vibrojax.models.scenes import Scene
from vibrojax.sweep.input.definition import Sweep
from vibrojax.sweep.input.names import Names, read_names
from vibrojax.sweep.input.read import read_point, read_sweep, several_and_single
from vibrojax.sweep.input.values import UnusualValue, quantity, warn_if_far

SETTLE = not_negative("settle", 40.0, "s", "time for which motions settle", "settle")
OBSERVE = positive("observe", 8.0, "s", "time for which they are then observed", "observe")


@dataclass(frozen=True, eq=False)
class FamilySpec:
    """Families of one scene.

    - `sweep`: sweep with one initial parameter point for each family.
    - `along`: name of the continuation parameter; `low`, `high`: its bounds.
    - `cycles`: largest number of section crossings per period of doubled branches.
    """

    sweep: Sweep
    along: str
    low: float
    high: float
    cycles: int

    def identity(self) -> dict[str, object]:
        """Return all settings on which the result depends, as flat JSON values."""
        bounds = {"along": self.along, "from": self.low, "to": self.high, "cycles": self.cycles}
        return self.sweep.identity() | bounds


def read_asked(
    scene: str | Scene[Any],
    along: object,
    at: object,
    span: object,
    start: object,
    settle: object,
    observe: object,
    cycles: object,
    parameters: Mapping[str, object],
) -> FamilySpec:
    """Check the arguments of `follow` and return the specification.

    **Raises:** `InputError` with a one-line message at the first invalid argument.
    """
    place = Place("follow")
    several, fixed = several_and_single(parameters)
    names = read_names(place.at("scene"), scene, dict(fixed), place)
    if not isinstance(along, str) or along not in names.parameters:
        instead = suggestion(str(along), names.parameters)
        if along in names.writable:  # rpm or bit_radius
            instead = "v follows from rpm and bit_radius: give v, and follow along v"
        raise place.at("along").error(f"{shown(along)} is not a parameter of the scene; {instead}")
    if along in parameters:
        hint = f"say where it begins by at={shown(fixed.get(along, 'VALUE'))}"
        raise place.at(along).error(f"is the parameter of the continuation; {hint}")
    if isinstance(cycles, bool) or not isinstance(cycles, int) or not 1 <= cycles <= MOST_CYCLES:
        raise place.at("cycles").error(f"{shown(cycles)} is not a whole number from 1 to {MOST_CYCLES}")
    low, high = _bounds(place, names, along, span)
    begin = names.quantity(place.at("at"), along, at)
    if not low <= begin <= high:
        raise place.at("at").error(f"{begin:g} is not between from = {low:g} and to = {high:g}")
    times = {"settle": (settle, SETTLE), "observe": (observe, OBSERVE)}
    run = {name: quantity(place.at(name), value, parameter) for name, (value, parameter) in times.items()}
    families = _count_families(place, names, several)
    first = {name: column[0] for name, column in several.items()}
    with warnings.catch_warnings():  # all values are checked below
        warnings.simplefilter("ignore", UnusualValue)
        point = read_point(place, scene, {**fixed, **first, along: begin}, start)
    for name, value in {**fixed, **several, along: begin}.items():
        if name in names.writable:
            warn_if_far(place.at("at" if name == along else name), names.writable[name], value)
    tables: dict[str, Any] = {
        "scene": scene,
        "points": {along: [begin] * families} | several,
        "parameters": fixed,
        "run": {"orbits": True, **run},
        "unusual": True,
    }
    if point.start is not None:
        tables["starts"] = [point.start if isinstance(point.start, str) else list(point.start)]
    return FamilySpec(read_sweep(tables), along, low, high, cycles)


def _bounds(place: Place, names: Names, along: str, span: object) -> tuple[float, float]:
    """Return the lower and the upper bound of the parameter."""
    if not isinstance(span, Sequence | np.ndarray) or isinstance(span, str) or len(span) != 2:
        raise place.at("span").error(f"{shown(span)} is not a pair of numbers; give the bounds of {along}")
    ends = zip(("from", "to"), span, strict=True)
    low, high = sorted(names.quantity(place.at(name), along, end) for name, end in ends)
    if not low < high:
        raise place.at("to").error(f"{high:g} is the same as from; give the two bounds of {along}")
    return low, high


def _count_families(place: Place, names: Names, several: Mapping[str, list[Any]]) -> int:
    """Check the values that differ between families, and return the number of families."""
    for name, column in several.items():
        if name in names.options:
            raise place.at(name).error(f"{shown(column)} is a list; it is chosen once for all families")
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
        raise place.error(f"lists of different lengths ({lengths}); give one family's values at the same place of each")
    return next(iter(sizes.values()), 1)

"""What pushes are asked for: whose working cycles, in which states, and how fine."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from vibrojax.errors import Place, shown, suggestion
from vibrojax.models.physics.parameters import positive
from vibrojax.models.scenes import Scene
from vibrojax.sweep.input.definition import Sweep
from vibrojax.sweep.input.point import read_point, several_and_single
from vibrojax.sweep.input.read import read_sweep
from vibrojax.sweep.input.values import quantity

SCAN, PRECISION = 256, 1e-3
"""Pushes of a scan; and the width of the bracket in the end, over the push."""


@dataclass(frozen=True, eq=False)
class PushAsked:
    """Whose working cycles are pushed: `sweep`, of one motion each; `columns`: what differs between them, by name; and
    as `smallest_push` takes them, `most`, `scan` and `precision`."""

    sweep: Sweep
    tables: dict[str, Any]
    columns: dict[str, list[Any]]
    most: dict[str, float]
    scan: int
    precision: float

    def identity(self) -> dict[str, object]:
        """What the result depends on, as flat JSON values."""
        own = {"scan": self.scan, "precision": self.precision, **{f"most_{name}": x for name, x in self.most.items()}}
        return self.sweep.identity() | own


def read_pushed(
    scene: str | Scene[Any],
    start: object,
    most: object,
    scan: object,
    precision: object,
    settle: object,
    observe: object,
    parameters: Mapping[str, Any],
) -> PushAsked:
    """What is asked for, checked; raises `InputError`, one line, at the first thing that is wrong."""
    place = Place("smallest_push")
    columns, fixed = several_and_single(parameters)
    for name, column in columns.items():
        if not column:
            raise place.at(name).error("is empty; give a value")
    point = read_point(place, scene, fixed | {name: column[0] for name, column in columns.items()}, start)
    system = point.system
    lacking = [name for name in system.driving_part().return_states if name not in system.start_states]
    if system.driving_part().section is None or lacking or point.start is None:
        what = f"{', '.join(lacking)} of it cannot be given as a start" if lacking else "it has no drill"
        raise place.at("scene").error(f"{shown(point.scene)} has no working cycle to push: {what}")
    if isinstance(scan, bool) or not isinstance(scan, int) or not 2 <= scan <= 10_000:
        raise place.at("scan").error(f"{shown(scan)} is not a whole number from 2 to 10000")
    within = quantity(place.at("precision"), precision, positive("precision", PRECISION, "1", "precision", "precision"))
    bounds = {}
    for name, value in dict(most if isinstance(most, Mapping) else {}).items():
        if name not in system.start_states:
            raise place.at("most").error(
                f"{shown(name)} is no state of a start; {suggestion(name, system.start_states)}"
            )
        about = positive(name, 1.0, "1", "greatest push", name)
        bounds[name] = quantity(place.at("most").at(name), value, about)
    if most is not None and not isinstance(most, Mapping):
        raise place.at("most").error(f"{shown(most)} is no table; give one like {{'v2': 3.0}}")
    tables: dict[str, Any] = {
        "scene": scene,
        "parameters": fixed,
        "run": {"orbits": True, "settle": settle, "observe": observe},
        "unusual": True,
    }
    start_item = point.start if isinstance(point.start, str) else list(point.start)
    asked = {"starts": [start_item]} | ({"points": columns} if columns else {})
    return PushAsked(read_sweep(tables | asked), tables, columns, bounds, scan, within)

"""Specification of a search for smallest pushes: working cycles, largest pushes, and resolution."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from vibrojax.errors import Place, shown, suggestion
from vibrojax.maps.read import read_point, read_sweep, several_and_single
from vibrojax.maps.sweep import Sweep
from vibrojax.physics.parameters import positive
from vibrojax.scenes import Scene
from vibrojax.settings.values import quantity

SCAN, PRECISION = 256, 1e-3
"""Default number of pushes per scan, and default relative width of the final bracket."""


@dataclass(frozen=True, eq=False)
class PushSpec:
    """A checked specification.

    - `sweep`: sweep with one lane per working cycle.
    - `columns`: parameter values of its points, by parameter name.
    - `most`, `scan`, `precision`: as in `smallest_push`.
    """

    sweep: Sweep
    columns: dict[str, list[Any]]
    most: dict[str, float]
    scan: int
    precision: float

    def identity(self) -> dict[str, object]:
        own = {"scan": self.scan, "precision": self.precision, **{f"most_{name}": x for name, x in self.most.items()}}
        return self.sweep.identity() | own


def push_spec(
    scene: str | Scene[Any],
    start: object,
    most: object,
    scan: object,
    precision: object,
    settle: object,
    observe: object,
    parameters: Mapping[str, Any],
) -> PushSpec:
    """Return the checked specification; raise `InputError` with a one-line message at the first error."""
    place = Place("push")
    columns, fixed = several_and_single(parameters)
    for name, column in columns.items():
        if not column:
            raise place.at(name).error("is empty; give a value")
    point = read_point(place, scene, fixed | {name: column[0] for name, column in columns.items()}, start)
    system = point.system
    missing = [name for name in system.driving_part().return_states if name not in system.start_states]
    if system.driving_part().section is None or missing or point.start is None:
        why = f"{', '.join(missing)} of it cannot be given as a start" if missing else "it has no drill"
        raise place.at("scene").error(f"{shown(point.scene)} has no working cycle to push: {why}")
    if isinstance(scan, bool) or not isinstance(scan, int) or not 2 <= scan <= 10_000:
        raise place.at("scan").error(f"{shown(scan)} is not a whole number from 2 to 10000")
    width = quantity(place.at("precision"), precision, positive("precision", PRECISION, "1", "precision", "precision"))
    if most is not None and not isinstance(most, Mapping):
        raise place.at("most").error(f"{shown(most)} is not a table; give one like {{'v2': 3.0}}")
    bounds = {}
    for name, value in (most or {}).items():
        if name not in system.start_states:
            hint = suggestion(name, system.start_states)
            raise place.at("most").error(f"{shown(name)} is no state of a start; {hint}")
        bounds[name] = quantity(place.at("most").at(name), value, positive(name, 1.0, "1", "greatest push", name))
    times = {name: x for name, x in (("settle", settle), ("observe", observe)) if x is not None}
    run = {"settle": system.usual_times[0], "orbits": True, **times}
    tables: dict[str, Any] = {"scene": scene, "parameters": fixed, "run": run, "unusual": True}
    starts = [point.start if isinstance(point.start, str) else list(point.start)]
    sweep = read_sweep(tables | {"starts": starts} | ({"points": columns} if columns else {}))
    return PushSpec(sweep, columns, bounds, scan, width)

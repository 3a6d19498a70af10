"""One point of a scene, with the same validation as sweep files."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from vibrojax.errors import Place, shown
from vibrojax.models.scenes import Scene
from vibrojax.sweep.input.names import check_substitutes, read_names, take_options, with_substitutes
from vibrojax.sweep.input.plausible import warn_if_far
from vibrojax.sweep.input.read import read_parameters
from vibrojax.sweep.input.source import plain, plain_table
from vibrojax.sweep.input.starts import Start


@dataclass(frozen=True)
class Point:
    """One point of a scene.

    - `scene`: name of the scene. `system`: the scene itself.
    - `options`: names of the scene's options.
    - `start`: initial condition.
    - `parameters`: all parameters by name, in SI units.
    """

    scene: str
    options: dict[str, str]
    start: Start | None
    parameters: dict[str, float]
    system: Scene[Any]


def read_point(place: Place, scene: object, parameters: Mapping[str, object], start: object = None) -> Point:
    """Validate one point and complete it with defaults.

    **Arguments:**

    - `place`: place that error messages report as the file.
    - `scene`: name of a scene, or a scene.
    - `parameters`: parameters by name. `friction` is a law or the name of a law, `pulse_shape` the name of a shape.
      `rpm` and `bit_radius` may replace `v`, and `rock` may replace `threshold` and `k3`.
    - `start`: initial condition, a name or a vector [x1, x1', x2, x2'] [m, m/s]; None for the first of the scene.

    **Raises:** `InputError`.
    """
    table = dict(parameters)
    options = take_options(table)
    table = plain_table(place, table)
    names = read_names(place.at("scene"), scene, options, place)
    fixed = read_parameters(place, table, names)
    if start is None:
        start = names.starts[0] if names.starts else None
    elif not names.has_starts:
        raise place.at("start").error(f"scene {shown(names.scene)} has no starts; leave it out")
    else:
        start = names.start(place.at("start"), plain(place.at("start"), start))
    check_substitutes({name: place.at(name) for name in table})
    for name, value in fixed.items():
        if name in table:
            warn_if_far(place.at(name), names.writable[name], value)
    defaults = {name: parameter.default for name, parameter in names.parameters.items()}
    return Point(names.scene, dict(names.options), start, defaults | with_substitutes(fixed), names.system)


def several_and_single(parameters: Mapping[str, object]) -> tuple[dict[str, list[Any]], dict[str, object]]:
    """Split parameters into those with several values, returned as lists, and those with a single value."""
    several = {
        name: list(x)
        for name, x in parameters.items()
        if isinstance(x, (list, tuple)) or (isinstance(x, np.ndarray) and x.ndim > 0)
    }
    return several, {name: x for name, x in parameters.items() if name not in several}

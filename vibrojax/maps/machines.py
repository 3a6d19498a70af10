"""Machines: one or several points of a scene, each from one start, as functions and commands of analyses take them."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from vibrojax.errors import Place, shown
from vibrojax.maps.read import check_run, completed, read_parameters, read_start
from vibrojax.maps.starts import list_of
from vibrojax.maps.sweep import Sweep
from vibrojax.settings.names import read_names
from vibrojax.settings.run_settings import read_settings
from vibrojax.settings.toml import plain_table
from vibrojax.settings.values import warn_if_far


@dataclass(frozen=True, eq=False)
class Machines:
    """Checked points of one scene.

    - `place`: where errors occur, the name of the analysis.
    - `sweep`: sweep with one lane for each machine; `several`: whether a list of them was given.
    """

    place: Place
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
    lists, single = several_and_single(parameters)
    names = read_names(place.at("scene"), scene, single, place)
    settings = read_settings(place, {name: x for name, x in (run or {}).items() if x is not None}, names.system)
    columns = dict[str, np.ndarray]()
    for name, values in plain_table(place, lists, lambda: names.units).items():
        here = place.at(name)
        assert isinstance(values, list)
        if name in names.options:
            raise here.error(f"{shown(values)} is a list; it is chosen once for all")
        if not values:
            raise here.error("is empty; give a value")
        read = names.preset if name in names.presets else names.quantity
        columns[name] = np.array([read(here.item(index), name, value) for index, value in enumerate(values)])
    sizes = {name: len(column) for name, column in columns.items()}
    if len(set(sizes.values())) > 1:
        lengths = ", ".join(f"{name} {size}" for name, size in sizes.items())
        advice = "give one machine's values at the same place of each"
        raise place.error(f"lists of different lengths ({lengths}); {advice}")
    number = next(iter(sizes.values()), 1)
    fixed = read_parameters(place, plain_table(place, single, lambda: names.units), names)
    columns = {name: np.full(number, value) for name, value in (begin or {}).items()} | columns
    names.check_substitutes({name: place.at(name) for name in (*single, *columns)})
    for name, value in (fixed | columns).items():
        if name in parameters and name in names.writable:
            warn_if_far(place.at(name), names.writable[name], value)
    begun, several = read_start(place.at("start"), start, names), bool(columns)
    if not columns and begun is None:  # one lane without a start: its point is listed
        name = next(iter(names.parameters))
        columns = {name: np.array([completed(names, fixed)[name]])}
        fixed.pop(name, None)
    sweep = Sweep(
        name=place.file,
        text="",
        title="",
        scene=names.scene,
        options=dict(names.options),
        system=names.system,
        starts=None if begun is None else list_of([begun], names.system.start_states),
        parameters=completed(names, fixed, columns),
        given=fixed,
        points=columns or None,
        run=settings,
        file=place.file,
    )
    check_run(place, sweep)
    return Machines(place, sweep, several)


def several_and_single(parameters: Mapping[str, object]) -> tuple[dict[str, Any], dict[str, object]]:
    """Split parameters into those with several values, a sequence or an array of any library, and the others."""
    several = {name: x for name, x in parameters.items() if isinstance(x, (list, tuple)) or getattr(x, "ndim", 0) > 0}
    return several, {name: x for name, x in parameters.items() if name not in several}

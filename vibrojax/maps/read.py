"""Reading and validation of a sweep from a file, a bundled name or a dict, and of a single point of a scene."""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from os import PathLike
from typing import Any

import numpy as np

from vibrojax.errors import Place, shown, suggestion
from vibrojax.maps.starts import Start, Starts, read_points, read_starts
from vibrojax.maps.sweep import Sweep, with_substitutes
from vibrojax.measures.labels import HOLE_RADIUS
from vibrojax.scenes import SCENES, HasRock, Scene
from vibrojax.settings.names import Names, read_names
from vibrojax.settings.run_settings import RunSettings, read_settings
from vibrojax.settings.toml import TABLES, Source, plain, plain_table, read_source, with_changes
from vibrojax.settings.values import TOP_KEYS, as_table, check_distinct, flag, read_axis, warn_if_far

_KEYS = (*TOP_KEYS, *TABLES, "points")

SWEEP_MAX_LANES = 2**62
"""Maximum number of lanes of a sweep, which are numbered by 64-bit integers."""


def read_sweep(source: str | PathLike[str] | Mapping[str, object], changes: Iterable[str] = ()) -> Sweep:
    """Read and validate a sweep, and complete it with defaults.

    **Arguments:**

    - `source`: path of a TOML file, name of a bundled sweep, or dict with the same structure as a file.
    - `changes`: strings NAME=VALUE that override values in the sweep; see [vibrojax.settings.toml.with_changes][].

    **Raises:** `InputError` with a one-line message about the first problem in the sweep.

    **Example:**

    >>> sweep = vj.read_sweep("regime-map", ["run.error=1e-6", "v=2.0"])
    >>> sweep.lanes, sweep.run.error
    (8280, 1e-06)
    """
    origin = read_source(source)
    if words := tuple(changes):
        origin = with_changes(origin, words)
    return sweep_of(origin)


def sweep_of(origin: Source, table_of_points: str = "points") -> Sweep:
    """Return the sweep with these tables, validated and completed; messages about points name `table_of_points`."""
    place, tables = Place(origin.file), origin.tables
    _check_top(place, tables)
    in_parameters = place.at("parameters")
    table = dict(as_table(in_parameters, tables.get("parameters", {})))
    names = read_names(place.at("scene"), tables["scene"], table, in_parameters)
    fixed = read_parameters(in_parameters, table, names)
    axes, points, own = _read_varied(place, origin, names, table_of_points)
    varied = axes if points is None else points
    varying = place.at("grid" if points is None else table_of_points)
    places = {name: in_parameters.at(name) for name in table} | {name: varying.at(name) for name in varied}
    names.check_substitutes(places)
    for name in varied:
        if name in table:
            raise varying.at(name).error("is in [parameters] as well; give it in one of the two")
    starts = read_starts(place.at("starts"), tables.get("starts"), names)
    title = tables.get("title", "")
    if not isinstance(title, str):
        raise place.at("title").error(f"{shown(title)} is not text; write it in quotes")
    sweep = Sweep(
        name=origin.name,
        text=origin.text,
        title=title,
        scene=names.scene,
        options=dict(names.options),
        system=names.system,
        starts=own or starts,
        parameters=completed(names, fixed, varied),
        given=fixed,
        axes=axes,
        points=points,
        own_starts=own is not None,
        run=read_settings(place.at("run"), as_table(place.at("run"), tables.get("run", {})), names.system),
        file=origin.file,
    )
    if sweep.lanes > SWEEP_MAX_LANES:
        raise place.at("grid").error(f"{shown(sweep.lanes)} lanes are too many; make the axes shorter")
    check_run(place.at("run"), sweep)
    if not flag(place.at("unusual"), tables.get("unusual", False)):
        for name, value in {**fixed, **varied}.items():
            if name not in names.presets:
                home = places.get(name, in_parameters.at(name))
                warn_if_far(home, names.writable[name], value, meant="; unusual = true says that it is meant")
    return sweep


def read_parameters(place: Place, table: dict[str, object], names: Names) -> dict[str, float]:
    """Return the validated numbers of the table [parameters], which is at `place`."""
    presets = {name: table[name] for name in names.presets if name in table}
    table = {name: value for name, value in table.items() if name not in presets}
    set_by_presets: dict[str, float] = {}
    for name, value in presets.items():
        set_by_presets |= names.presets[name][names.preset(place.at(name), name, value)]
    for name, value in table.items():
        names.parameter(place.at(name), name)
        if isinstance(value, (list, dict)):
            raise place.at(name).error(f"{shown(value)} is not a number; what varies belongs in [grid]")
    return {name: names.quantity(place.at(name), name, value) for name, value in table.items()} | set_by_presets


def completed(names: Names, fixed: dict[str, float], varied: Collection[str] = ()) -> dict[str, Any]:
    """Return all parameters that do not vary: those in `fixed`, and the defaults of those that nothing else defines."""
    absent = {*varied} | names.substituted({*fixed, *varied})
    defaults = {name: parameter.default for name, parameter in names.parameters.items() if name not in absent}
    return with_substitutes(names.system, defaults | fixed)


def _check_top(place: Place, tables: dict[str, object]) -> None:
    """Raise if a key does not belong at the top level of the file, or if the scene is missing."""
    for key in tables:
        if key in _KEYS:
            continue
        if key in RunSettings.__dataclass_fields__:
            raise place.at(key).error("unknown key at the top; it belongs in [run]")
        scene = tables.get("scene")
        names = read_names(place.at("scene"), scene) if scene is not None else None
        if any(key in kind.choices for kind in SCENES.values()) or (names and key in names.writable):
            raise place.at(key).error("unknown key at the top; it belongs in [parameters]")
        raise place.at(key).error(f"unknown key; {suggestion(key, _KEYS)}")
    if "scene" not in tables:
        raise place.at("scene").error('missing; write the scene\'s name, like scene = "vibro-impact"')


def _read_varied(
    place: Place, origin: Source, names: Names, table_of_points: str
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray] | None, Starts | None]:
    """Return the axes of the grid, or the points with their starts, see `read_points`. The others are empty or None."""
    tables = origin.tables
    if "points" in tables and "grid" in tables:
        raise place.at("points").error(f"{shown(tables['points'])} beside [grid]; give one of them")
    if "points" in tables:
        return {}, *read_points(place.at(table_of_points), tables["points"], origin.folder, names)
    place = place.at("grid")
    grid = as_table(place, tables.get("grid", {}))
    if not grid and ("grid" in tables or "starts" not in tables or not names.has_starts):
        problem = "empty" if "grid" in tables else "missing"
        raise place.error(f"{problem}, so there is nothing to sweep; add an axis like beta = [0.3, 0.4]")
    axes = {}
    for name, value in grid.items():
        if name in names.presets:
            here = place.at(name)
            if not isinstance(value, list) or not value:
                first, *_, last = names.presets[name]
                raise here.error(f'{shown(value)} is not a list of {name}s; write one like ["{first}", "{last}"]')
            chosen = [names.preset(here.item(index), name, item) for index, item in enumerate(value)]
            check_distinct(here, chosen, name)
            axes[name] = np.array(chosen)
        else:
            axes[name] = read_axis(place.at(name), value, names.parameter(place.at(name), name))
    return axes, None, None


def check_run(place: Place, sweep: Sweep) -> None:
    """Raise if a setting does not apply to the scene, or if continuation along the axis `carry` is impossible."""
    if sweep.run.carry is not None:
        name, place_of_carry = sweep.run.carry, place.at("carry")
        if name not in sweep.axes:
            raise place_of_carry.error(f"{shown(name)} is not an axis of [grid]; {suggestion(name, sweep.axes)}")
        axis = sweep.axes[name]
        if axis.dtype.kind != "f" or len(axis) < 2 or np.any(np.diff(axis) <= 0):
            raise place_of_carry.error(
                f"the values of {name} do not rise, so there is no up and down; write two or more that do"
            )
        if sweep.starts is not None and len(sweep.starts) != 1:
            raise place_of_carry.error(
                f"{len(sweep.starts)} starts; the first lane in each direction has one: "
                f"write starts = {shown([sweep.starts[0]])}"
            )
    useless = f"true has no use in {sweep.scene}"
    if sweep.run.orbits and not sweep.system.driving_part().return_states:
        raise place.at("orbits").error(f"{useless} without a section or pulses to return to; leave it out")
    if sweep.run.lyapunov and sweep.system.section is None:
        raise place.at("lyapunov").error(f"{useless}, which has no section to return to; leave it out")


def read_start(place: Place, value: object, names: Names) -> Start | None:
    """Return the initial condition of one point, by default the first of the scene; None if it has none."""
    if value is None:
        return names.starts[0] if names.starts else None
    if not names.has_starts:
        raise place.error(f"scene {shown(names.scene)} has no starts; leave it out")
    return names.start(place, plain(place, value, lambda: names.units))


@dataclass(frozen=True)
class Point:
    """One point of a scene.

    - `scene`: name of the scene. `system`: the scene itself.
    - `options`: names of the scene's options.
    - `start`: initial condition.
    - `parameters`: all parameters by name, in SI units. `hole_radius` [m]: the radius that is given, or the default.
    """

    scene: str
    options: dict[str, str]
    start: Start | None
    parameters: dict[str, float]
    system: Scene[Any]
    hole_radius: float = HOLE_RADIUS

    def identity(self) -> dict[str, object]:
        """Return everything that determines a motion of the point, but the code of the user's own scenes and laws."""
        known: dict[str, object] = {"scene": self.scene, **self.options, **self.parameters}
        known |= {} if self.start is None else {"start": self.start}
        return known | ({"bit_radius": self.hole_radius} if isinstance(self.system, HasRock) else {})


def read_point(
    place: Place, scene: object, parameters: Mapping[str, object], start: object = None, unusual: bool = False
) -> Point:
    """Validate one point and complete it with defaults.

    **Arguments:**

    - `place`: place that error messages report as the file.
    - `scene`: name of a scene, or a scene.
    - `parameters`: parameters by name. `friction` is a law or the name of a law, `pulse_shape` the name of a shape.
      `rpm` and `bit_radius` may replace `v`, `bit_frequency` `k1`, `striker_frequency` `gamma`, and `rock` may replace
      `threshold` and `k3`.
    - `start`: initial condition, a name or a vector [x1, x1', x2, x2'] [m, m/s]; None for the first of the scene.
    - `unusual`: whether values far from those of rigs are intended, and give no warning.

    **Raises:** `InputError`.
    """
    table = dict(parameters)
    names = read_names(place.at("scene"), scene, table, place)
    table = plain_table(place, table, lambda: names.units)
    fixed = read_parameters(place, table, names)
    start = read_start(place.at("start"), start, names)
    names.check_substitutes({name: place.at(name) for name in table})
    for name, value in fixed.items():
        if name in table and not unusual:
            warn_if_far(place.at(name), names.writable[name], value)
    values = completed(names, fixed)
    ordered = {name: values[name] for name in names.parameters}
    radius = fixed.get("bit_radius", HOLE_RADIUS)
    return Point(names.scene, dict(names.options), start, ordered, names.system, radius)

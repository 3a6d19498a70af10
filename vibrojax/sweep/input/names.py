"""Names that may be specified for a scene: parameters, options, initial conditions and installed plug-ins.

All scene-specific knowledge of this folder is at the top of this file: options, presets, the rotation that defines a
drive speed, and derived quantities that users may mistake for parameters.
"""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from math import pi
from typing import Any

import numpy as np

from vibrojax.errors import Place, shown, suggestion
from vibrojax.measures import GAUGES, Gauge
from vibrojax.models.physics.friction import FRICTION_LAWS, FrictionLaw
from vibrojax.models.physics.parameters import ROTATION, Parameter
from vibrojax.models.physics.rock import ROCKS
from vibrojax.models.scenes import SCENES, Scene, scene_named
from vibrojax.models.scenes.penetration import PULSE_SHAPES
from vibrojax.stepping import STEPPERS, Stepper
from vibrojax.sweep.input.run_settings import RunSettings
from vibrojax.sweep.input.values import STATE, choice, quantity

DEFAULT_STARTS = ("drive", "stuck")

CHOICES: dict[str, Mapping[str, object]] = {
    "friction": FRICTION_LAWS,
    "pulse_shape": {shape: shape for shape in PULSE_SHAPES},
}
"""Options, of which each has one value in a sweep, and their possible values by name."""

PRESETS: dict[str, dict[str, dict[str, float]]] = {
    "rock": {name: {"threshold": rock.threshold, "k3": rock.k3} for name, rock in ROCKS.items()}
}
"""Presets, names that each set several parameters. Unlike an option, a preset may vary within a sweep."""

PRESET_MEANINGS = {"rock": "rock of Table 4.5"}

_DERIVED = {
    "m2": ("beta", "m2 = beta m1; give beta"),
    "k2": ("gamma", "k2 = beta gamma^2 k1; give gamma"),
    "w1": ("k1", "w1 = sqrt(k1/m1); give k1"),
    "w2": ("gamma", "w2 = gamma w1; give gamma"),
    "D": ("threshold", "the rock's D is called threshold; give that"),
}
"""Quantities that are computed from a parameter: name of this parameter, and advice for a message."""

_LACKING = {"friction": "does not slide"}
"""Wording for a scene without an option, used in messages."""

_TOP_KEYS = ("scene", "title", "starts", "unusual", "points")


def rock_values(name: str | np.ndarray) -> dict[str, Any]:
    """Return threshold [N] and k3 [N/m] of a rock of Table 4.5 of the source, or of an array of rock names."""
    rocks = PRESETS["rock"]
    if isinstance(name, str):
        return dict(rocks[name])
    return {key: np.array([rocks[rock][key] for rock in name]) for key in ("threshold", "k3")}


def with_substitutes(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return `values` with presets and rotation replaced by the parameters that they define.

    A rotation defines v = 2 pi rpm/60 bit_radius [m/s].
    """
    values = dict(values)
    if "rock" in values:
        values |= rock_values(values.pop("rock"))
    if "rpm" in values and "bit_radius" in values:
        values["v"] = 2 * pi / 60 * values.pop("rpm") * values.pop("bit_radius")
    return values


def substituted(names: set[str]) -> set[str]:
    """Return the parameters that are defined by a preset or a rotation in `names`."""
    return ({"threshold", "k3"} if "rock" in names else set()) | ({"v"} if "rpm" in names else set())


def check_substitutes(places: Mapping[str, Place]) -> None:
    """Raise if a parameter is specified twice, or if one of rpm and bit_radius is missing.

    A rock defines threshold and k3; rpm and bit_radius together define v. `places`: place of each specified name in the
    file.
    """
    for name in ("threshold", "k3"):
        if "rock" in places and name in places:
            raise places["rock"].error(f"{name} is given as well; give the rock, or threshold and k3")
    rotation = [name for name in ("rpm", "bit_radius") if name in places]
    if rotation and "v" in places:
        raise places[rotation[0]].error("v is given as well; give v, or rpm with bit_radius")
    if len(rotation) == 1:
        missing = "bit_radius [m]" if rotation == ["rpm"] else "rpm [1/min]"
        raise places[rotation[0]].error(f"{missing} is missing; only both together give v: add it, or give v")


@dataclass(frozen=True)
class Names:
    """The names that may be specified for one scene.

    - `scene`: name of the scene. `system`: the scene itself.
    - `options`: name of the friction law or pulse shape, by option.
    - `parameters`: parameters by name.
    - `starts`: names of the initial conditions.
    """

    scene: str
    options: Mapping[str, str]
    parameters: Mapping[str, Parameter]
    starts: tuple[str, ...]
    system: Scene[Any]

    @property
    def friction(self) -> str | None:
        """Name of the friction law, or None for a scene without friction."""
        return self.options.get("friction")

    @property
    def has_starts(self) -> bool:
        """True if the scene accepts a choice of initial conditions."""
        return bool(self.starts or self.system.start_states)

    @property
    def has_rock(self) -> bool:
        """True if `rock` may be specified in place of `threshold` and `k3`."""
        return {"threshold", "k3"} <= set(self.parameters)

    def rock(self, place: Place, value: object) -> str:
        """Return `value` if it is the name of a rock of Table 4.5 of the source; raise otherwise."""
        return choice(place, value, tuple(PRESETS["rock"]))

    @property
    def writable(self) -> dict[str, Parameter]:
        """All names to which a number can be assigned: parameters, rpm and bit_radius."""
        return dict(self.parameters) | (ROTATION if "v" in self.parameters else {})

    def parameter(self, place: Place, name: str) -> Parameter:
        """Return the parameter called `name`, or raise at `place` if the scene has no such parameter."""
        if name not in self.writable:
            raise place.error(self._problem(name))
        return self.writable[name]

    def quantity(self, place: Place, name: str, value: object) -> float:
        """Return `value` as a number; raise if the parameter called `name` does not admit this value."""
        return quantity(place, value, self.parameter(place, name))

    def _problem(self, name: str) -> str:
        """Return a message that explains why `name` is not a parameter, with advice."""
        has = f"scene {shown(self.scene)} has no {name}; it has {', '.join(self.writable)}"
        if name in CHOICES:
            once = f"is chosen once for all lanes, in [parameters]; choose from {', '.join(CHOICES[name])}"
            return once if name in self.options else has
        for option, chosen in self.options.items():
            if owners := [other for other in CHOICES[option] if name in _parameters_with(self.scene, option, other)]:
                others = " or ".join(map(shown, owners))
                return f"{option} {shown(chosen)} has no {name}; it belongs to {option} = {others}"
        if any(name in kind().parameters() for kind in SCENES.values()):
            return has
        if name in _DERIVED and _DERIVED[name][0] in self.writable:
            return f"is not a parameter: {_DERIVED[name][1]}"
        if name in _TOP_KEYS or name in RunSettings.__dataclass_fields__:
            return f"is not a parameter; it belongs {'at the top of the file' if name in _TOP_KEYS else 'in [run]'}"
        return f"scene {shown(self.scene)} has no such parameter; {suggestion(name, self.writable)}"

    def start(self, place: Place, value: object) -> str | tuple[float, ...]:
        """Return a validated initial condition: a name, or a vector of states such as [x1, x1', x2, x2'] [m, m/s]."""
        if not isinstance(value, (list, tuple)):
            return self.named_start(place, value)
        states = self.system.start_states
        if len(value) != len(states):
            needed = f"{len(states)} are needed: [{', '.join(states)}]"
            raise place.error(f"{shown(value)} has {len(value)} numbers; {needed}")
        return tuple(quantity(place.item(index), item, STATE) for index, item in enumerate(value))

    def named_start(self, place: Place, value: object) -> str:
        """Return the validated name of an initial condition."""
        if isinstance(value, str) and value in self.starts:
            return value
        if isinstance(value, str) and any(value in getattr(kind, "starts", ()) for kind in SCENES.values()):
            allowed = ", ".join(self.starts)
            raise place.error(f"{shown(value)} is not a start of scene {shown(self.scene)}; choose from {allowed}")
        return choice(place, value, self.starts)


def _parameters_with(scene: str, option: str, value: str) -> Mapping[str, Parameter]:
    """Return the parameters of a friction law, or of a scene with another option set to `value`."""
    if option == "friction":
        return FRICTION_LAWS[value].parameters
    return scene_named(scene, **{option: value}).parameters()


def take_options(table: dict[str, object]) -> dict[str, object]:
    """Remove the options from `table` and return them."""
    return {name: table.pop(name) for name in CHOICES if name in table}


def read_names(
    place: Place, scene: object, chosen: Mapping[str, object] | None = None, options_place: Place | None = None
) -> Names:
    """Return the names of a scene with the options `chosen`; raise if the scene or an option does not exist.

    `place` and `options_place` locate scene and options in error messages. A scene or a friction law may be an object
    instead of a name.
    """
    enter_offered()
    system = scene if isinstance(scene, Scene) else scene_named(choice(place, scene, tuple(SCENES)))
    own: set[str] = {field.name for field in fields(system)} if is_dataclass(system) else set()
    options: dict[str, Any] = {name: getattr(system, name) for name in CHOICES if name in own}
    for option, value in (chosen or {}).items():
        here = (options_place or place).at(option)
        if option not in options:
            lacks = _LACKING.get(option, f"has no {option}")
            raise here.error(f"scene {shown(system.name)} {lacks}; leave it out")
        is_law = option == "friction" and isinstance(value, FrictionLaw)
        options[option] = value if is_law else CHOICES[option][choice(here, value, tuple(CHOICES[option]))]
    if chosen:
        system = replace(system, **options)  # type: ignore[type-var] # it has options, so it is a dataclass
    names = {option: str(getattr(value, "name", value)) for option, value in options.items()}
    return Names(system.name, names, dict(system.parameters()), system.starts, system)


_GROUPS: dict[str, tuple[dict[str, Any], type]] = {
    "vibrojax.friction_laws": (FRICTION_LAWS, FrictionLaw),
    "vibrojax.scenes": (SCENES, Scene),
    "vibrojax.steppers": (STEPPERS, Stepper),
    "vibrojax.gauges": (GAUGES, Gauge),
}
"""Groups of entry points. For each group: the registry of the objects, and their required type. Scenes are registered
as classes, not as instances."""


@cache
def enter_offered() -> None:
    """Register the plug-ins of installed packages by name, once per process.

    A package declares, for example, `[project.entry-points."vibrojax.friction_laws"]` with `mine = "its_module:LAW"`.
    Friction laws, scenes and steppers are registered under their own name, gauges under the name of the entry point. An
    unusable object is skipped with a one-line warning, so that a broken package does not affect anything else.

    This function is called when names are read, not on import, because the packages import this one.
    """
    for group, (table, kind) in _GROUPS.items():
        for entry in entry_points(group=group):
            problem = _enter(entry, table, kind)
            if problem is not None:
                owner = entry.dist.name if entry.dist is not None else "a package"
                warnings.warn(f"{owner}: {group}: {entry.name}: {problem}; it is left out", stacklevel=2)


def _enter(entry: EntryPoint, table: dict[str, Any], kind: type) -> str | None:
    """Register one object; return a description of its problem, or None if it has been registered."""
    try:
        offered = entry.load()
    except Exception as error:  # the package's code may raise any exception
        return " ".join(f"{entry.value} cannot be imported ({error})".split())
    is_subclass = isinstance(offered, type) and issubclass(offered, Scene)
    fits = is_subclass if kind is Scene else isinstance(offered, kind)
    if not fits:
        return f"{entry.value} is not a {'subclass of Scene' if kind is Scene else kind.__name__}"
    name = getattr(offered, "name", entry.name)
    if name in table:
        return f'the name "{name}" is taken'
    table[name] = offered
    return None

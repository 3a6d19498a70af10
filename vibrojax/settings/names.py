"""Names that may be specified for a scene: parameters, options, presets, initial conditions and installed plug-ins.

An option has one value in a sweep, such as the friction law. A preset is a name that sets several parameters, such as a
rock; it may vary within a sweep. Scenes declare both in `Scene.choices`.
"""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cache, cached_property
from importlib.metadata import entry_points
from typing import Any

from vibrojax.errors import Place, nearest, shown, suggestion
from vibrojax.measures import GAUGES, Gauge
from vibrojax.physics.friction import FRICTION_LAWS, FrictionLaw
from vibrojax.physics.meanings import suggest_by_meaning, suggest_parameter
from vibrojax.physics.parameters import FREQUENCIES, REPLACED, Parameter, substitutes
from vibrojax.scenes import SCENES, HasContact, HasRock, Scene
from vibrojax.settings.code_identity import code_identity
from vibrojax.settings.run_settings import RunSettings
from vibrojax.settings.values import STATE, TOP_KEYS, choice, quantity
from vibrojax.stepping import STEPPERS, Stepper
from vibrojax.systems.system import DEFINED, System

_DERIVED = {
    "m2": ("beta", "m2 = beta m1; give beta"),
    "k2": ("gamma", "k2 = beta gamma^2 k1; give gamma"),
    "w1": ("k1", "w1 = sqrt(k1/m1); give k1"),
    "w2": ("gamma", "w2 = gamma w1; give gamma"),
    "D": ("threshold", "the rock's D is called threshold; give that"),
}
"""Quantities that are computed from a parameter: name of this parameter, and advice for a message."""

_RESULTS = ("blow_frequency", "blows", "blow_rate", "blows_per_minute", "bpm")
"""Words for the number of blows per minute, which follows from the motion."""


def known_options() -> dict[str, Mapping[str, object]]:
    """Return the options of all registered scenes, each with its possible values by name."""
    return {name: values for kind in SCENES.values() for name, values in kind.choices.items() if hasattr(kind, name)}


@dataclass(frozen=True)
class Names:
    """The names that may be specified for the scene `system`; `options`: name of the value of each option."""

    system: Scene[Any]
    options: Mapping[str, str]

    @property
    def scene(self) -> str:
        return self.system.name

    @property
    def starts(self) -> tuple[str, ...]:
        return self.system.starts

    @property
    def has_starts(self) -> bool:
        """True if the scene accepts a choice of initial conditions."""
        return bool(self.starts or self.system.start_states)

    @cached_property
    def parameters(self) -> dict[str, Parameter]:
        return dict(self.system.parameters())

    @cached_property
    def writable(self) -> dict[str, Parameter]:
        """All names to which a number can be assigned: parameters, rpm, bit_radius and frequencies."""
        return self.parameters | substitutes(self.parameters)

    @cached_property
    def units(self) -> dict[str, str]:
        """Unit of each number that can be assigned: parameters and states by name, and states as `start[0]`, ..."""
        known = {state.name: state.unit for state in self.system.states if state.name in self.system.start_states}
        places = {f"start[{k}]": known[name] for k, name in enumerate(self.system.start_states) if name in known}
        return known | places | {name: parameter.unit for name, parameter in self.writable.items()}

    @cached_property
    def presets(self) -> dict[str, dict[str, dict[str, float]]]:
        """For each preset, the parameters that each of its values sets."""
        return self.system.presets

    def preset(self, place: Place, name: str, value: object) -> str:
        """Return `value` if it is a value of the preset called `name`; raise otherwise."""
        return choice(place, value, tuple(self.presets[name]))

    def parameter(self, place: Place, name: str) -> Parameter:
        """Return the parameter called `name`, or raise at `place` if the scene has no such parameter."""
        if name not in self.writable:
            raise place.error(self._problem(name))
        return self.writable[name]

    def quantity(self, place: Place, name: str, value: object) -> float:
        """Return `value` as a number; raise if the parameter called `name` does not admit this value."""
        return quantity(place, value, self.parameter(place, name))

    def substituted(self, names: set[str]) -> set[str]:
        """Return the parameters that are defined by a preset, a rotation or a frequency in `names`."""
        parameters = {name for preset in self.presets if preset in names for name in self._set_by(preset)}
        # A radius without a rotation speed is that of the hole alone.
        return parameters | {REPLACED[name] for name in names & substitutes(self.parameters).keys() - {"bit_radius"}}

    def check_substitutes(self, places: Mapping[str, Place]) -> None:
        """Raise if a parameter is specified twice, or if one of rpm and bit_radius is missing.

        A rock defines threshold and k3, rpm and bit_radius together define v, bit_frequency defines k1, and
        striker_frequency defines gamma. In a scene with rock, bit_radius alone is the radius of the hole. `places`:
        place of each specified name in the file.
        """
        for preset in self.presets:
            for name in self._set_by(preset):
                if preset in places and name in places:
                    instead = " and ".join(self._set_by(preset))
                    raise places[preset].error(f"{name} is given as well; give the {preset}, or {instead}")
        rotation = [name for name in ("rpm", "bit_radius") if name in places]
        if rotation == ["bit_radius"] and isinstance(self.system, HasRock):
            rotation = []  # the radius of the hole
        if rotation and "v" in places:
            raise places[rotation[0]].error("v is given as well; give v, or rpm with bit_radius")
        for name in (name for name in FREQUENCIES if name in places and name not in self.parameters):
            if (replaced := REPLACED[name]) in places:
                raise places[name].error(f"{replaced} is given as well; give {replaced}, or {name}")
        if len(rotation) == 1:
            missing = "bit_radius [m]" if rotation == ["rpm"] else "rpm [1/min]"
            raise places[rotation[0]].error(f"{missing} is missing; only both together give v: add it, or give v")

    def start(self, place: Place, value: object) -> str | tuple[float, ...]:
        """Return a validated initial condition: a name, or a vector of states such as [x1, x1', x2, x2'] [m, m/s]."""
        states = self.system.start_states
        if isinstance(value, Mapping):
            raise place.error(f"{shown(value)} is no initial condition; write a list: [{', '.join(states)}]")
        if not isinstance(value, (list, tuple)):
            return self.named_start(place, value)
        if len(value) != len(states):
            needed = f"{len(states)} are needed: [{', '.join(states)}]"
            raise place.error(f"{shown(value)} has {len(value)} numbers; {needed}")
        return tuple(quantity(place.item(index), item, STATE) for index, item in enumerate(value))

    def named_start(self, place: Place, value: object) -> str:
        """Return the validated name of an initial condition."""
        known = isinstance(value, str) and any(value in getattr(kind, "starts", ()) for kind in SCENES.values())
        allowed = ", ".join(self.starts)
        if known and value not in self.starts:
            raise place.error(f"{shown(value)} is not a start of scene {shown(self.scene)}; choose from {allowed}")
        if isinstance(value, str) and value not in self.starts and nearest(value, self.starts):
            hint = f"{suggestion(value, self.starts)} (starts: {allowed})"
            raise place.error(f"{shown(value)} is unknown; {hint}")
        return choice(place, value, self.starts)

    def _set_by(self, preset: str) -> list[str]:
        return list(next(iter(self.presets[preset].values()), ()))

    def _problem(self, name: str) -> str:
        """Return a message that explains why `name` is not a parameter, with advice."""
        has = f"scene {shown(self.scene)} has no {name}; it has {', '.join(self.writable)}"
        if name in self.options:
            return f"is chosen once for all lanes, in [parameters]; choose from {', '.join(self.system.choices[name])}"
        for option, chosen in self.options.items():
            values = self.system.choices[option]
            # It has options, so it is a dataclass.
            kinds = {value: replace(self.system, **{option: x}) for value, x in values.items()}  # type: ignore[type-var]
            if owners := [shown(value) for value, kind in kinds.items() if name in kind.parameters()]:
                return f"{option} {shown(chosen)} has no {name}; it belongs to {option} = {' or '.join(owners)}"
        if name in _RESULTS and isinstance(self.system, HasContact):
            return "is a result of the motion and determines no parameter; give v, gamma or striker_frequency [Hz]"
        hint = suggest_by_meaning(name, self.writable.values())
        if name in known_options() or any(name in kind().parameters() for kind in SCENES.values()):
            return f"scene {shown(self.scene)} has no {name}; {hint}" if hint else has
        if name in _DERIVED and _DERIVED[name][0] in self.writable:
            return f"is not a parameter: {_DERIVED[name][1]}"
        if name in RunSettings.__dataclass_fields__:
            return f'is a setting of sweeps; it belongs in [run], in Python "run": {{"{name}": ...}}'
        if name in (*TOP_KEYS, "points"):
            return "is not a parameter; it belongs at the top of a sweep file"
        if not hint and not isinstance(self.system, System) and (elsewhere := self._meaning_elsewhere(name)):
            return f"scene {shown(self.scene)} has no {elsewhere}"
        return f"scene {shown(self.scene)} has no such parameter; {suggest_parameter(name, self.writable)}"

    def _meaning_elsewhere(self, name: str) -> str:
        """Return what `name` means in another scene, and the scenes that have it; "" if it has no meaning there."""
        hints = {kind.name: suggest_by_meaning(name, kind().parameters().values()) for kind in SCENES.values()}
        hints = {scene: hint.removeprefix("did you mean ").removesuffix("?") for scene, hint in hints.items() if hint}
        meant = next(iter(hints.values()), "")
        scenes = [scene for scene, hint in hints.items() if hint == meant]
        return f"{meant}; scenes with one: {', '.join(scenes)}" if meant else ""


def read_names(
    place: Place, scene: object, table: dict[str, Any] | None = None, table_place: Place | None = None
) -> Names:
    """Return the names of a scene with the options in `table`; raise if the scene or an option does not exist.

    The options are removed from `table`, which is at `table_place`. A scene or the value of an option may be an object
    instead of a name.
    """
    enter_offered()
    if isinstance(scene, Scene):
        system = scene
    elif isinstance(scene, str) and scene not in SCENES and scene in DEFINED:  # a system of this process
        system = DEFINED[scene]
    else:
        if isinstance(scene, str) and nearest(scene, SCENES) is None and scene not in SCENES:
            known = ", ".join((*SCENES, *DEFINED))
            raise place.error(
                f"{shown(scene)} is unknown; choose from {known}; a vj.System is known to the process that defines it"
            )
        system = SCENES[choice(place, scene, tuple(SCENES))]()
    own: set[str] = {field.name for field in fields(system)} if is_dataclass(system) else set()
    options = {name: getattr(system, name) for name in system.choices if name in own}
    chosen = {name: table.pop(name) for name in known_options() | options if name in table} if table else {}
    for option, value in chosen.items():
        here = (table_place or place).at(option)
        if option not in options:
            lacks = "does not slide" if option == "friction" else f"has no {option}"
            raise here.error(f"scene {shown(system.name)} {lacks}; leave it out")
        values = system.choices[option]
        is_value = not isinstance(value, str) and isinstance(value, tuple({type(x) for x in values.values()}))
        options[option] = value if is_value else values[choice(here, value, tuple(values))]
    if chosen:
        system = replace(system, **options)  # type: ignore[type-var] # it has options, so it is a dataclass
    code_identity(system, options)  # refuses a scene whose code has changed since it was compiled
    return Names(system, {option: str(getattr(value, "name", value)) for option, value in options.items()})


_GROUP = "vibrojax.objects"
"""Group of entry points for laws, scenes, steppers and gauges of other packages."""


@cache
def enter_offered() -> None:
    """Register the objects of installed packages by name, once per process.

    A package declares `[project.entry-points."vibrojax.objects"]` with, for example, `mine = "its_module:LAW"`.
    Friction laws, scenes and steppers are registered under their own name, gauges under the name of the entry point. An
    unusable object is skipped with a one-line warning, so that a broken package does not affect anything else.

    This function is called when names are read, not on import, because the packages import this one.
    """
    registries: list[tuple[type, dict[str, Any]]]
    registries = [(FrictionLaw, FRICTION_LAWS), (Stepper, STEPPERS), (Gauge, GAUGES)]
    for entry in entry_points(group=_GROUP):
        try:
            offered = entry.load()
        except Exception as error:  # the package's code may raise any exception
            problem = " ".join(f"{entry.value} cannot be imported ({error})".split())
        else:
            if isinstance(offered, System):
                continue  # a system is known by name once it is defined
            is_scene = isinstance(offered, type) and issubclass(offered, Scene)
            known = SCENES if is_scene else next((x for kind, x in registries if isinstance(offered, kind)), None)
            name = getattr(offered, "name", entry.name)
            if known is not None and name not in known:
                known[name] = offered
                continue
            problem = f'the name "{name}" is taken'
            if known is None:
                problem = f"{entry.value} is neither a law, a scene, a stepper nor a gauge"
        owner = entry.dist.name if entry.dist is not None else "a package"
        warnings.warn(f"{owner}: {_GROUP}: {entry.name}: {problem}; it is left out", stacklevel=2)

"""The names that a scene, with its friction law, understands."""

from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any

from vibrojax.errors import InputError, Place, shown, suggestion
from vibrojax.models.physics.friction import FRICTION_LAWS, FrictionLaw
from vibrojax.models.physics.parameters import ROTATION, Parameter
from vibrojax.models.physics.rock import ROCKS
from vibrojax.models.scenes import SCENES, Scene, scene_named
from vibrojax.models.scenes.penetration import PULSE_SHAPES
from vibrojax.sweep.input.offered import enter_offered
from vibrojax.sweep.input.run_settings import RunSettings
from vibrojax.sweep.input.values import choice, quantity

DEFAULT_STARTS = ("drive", "stuck")
_TOP = ("scene", "title", "starts", "unusual", "points")


# What follows from parameters, which decide it.
_DERIVED = {
    "m2": ("beta", "m2 = beta m1; give beta"),
    "k2": ("gamma", "k2 = beta gamma^2 k1; give gamma"),
    "w1": ("k1", "w1 = sqrt(k1/m1); give k1"),
    "w2": ("gamma", "w2 = gamma w1; give gamma"),
    "D": ("threshold", "the rock's D is called threshold; give that"),
}

# What is chosen by name for a whole sweep, and what there is to choose from.
CHOICES: dict[str, Mapping[str, object]] = {
    "friction": FRICTION_LAWS,
    "pulse_shape": {shape: shape for shape in PULSE_SHAPES},
}


def _options(system: Scene[Any]) -> dict[str, object]:
    """What is chosen in a scene once for all lanes, as it is: its friction law, its shape of pulses."""
    if not is_dataclass(system):
        return {}
    return {field.name: getattr(system, field.name) for field in fields(system) if field.name in CHOICES}


def _chosen(place: Place, option: str, value: object) -> object:
    """An option: an object such as a friction law of the user's own, or one of the package by its name."""
    if option == "friction" and isinstance(value, FrictionLaw):
        return value
    return CHOICES[option][choice(place, value, tuple(CHOICES[option]))]


@dataclass(frozen=True)
class Names:
    """What may be written for one scene: its parameters (by name), starts, rpm with bit_radius for v, and rocks.

    `options` are the names of what is chosen once for all lanes, of the friction law or the shape of pulses; `system`
    is the scene itself.
    """

    scene: str
    options: Mapping[str, str]
    parameters: Mapping[str, Parameter]
    starts: tuple[str, ...]
    system: Scene[Any]

    @property
    def friction(self) -> str | None:
        """Name of the friction law; None for a scene that does not slide."""
        return self.options.get("friction")

    @property
    def has_starts(self) -> bool:
        """Whether it may start from more than one state."""
        return bool(self.starts or self.system.start_states)

    @property
    def has_rock(self) -> bool:
        """Whether `rock` may stand for `threshold` and `k3`."""
        return {"threshold", "k3"} <= set(self.parameters)

    def rock(self, place: Place, value: object) -> str:
        """`value` as the name of a rock of Table 4.5."""
        return choice(place, value, tuple(ROCKS))

    @property
    def writable(self) -> dict[str, Parameter]:
        """Everything that may be written as a number."""
        return dict(self.parameters) | (ROTATION if "v" in self.parameters else {})

    def parameter(self, place: Place, name: str) -> Parameter:
        """The parameter called `name`; raises where the scene has none; `place` is where the name stands."""
        found = self.writable.get(name)
        if found is None:
            raise self._unknown(place, name)
        return found

    def quantity(self, place: Place, name: str, value: object) -> float:
        """`value` as a number that the parameter called `name` may have."""
        return quantity(place, value, self.parameter(place, name))

    def _unknown(self, place: Place, name: str) -> InputError:
        has = ", ".join(self.writable)
        if name in CHOICES and name not in self.options:
            return place.error(f"scene {shown(self.scene)} has no {name}; it has {has}")
        if name in CHOICES:
            names = ", ".join(CHOICES[name])
            return place.error(f"is chosen once for all lanes, in [parameters]; choose from {names}")
        laws = [law for law in FRICTION_LAWS.values() if name in law.parameters] if self.friction else []
        if laws:
            owners = " or ".join(shown(law.name) for law in laws)
            return place.error(f"friction {shown(self.friction)} has no {name}; it belongs to friction = {owners}")
        shapes = [shape for shape in PULSE_SHAPES if name in _shaped(self.scene, shape)] if self._has_pulses else []
        if shapes:
            owners = " or ".join(shown(shape) for shape in shapes)
            mine = shown(self.options["pulse_shape"])
            return place.error(f"pulse_shape {mine} has no {name}; it belongs to pulse_shape = {owners}")
        if any(name in kind().parameters() for kind in SCENES.values()):
            return place.error(f"scene {shown(self.scene)} has no {name}; it has {has}")
        if name in _DERIVED and _DERIVED[name][0] in self.writable:
            return place.error(f"is no parameter: {_DERIVED[name][1]}")
        if name in _TOP or name in RunSettings.__dataclass_fields__:
            home = "at the top of the file" if name in _TOP else "in [run]"
            return place.error(f"is no parameter; it belongs {home}")
        return place.error(f"scene {shown(self.scene)} has no such parameter; {suggestion(name, self.writable)}")

    @property
    def _has_pulses(self) -> bool:
        return "pulse_shape" in self.options

    def start(self, place: Place, value: object) -> str | tuple[float, ...]:
        """A start: one of the scene's names, or a vector of the states it gives, [x1, x1', x2, x2'] in m and m/s."""
        if isinstance(value, (list, tuple)):
            wanted = self.system.start_states
            if len(value) != len(wanted):
                needed = f"{_in_words(len(wanted))} are needed: [{', '.join(wanted)}]"
                raise place.error(f"{shown(value)} has {len(value)} numbers; {needed}")
            free = Parameter("start", 0.0, "1", "start", "s")
            return tuple(quantity(place.item(index), item, free) for index, item in enumerate(value))
        return self.named_start(place, value)

    def named_start(self, place: Place, value: object) -> str:
        """A start that has a name."""
        elsewhere = isinstance(value, str) and any(value in getattr(kind, "starts", ()) for kind in SCENES.values())
        if elsewhere and value not in self.starts:
            allowed = ", ".join(self.starts)
            raise place.error(f"{shown(value)} is no start of scene {shown(self.scene)}; choose from {allowed}")
        return choice(place, value, self.starts)


def _in_words(count: int) -> str:
    """A small number as a word."""
    words = ("none", "one", "two", "three", "four", "five", "six", "seven", "eight")
    return words[count] if count < len(words) else str(count)


def _shaped(scene: str, shape: str) -> Mapping[str, Parameter]:
    return scene_named(scene, pulse_shape=shape).parameters()


def take_options(given: dict[str, object]) -> dict[str, object]:
    """Take out of `given` what is chosen by name."""
    return {name: given.pop(name) for name in CHOICES if name in given}


def read_names(
    place: Place, scene: object, chosen: Mapping[str, object] | None = None, at: Place | None = None
) -> Names:
    """The names for the scene and options that the user wrote; raises where there is no such scene or option.

    `place` is where the scene stands, `at` where the options `chosen` do.
    """
    enter_offered()
    system = scene if isinstance(scene, Scene) else scene_named(choice(place, scene, tuple(SCENES)))
    options = _options(system)
    for option, value in (chosen or {}).items():
        here = (at or place).at(option)
        if option not in options:
            lacks = "does not slide" if option == "friction" else f"has no {option}"
            raise here.error(f"scene {shown(system.name)} {lacks}; leave it out")
        options[option] = _chosen(here, option, value)
    if chosen:
        system = replace(system, **options)  # type: ignore[type-var] # it has options, so it is a dataclass
    names = {option: str(getattr(value, "name", value)) for option, value in options.items()}
    return Names(system.name, names, dict(system.parameters()), system.starts, system)

"""The names that a scene, with its friction law, understands."""

from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass

from vibrojax.errors import InputError, Place, shown, suggestion
from vibrojax.physics.friction import FRICTION_LAWS
from vibrojax.physics.parameters import ROTATION, Parameter
from vibrojax.scenes import SCENES, Scene
from vibrojax.sweep._numbers import choice, quantity
from vibrojax.sweep._settings import RunSettings

DEFAULT_STARTS = ("drive", "stuck")
_TOP = ("scene", "title", "starts", "points")


def _default_friction(scene: str) -> str | None:
    """Name of the law with which the scene slides unless told otherwise; None for a scene that does not slide."""
    kind = SCENES[scene]
    found = [field.default for field in fields(kind) if field.name == "friction"] if is_dataclass(kind) else []
    return found[0].name if found else None


def build_scene(scene: str, friction: str | None) -> Scene:
    """The scene named `scene`, sliding by the law named `friction` (None: it does not slide)."""
    return SCENES[scene]() if friction is None else SCENES[scene](friction=FRICTION_LAWS[friction])


@dataclass(frozen=True)
class Names:
    """What may be written for one scene: its parameters (by name), starts, and rpm with bit_radius for v."""

    scene: str
    friction: str | None
    parameters: Mapping[str, Parameter]
    starts: tuple[str, ...]

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
        if name == "friction" and self.friction is None:
            return place.error(f"scene {shown(self.scene)} does not slide; it has {has}")
        if name == "friction":
            laws = ", ".join(FRICTION_LAWS)
            return place.error(f"a law is chosen once for all lanes, in [parameters]; choose from {laws}")
        laws = [law for law in FRICTION_LAWS.values() if name in law.parameters] if self.friction else []
        if laws:
            owners = " or ".join(shown(law.name) for law in laws)
            return place.error(f"friction {shown(self.friction)} has no {name}; it belongs to friction = {owners}")
        if any(name in kind().parameters() for kind in SCENES.values()):
            return place.error(f"scene {shown(self.scene)} has no {name}; it has {has}")
        if name in _TOP or name in RunSettings.__dataclass_fields__:
            home = "at the top of the file" if name in _TOP else "in [run]"
            return place.error(f"is no parameter; it belongs {home}")
        return place.error(f"scene {shown(self.scene)} has no such parameter; {suggestion(name, self.writable)}")

    def start(self, place: Place, value: object, vectors: bool = True) -> str | tuple[float, ...]:
        """A start: one of the scene's names, or a vector [x1, x1', x2, x2'] in m and m/s."""
        if isinstance(value, (list, tuple)) and vectors:
            if len(value) != 4:
                raise place.error(f"{shown(value)} has {len(value)} numbers; four are needed: [x1, x1', x2, x2']")
            free = Parameter("start", 0.0, "1", "start", "s")
            return tuple(quantity(place.item(index), item, free) for index, item in enumerate(value))
        elsewhere = isinstance(value, str) and any(value in getattr(kind, "starts", ()) for kind in SCENES.values())
        if elsewhere and value not in self.starts:
            allowed = ", ".join(self.starts)
            raise place.error(f"{shown(value)} is no start of scene {shown(self.scene)}; choose from {allowed}")
        return choice(place, value, self.starts)


def read_names(place: Place, scene: object, friction: object = None, friction_place: Place | None = None) -> Names:
    """The names for the scene and law that the user wrote; raises where there is no such scene or law.

    `place` is where the scene stands; `friction` is None where the user wrote none.
    """
    name = choice(place, scene, tuple(SCENES))
    law = _default_friction(name)
    if friction is not None:
        friction_place = friction_place or place.at("friction")
        if law is None:
            raise friction_place.error(f"scene {shown(name)} does not slide; leave it out")
        law = choice(friction_place, friction, tuple(FRICTION_LAWS))
    machine = build_scene(name, law)
    return Names(name, law, dict(machine.parameters()), tuple(getattr(machine, "starts", ())))

"""One point of a scene, checked as sweep files are."""

from collections.abc import Mapping
from dataclasses import dataclass

from vibrojax.errors import Place
from vibrojax.scenes import Scene
from vibrojax.sweep._names import build_scene, read_names
from vibrojax.sweep._read import check_drive_speed, read_parameters
from vibrojax.sweep._sweep import Start, with_drive_speed
from vibrojax.sweep._toml import plain


@dataclass(frozen=True)
class Point:
    """A scene at one point: names of scene and friction law, all parameters (SI), and the start."""

    scene: str
    friction: str | None
    start: Start | None
    parameters: dict[str, float]

    @property
    def machine(self) -> Scene:
        """The scene itself, with its friction law."""
        return build_scene(self.scene, self.friction)


def read_point(place: Place, scene: object, given: Mapping[str, object], start: object = None) -> Point:
    """Check one point.

    **Arguments:**

    - `place`: what messages name as the file.
    - `scene`: the scene's name.
    - `given`: parameters by name; `friction` names a law; `rpm` with `bit_radius` may stand for `v`.
    - `start`: a name or a vector [x1, x1', x2, x2'] [m, m/s]; None: the scene's first.

    **Returns:** the `Point`, complete with defaults.

    **Raises:** `InputError`.
    """
    given = dict(plain(place, given))
    names = read_names(place.at("scene"), scene, given.pop("friction", None), place.at("friction"))
    fixed = read_parameters(place, given, names)
    check_drive_speed({name: place.at(name) for name in fixed})
    defaults = {name: parameter.default for name, parameter in names.parameters.items()}
    if start is None:
        start = names.starts[0] if names.starts else None
    elif not names.starts:
        raise place.at("start").error(f'scene "{names.scene}" has no starts; leave it out')
    else:
        start = names.start(place.at("start"), plain(place.at("start"), start))
    return Point(names.scene, names.friction, start, defaults | with_drive_speed(fixed))

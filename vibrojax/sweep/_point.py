"""One point of a scene, checked as sweep files are."""

from collections.abc import Mapping
from dataclasses import dataclass

from vibrojax.errors import Place
from vibrojax.scenes import Scene
from vibrojax.sweep._names import build_scene, read_names, take_options
from vibrojax.sweep._read import check_drive_speed, check_rock, read_parameters
from vibrojax.sweep._sweep import Start, with_drive_speed
from vibrojax.sweep._toml import plain


@dataclass(frozen=True)
class Point:
    """A scene at one point: its name, what is chosen by name in it, all parameters (SI), and the start."""

    scene: str
    options: dict[str, str]
    start: Start | None
    parameters: dict[str, float]

    @property
    def machine(self) -> Scene:
        """The scene itself, with its options."""
        return build_scene(self.scene, self.options)


def read_point(place: Place, scene: object, given: Mapping[str, object], start: object = None) -> Point:
    """Check one point.

    **Arguments:**

    - `place`: what messages name as the file.
    - `scene`: the scene's name.
    - `given`: parameters by name; `friction` names a law, `pulse_shape` a shape; `rpm` with `bit_radius` may stand for
      `v`, and `rock` for `threshold` and `k3`.
    - `start`: a name or a vector [x1, x1', x2, x2'] [m, m/s]; None: the scene's first.

    **Returns:** the `Point`, complete with defaults.

    **Raises:** `InputError`.
    """
    given = dict(plain(place, given))
    names = read_names(place.at("scene"), scene, take_options(given), place)
    check_rock({name: place.at(name) for name in given})
    fixed = read_parameters(place, given, names)
    check_drive_speed({name: place.at(name) for name in fixed})
    defaults = {name: parameter.default for name, parameter in names.parameters.items()}
    if start is None:
        start = names.starts[0] if names.starts else None
    elif not names.starts:
        raise place.at("start").error(f'scene "{names.scene}" has no starts; leave it out')
    else:
        start = names.start(place.at("start"), plain(place.at("start"), start))
    return Point(names.scene, dict(names.options), start, defaults | with_drive_speed(fixed))

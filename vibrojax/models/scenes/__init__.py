"""The scenes, a few to a file; a file in this folder that names its classes in `SCENES` is found by itself."""

from importlib import import_module
from pkgutil import iter_modules
from typing import Any

from vibrojax.models.scenes.capabilities import Driven as Driven
from vibrojax.models.scenes.capabilities import HasContact as HasContact
from vibrojax.models.scenes.capabilities import HasFriction as HasFriction
from vibrojax.models.scenes.capabilities import HasRock as HasRock
from vibrojax.models.scenes.declared import Guard as Guard
from vibrojax.models.scenes.declared import Marker as Marker
from vibrojax.models.scenes.declared import Mode as Mode
from vibrojax.models.scenes.declared import Section as Section
from vibrojax.models.scenes.declared import State as State
from vibrojax.models.scenes.declared import Swing as Swing
from vibrojax.models.scenes.scene import Scene as Scene

_files = (import_module(f"{__name__}.{file.name}") for file in iter_modules(__path__))

_kinds = (kind for file in _files for kind in getattr(file, "SCENES", ()))

SCENES: dict[str, type[Scene[Any]]] = {kind.name: kind for kind in sorted(_kinds, key=lambda kind: kind.name)}
"""The scenes of the package, classes, by the names that sweep files call them.

**Example:**

>>> list(vj.SCENES)
['coupled-drilling', 'drilling', 'penetration', 'rotary', 'vibro-impact']
>>> vj.SCENES["vibro-impact"](friction=vj.FRICTION_LAWS["coulomb"]).state_names
('x1', 'v1', 'x2', 'v2')
"""


def scene_named(scene: str | Scene[Any], **options: Any) -> Scene[Any]:
    """The scene of that name with its `options` (friction, pulse_shape), or a scene itself.

    Raises `KeyError` where there is none of the name.
    """
    return scene if isinstance(scene, Scene) else SCENES[scene](**options)

"""The scenes: each file of this folder lists its scene classes in `SCENES`, and these are registered."""

from importlib import import_module
from pkgutil import iter_modules
from typing import Any

from vibrojax.scenes.capabilities import Driven, HasContact, HasFriction, HasImpacts, HasRock
from vibrojax.scenes.declared import Guard, Marker, Mode, Section, State, Swing
from vibrojax.scenes.scene import Scene

__all__ = ["SCENES", "Driven", "Guard", "HasContact", "HasFriction", "HasImpacts", "HasRock", "Marker", "Mode", "Scene"]
__all__ += ["Section", "State", "Swing"]

_files = (import_module(f"{__name__}.{file.name}") for file in iter_modules(__path__))
_kinds = (kind for file in _files for kind in getattr(file, "SCENES", ()))

SCENES: dict[str, type[Scene[Any]]] = {kind.name: kind for kind in sorted(_kinds, key=lambda kind: kind.name)}
"""A dict of the package's scene classes; its keys are the names of the scenes in sweep files.

**Example:**

>>> list(vj.SCENES)
['coupled-drilling', 'drilling', 'penetration', 'rotary', 'vibro-impact']
>>> vj.SCENES["vibro-impact"](friction=vj.FRICTION_LAWS["coulomb"]).state_names
('x1', 'v1', 'x2', 'v2')
"""

"""Dry-friction laws, one per file. Each file of this folder defines `LAW`, which is registered.

**Example:**

>>> law = vj.friction.law_named("stribeck")
>>> defaults = {name: parameter.default for name, parameter in law.parameters.items()}
>>> round(float(law.on_weight(0.0, defaults)), 3), law.reference
(0.4, 'eq. 5.9')
"""

from importlib import import_module
from pkgutil import iter_modules

from vibrojax.models.physics.friction._law import FrictionLaw as FrictionLaw
from vibrojax.models.physics.friction._law import Numbers as Numbers

_files = (file.name for file in iter_modules(__path__) if not file.name.startswith("_"))
_laws = (import_module(f"{__name__}.{file}").LAW for file in _files)

FRICTION_LAWS: dict[str, FrictionLaw] = {law.name: law for law in _laws}
"""The friction laws of the package by name, as in sweep files.

**Example:**

>>> sorted(vj.FRICTION_LAWS)
['coulomb', 'hyperbolic', 'hyperbolic-quadratic', 'popp-arctan', 'popp-exponential', 'stribeck']
>>> list(vj.FRICTION_LAWS["stribeck"].parameters)
['mu', 'v_cr']
"""


def law_named(law: str | FrictionLaw) -> FrictionLaw:
    """Return the friction law with this name; a law object is returned unchanged.

    Raises `KeyError` if the name is unknown.
    """
    return law if isinstance(law, FrictionLaw) else FRICTION_LAWS[law]

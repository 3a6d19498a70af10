"""Dry-friction laws, one file each; a file in this folder that binds `LAW` is found by itself.

**Example:**

>>> law = vj.friction.law_named("stribeck")
>>> defaults = {name: one.default for name, one in law.parameters.items()}
>>> round(float(law.on_weight(0.0, defaults)), 3), law.reference
(0.4, 'eq. 5.9')
"""

from importlib import import_module
from pkgutil import iter_modules

from vibrojax.models.physics.friction._law import FrictionLaw as FrictionLaw
from vibrojax.models.physics.friction._law import Numbers as Numbers

_laws = (
    import_module(f"{__name__}.{found.name}") for found in iter_modules(__path__) if not found.name.startswith("_")
)

FRICTION_LAWS: dict[str, FrictionLaw] = {module.LAW.name: module.LAW for module in _laws}
"""The friction laws of the package by the names that sweep files call them.

**Example:**

>>> sorted(vj.FRICTION_LAWS)
['coulomb', 'hyperbolic', 'hyperbolic-quadratic', 'popp-arctan', 'popp-exponential', 'stribeck']
>>> list(vj.FRICTION_LAWS["stribeck"].parameters)
['mu', 'v_cr']
"""


def law_named(law: str | FrictionLaw) -> FrictionLaw:
    """The law of that name, or a law itself; raises `KeyError` where there is none of the name."""
    return law if isinstance(law, FrictionLaw) else FRICTION_LAWS[law]

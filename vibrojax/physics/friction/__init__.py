"""Dry-friction laws, one file each; a file in this folder that binds `LAW` is found by itself."""

from importlib import import_module
from pkgutil import iter_modules

from vibrojax.physics.friction._law import FrictionLaw as FrictionLaw
from vibrojax.physics.friction._law import Numbers as Numbers

_laws = (
    import_module(f"{__name__}.{found.name}") for found in iter_modules(__path__) if not found.name.startswith("_")
)

FRICTION_LAWS: dict[str, FrictionLaw] = {module.LAW.name: module.LAW for module in _laws}


def law_named(law: str | FrictionLaw) -> FrictionLaw:
    """The law of that name, or a law itself; raises `KeyError` where there is none of the name."""
    return law if isinstance(law, FrictionLaw) else FRICTION_LAWS[law]

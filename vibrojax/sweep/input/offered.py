"""Plug-ins that installed packages declare as entry points: friction laws, scenes, steppers and gauges."""

import warnings
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from vibrojax.measures import GAUGES, Gauge
from vibrojax.models.physics.friction import FRICTION_LAWS, FrictionLaw
from vibrojax.models.scenes import SCENES, Scene
from vibrojax.stepping import STEPPERS, Stepper

_GROUPS: dict[str, tuple[dict[str, Any], type]] = {
    "vibrojax.friction_laws": (FRICTION_LAWS, FrictionLaw),
    "vibrojax.scenes": (SCENES, Scene),
    "vibrojax.steppers": (STEPPERS, Stepper),
    "vibrojax.gauges": (GAUGES, Gauge),
}
"""Groups of entry points. For each group: the registry of the objects, and their required type. Scenes are registered
as classes, not as instances."""


@cache
def enter_offered() -> None:
    """Register the plug-ins of installed packages by name, once per process.

    A package declares, for example, `[project.entry-points."vibrojax.friction_laws"]` with `mine = "its_module:LAW"`.
    Friction laws, scenes and steppers are registered under their own name, gauges under the name of the entry point. An
    unusable object is skipped with a one-line warning, so that a broken package does not affect anything else.

    This function is called when names are read, not on import, because the packages import this one.
    """
    for group, (table, kind) in _GROUPS.items():
        for entry in entry_points(group=group):
            problem = _enter(entry, table, kind)
            if problem is not None:
                owner = entry.dist.name if entry.dist is not None else "a package"
                warnings.warn(f"{owner}: {group}: {entry.name}: {problem}; it is left out", stacklevel=2)


def _enter(entry: EntryPoint, table: dict[str, Any], kind: type) -> str | None:
    """Register one object; return a description of its problem, or None if it has been registered."""
    try:
        offered = entry.load()
    except Exception as error:  # the package's code may raise any exception
        return " ".join(f"{entry.value} cannot be imported ({error})".split())
    is_subclass = isinstance(offered, type) and issubclass(offered, Scene)
    fits = is_subclass if kind is Scene else isinstance(offered, kind)
    if not fits:
        return f"{entry.value} is not a {'subclass of Scene' if kind is Scene else kind.__name__}"
    name = getattr(offered, "name", entry.name)
    if name in table:
        return f'the name "{name}" is taken'
    table[name] = offered
    return None

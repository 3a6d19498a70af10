"""What installed packages offer under entry points: friction laws, scenes, steppers and gauges, by name."""

import warnings
from collections.abc import Callable
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from vibrojax.measures import GAUGES, Gauge
from vibrojax.models.physics.friction import FRICTION_LAWS, FrictionLaw
from vibrojax.models.scenes import SCENES, Scene
from vibrojax.stepping import STEPPERS, Stepper


def _is_scene(offered: object) -> bool:
    return isinstance(offered, type) and issubclass(offered, Scene)


# The groups: where what they hold is entered, what it must be, and its name.
_GROUPS: dict[str, tuple[dict[str, Any], str, Callable[[Any], bool]]] = {
    "vibrojax.friction_laws": (FRICTION_LAWS, "FrictionLaw", lambda offered: isinstance(offered, FrictionLaw)),
    "vibrojax.scenes": (SCENES, "subclass of Scene", _is_scene),
    "vibrojax.steppers": (STEPPERS, "Stepper", lambda offered: isinstance(offered, Stepper)),
    "vibrojax.gauges": (GAUGES, "Gauge", lambda offered: isinstance(offered, Gauge)),
}


@cache
def enter_offered() -> None:
    """Enter what installed packages offer into the tables of names, once.

    A package declares, say, `[project.entry-points."vibrojax.friction_laws"]` with `mine = "its_module:LAW"`; the names
    of its law, scene and stepper are the objects' own, that of a gauge is the entry's. What cannot be used is left out
    with a warning of one line, so that a package that is broken stops nothing else.

    Called where names are read, not on import: the packages import this one.
    """
    for group, (table, kind, fits) in _GROUPS.items():
        for entry in entry_points(group=group):
            problem = _enter(entry, table, kind, fits)
            if problem is not None:
                owner = entry.dist.name if entry.dist is not None else "a package"
                warnings.warn(f"{owner}: {group}: {entry.name}: {problem}; it is left out", stacklevel=2)


def _enter(entry: EntryPoint, table: dict[str, Any], kind: str, fits: Callable[[Any], bool]) -> str | None:
    """Enter one; what is wrong with it, or None."""
    try:
        offered = entry.load()
    except Exception as error:  # whatever a package's own code raises
        return " ".join(f"{entry.value} cannot be imported ({error})".split())
    if not fits(offered):
        return f"{entry.value} is no {kind}"
    name = getattr(offered, "name", entry.name)
    if name in table:
        return f'the name "{name}" is taken'
    table[name] = offered
    return None

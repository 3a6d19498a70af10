"""Objects that installed packages offer under entry points: friction laws, scenes, steppers and gauges."""

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
"""Groups of entry points: the table that an object enters, and its kind; of scenes the class enters."""


@cache
def enter_offered() -> None:
    """Enter the objects that installed packages offer into the tables of names, once.

    A package declares, say, `[project.entry-points."vibrojax.friction_laws"]` with `mine = "its_module:LAW"`. The
    names of a law, a scene and a stepper are the objects' own, that of a gauge is the entry's. An unusable object is
    left out with a warning of one line, so that a broken package stops nothing else.

    Called when names are read, not on import: the packages import this one.
    """
    for group, (table, kind) in _GROUPS.items():
        for entry in entry_points(group=group):
            problem = _enter(entry, table, kind)
            if problem is not None:
                owner = entry.dist.name if entry.dist is not None else "a package"
                warnings.warn(f"{owner}: {group}: {entry.name}: {problem}; it is left out", stacklevel=2)


def _enter(entry: EntryPoint, table: dict[str, Any], kind: type) -> str | None:
    """Enter one object; return what is wrong with it, or None."""
    try:
        offered = entry.load()
    except Exception as error:  # whatever a package's own code raises
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

"""Quantities of a drill derived from the features of its motion: impact power, blows per minute, specific energy."""

from collections.abc import Mapping
from math import pi
from typing import Any

import numpy as np

from vibrojax.scenes.capabilities import HasContact, HasRock
from vibrojax.scenes.scene import Scene

HOLE_RADIUS = 0.036
"""Radius of the hole [m] if no `bit_radius` is given."""


def derived_names(scene: Scene[Any]) -> tuple[str, ...]:
    """Return the names of the derived quantities of a scene."""
    if not isinstance(scene, HasContact):
        return ()
    return "impact_power", "blow_frequency", *(("specific_energy",) if isinstance(scene, HasRock) else ())


def derived(scene: Scene[Any], features: Mapping[str, Any], bit_radius: Any, xp: Any = np) -> dict[str, Any]:
    """Return the derived quantities of lanes by name; NaN where they are undefined.

    `features`: features of the lanes; `bit_radius` [m]: radius of the hole, one value or (lanes,); `xp`: the module of
    the arrays, numpy or jax.numpy.
    """
    names = derived_names(scene)
    if not names or not {"impacts", "cycles", "period", "impact_energy"} <= features.keys():
        return {}
    impacts, cycles, period = (features[name] for name in ("impacts", "cycles", "period"))
    with np.errstate(all="ignore"):
        power = features["impact_energy"] * impacts / (cycles * period)
        power = xp.where(cycles > 0, xp.where(impacts == 0, 0.0 * period, power), np.nan)
        quantities = {"impact_power": power, "blow_frequency": blow_frequency(impacts, cycles, period, xp)}
        if "specific_energy" in names:
            rate = features["rate_of_penetration"]
            quantities["specific_energy"] = xp.where(rate > 0, power / (pi * bit_radius**2 * rate), np.nan)
    return {name: x.astype(period.dtype) for name, x in quantities.items()}


def blow_frequency(impacts: Any, cycles: Any, period: Any, xp: Any = np) -> Any:
    """Return the impacts per minute; without a repeat, `impacts` counts the impacts of one return."""
    return 60 * impacts / (xp.maximum(cycles, 1) * period)

"""Periodic orbits of lanes that repeat: fixed points of the return map, by Newton's method, and their multipliers."""

from vibrojax.periodic.early_stopping import early_stopping_of as early_stopping_of
from vibrojax.periodic.nearby import Nearby as Nearby
from vibrojax.periodic.of_lanes import Orbits as Orbits

"""Periodic orbits of lanes, found by Newton's method as fixed points of the return map, and their multipliers.

A lane is one trajectory of a batch.
"""

from vibrojax.periodic.early_stopping import early_stopping_of as early_stopping_of
from vibrojax.periodic.lane_orbits import Orbits as Orbits
from vibrojax.periodic.nearby import Nearby as Nearby

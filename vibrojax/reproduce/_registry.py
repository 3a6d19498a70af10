"""All groups, in the order of the page."""

from vibrojax.reproduce._group import Group as Group
from vibrojax.reproduce.groups import (
    classical,
    drill,
    frequency_ratio,
    friction,
    law,
    linear,
    mass_ratio,
    penetration,
    region,
    self_excitation,
)

GROUPS: tuple[Group, ...] = (
    linear.GROUP,
    friction.GROUP,
    self_excitation.GROUP,
    frequency_ratio.GROUP,
    mass_ratio.GROUP,
    region.GROUP,
    penetration.GROUP,
    law.GROUP,
    drill.GROUP,
    classical.GROUP,
)

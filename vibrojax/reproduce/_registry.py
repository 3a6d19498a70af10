"""All groups, in the order of the page."""

from vibrojax.reproduce._group import Group as Group
from vibrojax.reproduce.groups import frequency_ratio, linear, mass_ratio, region, self_excitation

GROUPS: tuple[Group, ...] = (linear.GROUP, self_excitation.GROUP, frequency_ratio.GROUP, mass_ratio.GROUP, region.GROUP)

"""All groups, in the order of the page."""

from vibrojax.reproduce._group import Group as Group
from vibrojax.reproduce.groups import linear, self_excitation

GROUPS: tuple[Group, ...] = (linear.GROUP, self_excitation.GROUP)

"""Lanes that several parts of the section use."""

from vibrojax.reproduce.groups._impact import at

USUAL_POINT, OTHER_GAP = at(), at(start="stuck", delta=0.005)
SLOW = at(v=0.5)

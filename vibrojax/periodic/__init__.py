"""Periodic orbits of lanes, found by Newton's method as fixed points of the return map, and their multipliers.

A lane is one trajectory of a batch.
"""

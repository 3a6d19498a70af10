"""Periodic orbits of the lanes of a sweep, with their multipliers."""

"""Attractors that coexist: motions of a point, matched to those of neighbouring points, and their basins."""

"""Coexisting attractors: motions at each grid point, matched between neighbouring points, and their basins."""

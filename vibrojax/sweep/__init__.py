"""Sweeps: from a sweep file to the features of its lanes, and single trajectories."""

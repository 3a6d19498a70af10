"""Families of periodic orbits over a parameter, stable and unstable, and their special points."""

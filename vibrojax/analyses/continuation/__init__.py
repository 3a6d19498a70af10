"""Continuation of families of periodic orbits along a parameter, and location of their special points."""

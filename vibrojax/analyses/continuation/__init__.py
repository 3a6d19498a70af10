"""Continuation of families of periodic orbits over a parameter, and their special points."""

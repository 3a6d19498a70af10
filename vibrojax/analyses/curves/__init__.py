"""The analysis `curves`: special points of periodic orbits, continued in a second parameter."""

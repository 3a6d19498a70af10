"""Coefficients of the source's equations for rotary motion, fitted to velocities and periods."""

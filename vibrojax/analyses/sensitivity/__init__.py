"""Derivatives of the features of a lane with respect to its parameters."""

"""Derivatives of a lane's measured features with respect to its parameters."""

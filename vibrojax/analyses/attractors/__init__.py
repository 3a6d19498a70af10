"""Attractors that coexist: motions of a point told apart, and known again at the next point of a grid."""

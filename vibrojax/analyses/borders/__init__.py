"""Borders of the stable single impact in planes of two parameters, as curves with the kind of each border."""

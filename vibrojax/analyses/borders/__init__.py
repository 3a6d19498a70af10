"""Borders of the region of stable single-impact orbits in planes of two parameters, as curves classified by kind."""

"""Toolkit for pictures: axes, colours, units, legends and layout."""

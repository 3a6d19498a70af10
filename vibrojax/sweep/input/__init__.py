"""Sweep files and points, read and checked."""

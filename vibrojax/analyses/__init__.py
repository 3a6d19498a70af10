"""Analyses of scenes and datasets, one folder per analysis."""

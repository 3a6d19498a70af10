"""Analyses of scenes and datasets: one folder for each."""

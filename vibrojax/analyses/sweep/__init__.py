"""Sweeps over parameter spaces: run, resume, join and draw."""

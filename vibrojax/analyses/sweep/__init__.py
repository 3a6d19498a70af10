"""Sweeps over parameter spaces: running, resuming, joining chunks, and drawing."""

"""Datasets and other files on disk."""

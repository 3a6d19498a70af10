"""Computation of a sweep: compiled programs that step lanes in batches and chunks."""

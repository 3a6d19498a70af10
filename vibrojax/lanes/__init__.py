"""Runs of lanes, arrays in and arrays out: compiled programs step them in batches and chunks."""

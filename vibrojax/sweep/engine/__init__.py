"""Batches of lanes, stepped in chunks through compiled programs."""

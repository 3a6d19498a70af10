"""Systems written as plain functions."""

"""From a sweep file to a dataset: grids, chunks, executors."""

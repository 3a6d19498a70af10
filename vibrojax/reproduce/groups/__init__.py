"""The groups of results, one file each; a file binds `GROUP`."""

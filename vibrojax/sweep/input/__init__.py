"""Reading and validation of sweep files and points."""

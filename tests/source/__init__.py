"""The source's tables and figures, compared with computed values; see `reproduce.py`."""

"""Rig logs: exports of rig data, with the column names, units and nulls of the exporting software."""

from vibrojax.io.riglog.log import Log, log_lines, open_log, read_log

__all__ = ["Log", "log_lines", "open_log", "read_log"]

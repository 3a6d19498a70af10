"""Rig logs: exports of rig data, whose column names, units and nulls are those of the exporting software."""

from vibrojax.io.riglog.log import Log, log_lines, open_log, read_log

__all__ = ["Log", "log_lines", "open_log", "read_log"]

"""Rig logs: exports of rig data, with the column names, units and nulls of the exporting software."""

from vibrojax.io.riglog.log import LIMITS_OF_LOGS, Log, is_log, log_lines, open_log, read_log

__all__ = ["LIMITS_OF_LOGS", "Log", "is_log", "log_lines", "open_log", "read_log"]

"""The command as a process, and the text of a sweep with few short chunks."""

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
TEXT = """
scene = "vibro-impact"
[grid]
beta = [0.3, 0.4, 0.5]
gamma = [0.6, 0.7, 0.75, 0.8]
[run]
settle = 3.0
observe = 2.0
chunk = 5
"""
# The process that runs the tests may ignore interrupts (a background job), but the command must not. `preexec_fn` would
# need a fork, about which jax warns if an earlier test has used jax.
_WITH_INTERRUPTS = """
import os, signal, sys
signal.signal(signal.SIGINT, signal.SIG_DFL)
{before}
os.execv(sys.executable, [sys.executable, "-m", "vibrojax", *sys.argv[1:]])
"""


def start(
    *words: object, before: str = "", environment: dict[str, str] | None = None, **more: Any
) -> "subprocess.Popen[str]":
    """Start the command with interrupts enabled and its output in pipes. Python runs `before` first."""
    variables = os.environ | {"PYTHONPATH": str(ROOT)} | (environment or {})
    pipes: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    code = _WITH_INTERRUPTS.format(before=before)
    return subprocess.Popen([sys.executable, "-c", code, *map(str, words)], env=variables, **pipes, **more)

"""The command as a process, and a sweep of few short chunks for it."""

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
# Whoever runs the tests may be deaf to interrupts (a job in the background); the command is not to be. (Not by
# `preexec_fn`: the fork that it takes makes jax warn wherever a test before has used it.)
_HEARS = """
import os, signal, sys
signal.signal(signal.SIGINT, signal.SIG_DFL)
{before}
os.execv(sys.executable, [sys.executable, "-m", "vibrojax", *sys.argv[1:]])
"""


def start(
    *words: object, before: str = "", environment: dict[str, str] | None = None, **more: Any
) -> "subprocess.Popen[str]":
    """The command, running, which hears interrupts; what it says is in its pipes. Python runs `before` first."""
    known = os.environ | {"PYTHONPATH": str(ROOT)} | (environment or {})
    pipes: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    hears = _HEARS.format(before=before)
    return subprocess.Popen([sys.executable, "-c", hears, *map(str, words)], env=known, **pipes, **more)

"""The command as a process, and the text of a sweep with few short chunks."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
TEXT = """
scene = "rotary"
[grid]
beta = [0.3, 0.4, 0.5]
gamma = [0.6, 0.7, 0.75, 0.8]
[run]
settle = 3.0
observe = 2.0
chunk = 5
"""
LONGEST_WAIT = 300.0
"""Time [s] after which a process counts as stuck. Commands wait until their chunks are on the disk, which can take
minutes while other work writes to it."""

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
    variables = os.environ | {"PYTHONPATH": str(ROOT), "PYTHONFAULTHANDLER": "1"} | (environment or {})
    pipes: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    code = _WITH_INTERRUPTS.format(before=before)
    return subprocess.Popen([sys.executable, "-c", code, *map(str, words)], env=variables, **pipes, **more)


def end_of(process: "subprocess.Popen[str]") -> tuple[int, str]:
    """Return the status of a process and its text on stderr, once it has ended."""
    try:
        _, errors = process.communicate(timeout=LONGEST_WAIT)
    except subprocess.TimeoutExpired:
        raise AssertionError(f"the process did not end:\n{_abort(process)}") from None
    return process.returncode, errors


def wait_for(condition: Callable[[], object], process: "subprocess.Popen[str]") -> None:
    """Wait until a condition holds while a process runs."""
    latest = time.monotonic() + LONGEST_WAIT
    while not condition():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < latest, f"the condition is not met:\n{_abort(process)}"
        time.sleep(0.01)


def _abort(process: "subprocess.Popen[str]") -> str:
    """End a process, and return its text on stderr, to which Python adds what each of its threads was doing."""
    process.send_signal(signal.SIGABRT)
    return process.communicate()[1]

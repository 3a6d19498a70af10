"""Ctrl-C while jax calls back: KeyboardInterrupt is raised as soon as the compiled program is left."""

import _thread
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import TypeVar

import jax

R = TypeVar("R")

POLL_SECONDS = 1e-3
"""Interval at which the main thread's stack is inspected after Ctrl-C."""

_JAX = str(Path(jax.__file__).parent)
_PENDING = threading.Event()


def deferring_interrupts(compute: Callable[[], R], nothing: R) -> R:
    """Return `compute()`; upon Ctrl-C, return `nothing` and raise KeyboardInterrupt once the callback is over.

    jax reports each exception of a callback as an error of XLA. Callbacks that the program makes before it ends return
    `nothing` as well.
    """
    if _PENDING.is_set():
        return nothing
    try:
        return compute()
    except KeyboardInterrupt:
        _PENDING.set()
        caller = _caller(sys._getframe())
        instruction = caller.f_lasti if caller else 0
        threading.Thread(target=_interrupt_after, args=(caller, instruction), daemon=True).start()
        return nothing


def await_interrupt() -> None:
    """Return at once, or wait for the KeyboardInterrupt that a callback has deferred."""
    while _PENDING.is_set():
        time.sleep(POLL_SECONDS)


def _caller(frame: FrameType | None) -> FrameType | None:
    """Return the frame that runs the compiled program, outside of the functions of jax that call back, in one file."""
    file = ""
    while frame and file in ("", frame.f_code.co_filename):
        if frame.f_code.co_filename.startswith(_JAX):
            file = frame.f_code.co_filename
        frame = frame.f_back
    return frame


def _interrupt_after(caller: FrameType | None, instruction: int) -> None:
    """Interrupt the main thread when the frame `caller` has gone on from its `instruction`, or has ended."""
    main = threading.main_thread().ident or 0

    def is_busy() -> bool:
        frame = sys._current_frames().get(main)
        while frame and frame is not caller:
            frame = frame.f_back
        return frame is not None and frame.f_lasti == instruction

    while is_busy():
        time.sleep(POLL_SECONDS)
    _PENDING.clear()
    _thread.interrupt_main()

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
        threading.Thread(target=_interrupt_after, args=(_callback(sys._getframe()),), daemon=True).start()
        return nothing


def await_interrupt() -> None:
    """Return at once, or wait for the KeyboardInterrupt that a callback has deferred."""
    while _PENDING.is_set():
        time.sleep(POLL_SECONDS)


def _callback(frame: FrameType | None) -> list[FrameType]:
    """Return the frames of a callback and of the functions through which jax calls it, which are in one file of jax."""
    frames: list[FrameType] = []
    file = ""
    while frame and file in ("", frame.f_code.co_filename):
        frames.append(frame)
        if frame.f_code.co_filename.startswith(_JAX):
            file = frame.f_code.co_filename
        frame = frame.f_back
    return frames


def _interrupt_after(frames: list[FrameType]) -> None:
    """Interrupt the main thread when it has left all of the `frames`."""
    main = threading.main_thread().ident or 0

    def is_busy() -> bool:
        frame = sys._current_frames().get(main)
        while frame and not any(frame is other for other in frames):
            frame = frame.f_back
        return frame is not None

    while is_busy():
        time.sleep(POLL_SECONDS)
    _PENDING.clear()
    _thread.interrupt_main()

"""Ctrl-C while jax calls back: KeyboardInterrupt is raised as soon as the compiled program is left."""

import _thread
import sys
import threading
import time
from collections.abc import Callable
from types import CodeType, FrameType
from typing import TypeVar

R = TypeVar("R")

POLL_SECONDS = 1e-3
"""Interval at which the main thread's stack is inspected after Ctrl-C."""

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
        threading.Thread(target=_interrupt_after, args=(_callback(sys._getframe(1)),), daemon=True).start()
        return nothing


def await_interrupt() -> None:
    """Return at once, or wait for the KeyboardInterrupt that a callback has deferred."""
    while _PENDING.is_set():
        time.sleep(POLL_SECONDS)


def _callback(frame: FrameType) -> set[CodeType]:
    """Return the code of a callback and of the functions through which jax calls it, which are in one file."""
    codes, caller = {frame.f_code}, frame.f_back
    file = caller.f_code.co_filename if caller else ""
    while caller and caller.f_code.co_filename == file:
        codes.add(caller.f_code)
        caller = caller.f_back
    return codes


def _interrupt_after(codes: set[CodeType]) -> None:
    """Interrupt the main thread when it no longer runs `codes`."""
    main = threading.main_thread().ident or 0

    def is_busy() -> bool:
        frame = sys._current_frames().get(main)
        while frame and frame.f_code not in codes:
            frame = frame.f_back
        return frame is not None

    while is_busy():
        time.sleep(POLL_SECONDS)
    _PENDING.clear()
    _thread.interrupt_main()

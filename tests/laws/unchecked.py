"""Fits of many sets of data without checks of types, which take longer than the fits; single fits are checked."""

from contextlib import contextmanager

import jaxtyping


@contextmanager
def unchecked():
    jaxtyping.config.update("jaxtyping_disable", True)
    try:
        yield
    finally:
        jaxtyping.config.update("jaxtyping_disable", False)

"""Context without run-time type checks, which take longer than the fits of many data sets. Single fits are checked."""

from contextlib import contextmanager

import jaxtyping


@contextmanager
def unchecked():
    jaxtyping.config.update("jaxtyping_disable", True)
    try:
        yield
    finally:
        jaxtyping.config.update("jaxtyping_disable", False)

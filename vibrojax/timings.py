"""How long parts of a work take, and what was chosen for it: told to the logger `vibrojax`.

`--verbose` shows it on stderr; in Python, `logging.basicConfig(level=logging.INFO)` does.
"""

import logging
import time
from collections.abc import Iterator
from contextlib import contextmanager

LOG = logging.getLogger("vibrojax")


@contextmanager
def timed(what: str) -> Iterator[None]:
    """Tell how many seconds `what` took, once it is done."""
    began = time.monotonic()
    yield
    LOG.info("%s: %.2f s", what, time.monotonic() - began)

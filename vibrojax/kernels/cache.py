"""Compiled kernels, kept in the user's cache folder from one run to the next.

A file that is damaged, or a folder that cannot be used, costs the time to compile again and nothing else.
"""

import os
import tempfile
import time
from contextlib import suppress
from hashlib import sha256
from pathlib import Path

from platformdirs import user_cache_path

VARIABLE = "VIBROJAX_CACHE"
"""Of the environment: another folder, or "off"."""

OFF = ("off", "0", "no", "none")

KEPT_BYTES, KEPT_DAYS = 100e6, 90
"""What was not used for so long is dropped, and what was used longest ago where all together is larger."""

DIGEST = sha256().digest_size


def folder() -> Path | None:
    """Where kernels are kept; None where they are not."""
    chosen = os.environ.get(VARIABLE, "")
    if chosen.lower() in OFF:
        return None
    return (Path(chosen).expanduser() if chosen else user_cache_path("vibrojax", appauthor=False)) / "kernels"


def read(key: str) -> bytes | None:
    """The code that was kept under a key, or None."""
    where = folder()
    if where is None:
        return None
    file = where / key
    try:
        content = file.read_bytes()
    except OSError:
        return None
    digest, code = content[:DIGEST], content[DIGEST:]
    if sha256(code).digest() != digest:
        with suppress(OSError):
            file.unlink()
        return None
    with suppress(OSError):
        os.utime(file)  # it was of use today
    return code


def write(key: str, code: bytes) -> None:
    """Keep code under a key, whole or not at all; drop what is old."""
    where = folder()
    if where is None:
        return
    with suppress(OSError):
        where.mkdir(mode=0o700, parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=where, prefix=".")
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(sha256(code).digest() + code)
            os.replace(temporary, where / key)
        except BaseException:
            os.unlink(temporary)
            raise
        _drop_old(where)


def _drop_old(where: Path) -> None:
    """Files not used for long, and those used longest ago where there are too many; what a kill left behind too."""
    files = sorted(((file.stat(), file) for file in where.iterdir()), key=lambda each: -each[0].st_mtime)
    total = 0
    for about, file in files:
        total += about.st_size
        old = time.time() - about.st_mtime > (86400 * KEPT_DAYS if file.name[0] != "." else 3600)
        if old or total > KEPT_BYTES:
            with suppress(OSError):
                file.unlink()

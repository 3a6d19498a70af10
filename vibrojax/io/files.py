"""Files that are opened with care, free memory, sizes and times as text, and the provenance of results."""

import errno
import os
import re
import stat
import warnings
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import BinaryIO

from vibrojax.errors import InputError, nearest, shown

LARGEST = 512 * 2**20
"""Greatest size of a text file [bytes], a log of ten million rows or so."""

_NOT_TEXT = re.compile(rb"[\x00-\x08\x0e-\x1f]|\A(\xff\xfe|\xfe\xff)")  # control characters, or UTF-16


def memory() -> float | None:
    """Return the memory available to this process [bytes], or None if it is unknown."""
    try:
        total = float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    except (AttributeError, ValueError, OSError):
        return None
    try:  # a container may have less
        return min(total, float(Path("/sys/fs/cgroup/memory.max").read_text()))
    except (OSError, ValueError):
        return total


def new_file(path: Path) -> BinaryIO:
    """Open a new file for writing, in place of what is at `path`; no link there is followed."""
    path.unlink(missing_ok=True)
    return os.fdopen(os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY | os.O_NOFOLLOW, 0o666), "wb")


def read_regular(path: Path, most: int = LARGEST) -> bytes:
    """Return the content of a regular file of at most `most` bytes.

    Devices, pipes and sockets are refused: they may have no end, or never begin.

    **Raises:** `OSError` if the file cannot be opened; `InputError` for another kind of file, or a larger one.
    """
    handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    try:
        kind = os.fstat(handle).st_mode
        if stat.S_ISDIR(kind):
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
        if not stat.S_ISREG(kind):
            raise InputError(f"{path}: is a device or a pipe; give the path of a file")
        content = bytearray()
        # In pieces: one read of the limit would allocate the limit, and files in /proc say that they are empty.
        with open(handle, "rb", closefd=False) as file:
            while len(content) <= most and (piece := file.read(2**20)):
                content += piece
    finally:
        os.close(handle)
    if len(content) > most:
        raise InputError(f"{path}: is larger than {most // 2**20} MiB; give a part of it, or a dataset (.nc)")
    return bytes(content)


def read_text(path: Path, windows: bool = False) -> str:
    """Return the text of a file that the user specified, without a byte order mark.

    `windows`: whether the file may be in Windows-1252, as exports of older software are; a warning then says so.

    **Raises:** `InputError` if the file cannot be read.
    """
    content = b""
    try:
        content = read_regular(path)
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        if windows and not _NOT_TEXT.search(content):
            warnings.warn(f"{path}: not UTF-8 (byte {error.start}), read as Windows-1252", stacklevel=2)
            return content.decode("cp1252", "replace")
        if content.startswith((b"\x89HDF", b"CDF")):
            raise InputError(f"{path}: is a dataset, not text; vibrojax info says what it holds") from None
        is_utf16 = content.startswith((b"\xff\xfe", b"\xfe\xff"))
        fault = "UTF-16 text" if is_utf16 else f"not UTF-8 text (byte {error.start})"
        raise InputError(f"{path}: {fault}; save it as UTF-8") from None
    except FileNotFoundError:
        similar = [other.name for other in path.parent.glob(f"*{path.suffix}")] if path.parent.is_dir() else []
        best = nearest(path.name, similar)
        hint = f" (did you mean {shown(best)}?)" if best else ""
        raise InputError(f"{path}: no such file; give the path of one that is there{hint}") from None
    except IsADirectoryError:
        raise InputError(f"{path}: is a folder; give the path of a file") from None
    except InputError:
        raise
    except (OSError, ValueError) as error:  # ValueError: the path contains a null character
        raise InputError(f"{path}: cannot be read ({getattr(error, 'strerror', None) or error})") from None


def size_text(size: int | float) -> str:
    """Return a size in bytes as a string, such as `1.5 GB`."""
    for unit in ("B", "kB", "MB", "GB"):
        if size < 999.5:
            return f"{size:.3g} {unit}"
        size /= 1000
    return f"{size:,.0f} TB" if 1000 <= size < 1e9 else f"{size:.3g} TB"


def time_text(seconds: int | float) -> str:
    """Return a time in seconds as a string, such as `2.5 h`."""
    for unit, length in (("days", 86400), ("h", 3600), ("min", 60)):
        amount = seconds / length
        if amount >= 2:
            return f"{amount:,.0f} {unit}" if 1000 <= amount < 1e6 else f"{amount:.3g} {unit}"
    return f"{seconds:.3g} s"


@cache
def package_version(package: str = "vibrojax") -> str:
    """Return the installed version of a package, or "0+unknown" if it is not installed."""
    try:
        return version(package)  # searches the folders of all packages each time
    except PackageNotFoundError:
        return "0+unknown"


def source() -> str:
    """Return the value of the dataset attribute `source`: package name and version."""
    return f"vibrojax {package_version()}"


def provenance() -> dict[str, str]:
    """Return the attributes that state the origin of a dataset: `source` (name and version) and `jax` (version)."""
    return {"source": source(), "jax": package_version("jax")}  # the last digits of results depend on jax's compiler

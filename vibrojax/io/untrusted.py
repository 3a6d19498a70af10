"""Reading of datasets of unknown origin in a process of its own, which damage and hostile content cannot outlive.

In this process, HDF5 would hold its lock for good where a damaged file makes it loop, and every later file would wait.
The metadata of a Zarr store are checked before a library opens it, because they name code that decodes its chunks.
"""

import json
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import netCDF4

from vibrojax.errors import InputError, printable, shown
from vibrojax.io.files import read_regular
from vibrojax.io.seal import LARGEST_METADATA, METADATA, is_own
from vibrojax.threads import in_own_thread

LAZY_FROM = 256e6
"""Size of a dataset [bytes] above which its variables are read lazily."""

MOST_PACKED = 2000
"""Largest accepted ratio of dataset size to file size: zlib reaches 1000; a malicious file may claim any size."""

PROCESSOR_SECONDS, SLOWEST = 6.0, 2e7
"""Processor time for reading a file: a constant [s], plus the file size divided by `SLOWEST` [bytes/s]."""

_OVERLOAD = 5.0
"""Ratio of elapsed time to processor time above which a file that does not end is given up."""

FORMAT_3 = "zarr.json"
"""Name of the files with the metadata of a Zarr store of format 3."""

TYPES = re.compile(r"[<>|][biufSU]\d+")
"""Types of values: booleans, integers, floats, and strings of fixed length."""

TEXT = ("|O", "vlen-utf8")
"""Type and filter of strings of variable length."""

COMPRESSORS = ("blosc", "zstd", "zlib", "gzip", "bz2", "lz4")
"""Compressors that only decompress; others may run code."""

_SCRIPT = Path(__file__).with_name("untrusted_copy.py")


@contextmanager
def readable(path: Path) -> Iterator[Path]:
    """Yield the path from which this process may read a dataset: `path` if the user's seal is intact, else a copy.

    The copy lasts as long as the `with` block. Of a dataset above `LAZY_FROM`, the first and last values are tried, and
    `path` is returned.

    **Raises:** `InputError` if the dataset is damaged, refers to other files, or takes too much time or memory.
    """
    if path.is_dir():
        check_store(path)
    if in_own_thread(lambda: is_own(path)):
        yield path
        return
    with TemporaryDirectory(prefix="vibrojax-") as folder:
        copy = Path(folder) / f"copy{path.suffix}"
        yield copy if in_own_thread(lambda: _copied(path, copy)) else path


def global_attributes(path: Path) -> dict[str, Any]:
    """Return the attributes of a dataset in a file or store.

    **Raises:** `InputError` if no dataset is there, or it cannot be read.
    """
    if not path.exists() or not (path.is_file() or path.is_dir()):
        raise InputError(f"{path}: is not a dataset")
    try:
        with readable(path) as source:
            if source.is_dir():
                attributes = json.loads(read_regular(source / ".zattrs", LARGEST_METADATA))
                return attributes if isinstance(attributes, dict) else {}

            def read() -> dict[str, Any]:
                with netCDF4.Dataset(source) as dataset:
                    return {name: dataset.getncattr(name) for name in dataset.ncattrs()}

            return in_own_thread(read)
    except (OSError, ValueError, AttributeError, RecursionError) as error:
        raise InputError(f"{path}: its attributes cannot be read ({type(error).__name__})") from None


def _copied(path: Path, copy: Path) -> bool:
    """Copy a dataset; return False if it is too large to be copied."""
    kind = "as Zarr" if path.is_dir() else "as netCDF"
    size = sum(file.stat().st_size for file in path.rglob("*")) if path.is_dir() else path.stat().st_size
    seconds = PROCESSOR_SECONDS + size / SLOWEST
    limits = (f"{LAZY_FROM:g}", str(MOST_PACKED), f"{seconds:.0f}")
    words = [sys.executable, "-P", str(_SCRIPT), str(path.absolute()), str(copy), *limits]
    try:
        ended = subprocess.run(
            words, stdin=subprocess.DEVNULL, capture_output=True, check=False, timeout=_OVERLOAD * seconds
        )
        answer = json.loads(ended.stdout.splitlines()[-1])
    except (subprocess.TimeoutExpired, IndexError, ValueError):  # killed by a limit, or by what it read
        why = f"its structure is damaged, or this machine is overloaded; the limit is {seconds:.0f} s"
        raise InputError(f"{path}: cannot be read {kind}: {why}") from None
    if problem := answer.get("problem"):
        raise InputError(f"{path}: cannot be read {kind} ({printable(problem, 200)})")
    return not answer["large"]


def check_store(path: Path) -> None:
    """Raise `InputError` if a store is not of format 2, or has types, codecs or links that this package never writes.

    Of other codecs, some run code that the store contains (pickle).
    """
    for file in path.rglob("*"):
        if file.is_symlink() or not (file.is_file() or file.is_dir()):
            raise InputError(f"{path}: {shown(file.name)} is a link or a device; a store has files and folders only")
        if file.name == FORMAT_3:
            raise InputError(f"{path}: is a Zarr store of format 3; write it with zarr_format=2")
    try:
        entries = json.loads(read_regular(path / METADATA, LARGEST_METADATA))["metadata"].items()
        arrays = {key.removesuffix("/.zarray"): {**about} for key, about in entries if key.endswith(".zarray")}
    except InputError:
        raise
    except FileNotFoundError:
        raise InputError(f"{path}: has no file {METADATA}; give a store that this package wrote") from None
    except (OSError, ValueError, LookupError, AttributeError, TypeError, RecursionError):
        raise InputError(f"{path}: its metadata are damaged") from None
    for name, about in arrays.items():
        filters, compressor = about.get("filters") or [], about.get("compressor")
        codecs = [codec.get("id") if isinstance(codec, dict) else codec for codec in filters]
        used = compressor.get("id") if isinstance(compressor, dict) else compressor
        is_text, dtype, what = (about.get("dtype"), *codecs) == TEXT, str(about.get("dtype")), ""
        if not is_text and not TYPES.fullmatch(dtype):
            what = f"values of the type {shown(dtype)}; datasets hold numbers and text"
        elif codecs and not is_text:
            what = f"the filter {shown(codecs[0])}, which is not accepted"
        elif used is not None and used not in COMPRESSORS:
            what = f"the compressor {shown(used)}; accepted are {', '.join(COMPRESSORS)}"
        elif not name or "/" in name or name.startswith("."):
            what = "a name that is no variable's"
        if what:
            raise InputError(f"{path}: {shown(name)} has {what}")

"""Checks of a Zarr store from any source, before a library opens it: the metadata name code that decodes the chunks."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from vibrojax.errors import InputError, shown
from vibrojax.io.files import read_regular

METADATA, FORMAT_3 = ".zmetadata", "zarr.json"
"""Names of the file with all metadata of a store of format 2, and of the files of a store of format 3."""

LARGEST_METADATA = 64 * 2**20
"""Greatest size of the metadata [bytes]."""

TYPES = re.compile(r"[<>|][biufSU]\d+")
"""Types of values: booleans, integers, floats, and strings of fixed length."""

TEXT = ("|O", "vlen-utf8")
"""Type and filter of strings of variable length."""

COMPRESSORS = ("blosc", "zstd", "zlib", "gzip", "bz2", "lz4")
"""Compressors that only decompress; others may run code."""


def check_store(path: Path) -> None:
    """Raise `InputError` if a store is not of format 2, or has types, codecs or links that this package never writes.

    Of other codecs, some run code that the store contains (pickle).
    """
    for file in path.rglob("*"):
        if file.is_symlink() or not (file.is_file() or file.is_dir()):
            raise InputError(f"{path}: {shown(file.name)} is a link or a device; a store has files and folders only")
        if file.name == FORMAT_3:
            raise InputError(f"{path}: is a Zarr store of format 3; datasets of this package have format 2")
    try:
        arrays = dict(_arrays(json.loads(read_regular(path / METADATA, LARGEST_METADATA))))
    except InputError:
        raise
    except FileNotFoundError:
        raise InputError(f"{path}: has no file {METADATA}; give a store that this package wrote") from None
    except (OSError, ValueError, AttributeError, TypeError, RecursionError):
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


def _arrays(metadata: Any) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the name and the metadata of each array."""
    for key, about in metadata["metadata"].items():
        if key.endswith(".zarray"):
            yield key.removesuffix("/.zarray"), {**about}

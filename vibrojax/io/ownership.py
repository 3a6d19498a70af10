"""Files that this package may replace: only those that say in themselves that it wrote them.

Pictures say so in their metadata, pages and tables in an element that is not shown, and datasets in their attributes.
"""

import json
import re
from pathlib import Path

from vibrojax.errors import InputError, shown
from vibrojax.io.files import read_regular
from vibrojax.io.provenance import source
from vibrojax.io.seal import has_seal
from vibrojax.io.store import LARGEST_METADATA
from vibrojax.io.untrusted import global_attributes

MARK = "vibrojax"
"""Prefix of the attribute `source` of every dataset that this package writes."""

GENERATOR = f'<meta name="generator" content="{MARK} '
"""Beginning of the element of a page that names the program that wrote it."""

PICTURE_KEYS = {".png": "Software", ".pdf": "Creator", ".svg": "Creator"}
"""Key of a picture's metadata that names the program that wrote it, by the suffix of the file."""

_MARKS = {
    ".png": re.compile(rb"\A\x89PNG.*?Software\0vibrojax ", re.DOTALL),
    ".pdf": re.compile(rb"\A%PDF.*/Creator \(vibrojax ", re.DOTALL),
    ".svg": re.compile(rb"<dc:creator>\s*<cc:Agent>\s*<dc:title>vibrojax "),
    ".html": re.compile(re.escape(GENERATOR.encode())),
    ".md": re.compile(rb"<!-- vibrojax [^>]*-->\n\Z"),
}
"""Mark of each kind of file other than datasets."""

_IN_STORE = re.compile(r"\.zgroup|\.zattrs|\.zmetadata|\.zarray|\d+(\.\d+)*")
"""Names of the files of a store: metadata and chunks."""


def text_mark() -> str:
    """Return a line that marks a table in Markdown, and that no reader sees."""
    return f"<!-- {source()} -->\n"


def check_ours(path: Path) -> None:
    """Raise `InputError` if there is a file or folder at `path` that this package has not written."""
    if not path.exists() or (path.is_file() and path.stat().st_size == 0):
        return
    advice = "give another name, or remove it"
    if path.is_dir():
        for file in path.rglob("*"):
            if file.is_symlink() or not (file.is_dir() or _IN_STORE.fullmatch(file.name)):
                name = shown(file.relative_to(path).as_posix())
                raise InputError(f"{path}: holds {name}, which is not of a dataset; {advice}")
    if not _says_so(path):
        raise InputError(f"{path}: exists already, and does not say that {MARK} wrote it; {advice}")


def _says_so(path: Path) -> bool:
    mark = _MARKS.get(path.suffix.lower())
    try:
        if path.is_dir():
            attributes = json.loads(read_regular(path / ".zattrs", LARGEST_METADATA))
            return isinstance(attributes, dict) and str(attributes.get("source", "")).startswith(MARK)
        if mark is not None:
            return mark.search(read_regular(path)) is not None
        if has_seal(path):
            return True
        return str(global_attributes(path).get("source", "")).startswith(MARK)
    except (InputError, OSError, ValueError, RecursionError):
        return False

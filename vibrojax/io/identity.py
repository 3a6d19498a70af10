"""Marks of files that this package wrote, and identities of results, which decide whether a file may be replaced.

Pictures say in their metadata that this package wrote them, pages and tables in an element that is not shown, datasets
in their attributes. An identity is everything on which results depend, as a manifest of chunks or an attribute of a
dataset. If the manifest differs, the chunks belong to another sweep and are rejected.
"""

import hashlib
import json
import re
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from vibrojax.errors import InputError, shown
from vibrojax.io.files import read_regular, source
from vibrojax.io.trust import LARGEST_METADATA, global_attributes, seal_of

MARK = "vibrojax"
"""Prefix of the attribute `source` of every dataset that this package writes."""

GENERATOR = f'<meta name="generator" content="{MARK} '
"""Beginning of the element of a page that names the program that wrote it."""

PICTURE_KEYS = {".png": "Software", ".pdf": "Creator", ".svg": "Creator"}
"""Key of a picture's metadata that names the program that wrote it, by the suffix of the file."""

MARKED = {
    ".png": re.compile(rb"\A\x89PNG.*?Software\0vibrojax ", re.DOTALL),
    ".pdf": re.compile(rb"\A%PDF.*/Creator \(vibrojax ", re.DOTALL),
    ".svg": re.compile(rb"<dc:creator>\s*<cc:Agent>\s*<dc:title>vibrojax "),
    ".html": re.compile(re.escape(GENERATOR.encode())),
    ".md": re.compile(rb"<!-- vibrojax [^>]*-->\n\Z"),
}
"""Mark of each kind of file other than datasets, by suffix."""

_IN_STORE = re.compile(r"\.zgroup|\.zattrs|\.zmetadata|\.zarray|\d+(\.\d+)*")
"""Names of the files of a store: metadata and chunks."""


IDENTITY = "identity"
"""Name of the attribute that holds, as JSON, everything that a result depends on. Runs with equal identities compute
the same result."""

_CHANGES_SHOWN = 3

_DIGEST = re.compile(r"(?:(.*), )?sha256 [0-9a-f]+")
"""Value of a manifest that a digest represents, with an optional text before it: a column's size and range, a file."""

_COLUMN = re.compile(r"\d+ (?:values|names)\b.*")


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
    mark, says_so = MARKED.get(path.suffix.lower()), False
    with suppress(InputError, OSError, ValueError, RecursionError):
        if path.is_dir():
            attributes = json.loads(read_regular(path / ".zattrs", LARGEST_METADATA))
            says_so = isinstance(attributes, dict) and str(attributes.get("source", "")).startswith(MARK)
        elif mark is not None:
            says_so = mark.search(read_regular(path)) is not None
        else:
            says_so = seal_of(path) is not None or str(global_attributes(path).get("source", "")).startswith(MARK)
    if not says_so:
        raise InputError(f"{path}: exists already, and does not say that {MARK} wrote it; {advice}")


def canonical(values: Mapping[str, object]) -> bytes:
    """Return a manifest as JSON with sorted keys: equal manifests give equal bytes."""
    return json.dumps(values, sort_keys=True, separators=(",", ":"), allow_nan=False).encode()


def digest(values: Mapping[str, object]) -> str:
    """Return the SHA-256 of a manifest."""
    return hashlib.sha256(canonical(values)).hexdigest()


def changes(before: Mapping[str, object], now: Mapping[str, object]) -> str:
    """Describe the differences between everything two results depend on; "" if there are none."""

    def text(values: Mapping[str, object], name: str) -> str:
        digested = _DIGEST.fullmatch(str(values.get(name)))
        known = (digested[1] or "there") if digested else " ".join(shown(values.get(name)).split())
        return known if name in values else "not there"

    names = [name for name in {**before, **now} if before.get(name, ...) != now.get(name, ...)]
    differences = []
    for name in names[:_CHANGES_SHOWN]:
        was, becomes = text(before, name), text(now, name)
        if was != becomes:
            differences.append(f"{name} was {was}, is {becomes}")
        elif _COLUMN.fullmatch(was):
            differences.append(f"the values of {name.rpartition('.')[2]} differ")
        else:
            file = f"that of another {was}, or before its change"
            differences.append(f"{name} has changed since" if was == "there" else file)
    more = f" and {len(names) - _CHANGES_SHOWN} more" if len(names) > _CHANGES_SHOWN else ""
    return "; ".join(differences) + more


def identity_text(identity: Mapping[str, object]) -> str:
    """Return an identity as the JSON string that the attribute stores."""
    return json.dumps(identity, sort_keys=True)


def stored_identity(out: Path) -> dict[str, object] | None:
    """Return the identity of the result at `out`, or None if there is no result that states its identity."""
    with suppress(InputError, KeyError, ValueError, RecursionError):
        stored = json.loads(str(global_attributes(out)[IDENTITY])) if out.exists() else None
        return stored if isinstance(stored, dict) else None
    return None


def holds(out: Path, identity: Mapping[str, object]) -> bool:
    """Return whether `out` is a result with this `identity`."""
    stored = stored_identity(out)
    return stored is not None and not changes(stored, json.loads(identity_text(identity)))


def check_replaceable(out: Path, identity: Mapping[str, object]) -> None:
    """Raise `InputError` if `out` exists and holds anything but a result with this `identity`."""
    check_ours(out)
    if not out.exists():
        return
    advice = "--fresh replaces it, or give another output with -o"
    if (stored := stored_identity(out)) is None:
        raise InputError(f"{out}: exists already, and does not say that it holds this result; {advice}")
    if differences := changes(stored, json.loads(identity_text(identity))):
        raise InputError(f"{out}: holds another result: {differences}; {advice}")

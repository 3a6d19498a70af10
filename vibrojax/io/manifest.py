"""The identity of results: everything that they depend on, as a manifest of chunks or an attribute of a dataset.

If the manifest differs, the chunks belong to another sweep and are rejected.
"""

import hashlib
import json
import re
from collections.abc import Mapping
from pathlib import Path

from vibrojax.errors import InputError, shown
from vibrojax.io.ownership import check_ours
from vibrojax.io.untrusted import global_attributes

MANIFEST = "manifest.json"
"""Name of the manifest file in a folder of chunks."""

_CHANGES_SHOWN = 3

_DIGEST = re.compile(r"(?:(.*), )?sha256 [0-9a-f]+")
"""Value of a manifest that a digest represents, with an optional text before it: a column's size and range, a file."""

_COLUMN = re.compile(r"\d+ (?:values|names)\b.*")


def canonical(values: Mapping[str, object]) -> bytes:
    """Return a manifest as JSON with sorted keys: equal manifests give equal bytes."""
    return json.dumps(values, sort_keys=True, separators=(",", ":"), allow_nan=False).encode()


def digest(values: Mapping[str, object]) -> str:
    """Return the SHA-256 of a manifest."""
    return hashlib.sha256(canonical(values)).hexdigest()


def is_manifest(path: Path) -> bool:
    """Return whether a file has the form of a manifest, intact or not."""
    try:
        stored = json.loads(path.read_bytes())
        return isinstance(stored, dict) and {"sha256", "manifest"} <= set(stored)
    except (OSError, ValueError, RecursionError):
        return False


def changes_since(path: Path, values: Mapping[str, object]) -> str:
    """Describe the differences from the manifest at `path`; "" if there are none or that manifest is damaged."""
    try:
        stored = json.loads(path.read_bytes())
        before = stored["manifest"]
        is_intact = isinstance(before, dict) and digest(before) == stored["sha256"]
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return ""
    return changes(before, values) if is_intact else ""


def changes(before: Mapping[str, object], now: Mapping[str, object]) -> str:
    """Describe the differences between everything two results depend on; "" if there are none."""

    def value(values: Mapping[str, object], name: str) -> str:
        if name not in values:
            return "not there"
        digested = _DIGEST.fullmatch(str(values[name]))
        return (digested[1] or "there") if digested else " ".join(shown(values[name]).split())

    def difference(name: str) -> str:
        texts = value(before, name), value(now, name)
        if texts[0] != texts[1]:
            return f"{name} was {texts[0]}, is {texts[1]}"
        if _COLUMN.fullmatch(texts[0]):
            return f"the values of {name.rpartition('.')[2]} differ"
        return f"{name if texts[0] == 'there' else texts[0]} has changed since"

    names = [name for name in {**before, **now} if before.get(name, ...) != now.get(name, ...)]
    texts = [difference(name) for name in names[:_CHANGES_SHOWN]]
    more = f" and {len(names) - _CHANGES_SHOWN} more" if len(names) > _CHANGES_SHOWN else ""
    return "; ".join(texts) + more


IDENTITY = "identity"
"""Name of the attribute that holds, as JSON, everything that a result depends on. Runs with equal identities compute
the same result."""


def identity_text(identity: Mapping[str, object]) -> str:
    """Return an identity as the JSON string that the attribute stores."""
    return json.dumps(identity, sort_keys=True)


def holds(out: Path, identity: Mapping[str, object]) -> bool:
    """Return whether `out` is a result with this `identity`."""
    stored = stored_identity(out)
    return stored is not None and not changes(stored, json.loads(identity_text(identity)))


def check_replaceable(out: Path, identity: Mapping[str, object]) -> None:
    """Raise `InputError` if `out` exists and holds anything but a result with this `identity`."""
    check_ours(out)
    if not out.exists():
        return
    stored = stored_identity(out)
    advice = "--fresh replaces it, or give another output with -o"
    if stored is None:
        raise InputError(f"{out}: exists already, and does not say that it holds this result; {advice}")
    differences = changes(stored, json.loads(identity_text(identity)))
    if differences:
        raise InputError(f"{out}: holds another result: {differences}; {advice}")


def stored_identity(out: Path) -> dict[str, object] | None:
    """Return the identity of the result at `out`, or None if there is no result that states its identity."""
    try:
        stored = json.loads(str(global_attributes(out)[IDENTITY])) if out.exists() else None
    except (InputError, KeyError, ValueError, RecursionError):
        stored = None
    return stored if isinstance(stored, dict) else None

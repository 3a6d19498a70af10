"""The manifest of a sweep's chunks: everything that results depend on.

If the manifest differs, the chunks belong to another sweep and are rejected.
"""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path

from vibrojax.errors import shown

MANIFEST = "manifest.json"
"""Name of the manifest file in a folder of chunks."""

_CHANGES_SHOWN = 3


class Manifest:
    """Everything that results depend on: `values`, converted to JSON types, and `digest`, their SHA-256."""

    def __init__(self, values: Mapping[str, object]) -> None:
        self.values: dict[str, object] = json.loads(_canonical(values))
        self.digest = hashlib.sha256(_canonical(self.values)).hexdigest()

    def content(self, about: Mapping[str, object]) -> bytes:
        """Return the content of the manifest file, including `about`: further facts about the sweep."""
        return json.dumps({"sha256": self.digest, "manifest": self.values, "about": about}, indent=1).encode()

    def changes_since(self, path: Path) -> str:
        """Describe the differences from the manifest at `path`; "" if there are none or that manifest is damaged."""
        try:
            stored = json.loads(path.read_bytes())
            before = Manifest(stored["manifest"])
            intact = before.digest == stored["sha256"]
        except (OSError, ValueError, KeyError, TypeError, RecursionError):
            return ""
        return changes(before.values, self.values) if intact else ""


def changes(before: Mapping[str, object], now: Mapping[str, object]) -> str:
    """Describe the differences between everything two results depend on; "" if there are none."""

    def value(values: Mapping[str, object], name: str) -> str:
        return " ".join(shown(values[name]).split()) if name in values else "not there"

    names = [name for name in {**before, **now} if before.get(name, ...) != now.get(name, ...)]
    texts = [f"{name} was {value(before, name)}, is {value(now, name)}" for name in names[:_CHANGES_SHOWN]]
    more = f" and {len(names) - _CHANGES_SHOWN} more" if len(names) > _CHANGES_SHOWN else ""
    return "; ".join(texts) + more


def _canonical(values: Mapping[str, object]) -> bytes:
    return json.dumps(values, sort_keys=True, separators=(",", ":"), allow_nan=False).encode()

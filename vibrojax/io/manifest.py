"""What the results of a sweep depend on, as it lies beside them, so that those of something else are known."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path

from vibrojax.errors import shown

MANIFEST = "manifest.json"
"""The file's name in a folder of chunks."""

_CHANGES_SHOWN = 3


class Manifest:
    """All that results depend on: its `values`, as they are read back from JSON, and their SHA-256, `digest`."""

    def __init__(self, values: Mapping[str, object]) -> None:
        self.values: dict[str, object] = json.loads(_canonical(values))
        self.digest = _digest(self.values)

    def content(self, about: Mapping[str, object]) -> bytes:
        """What the file holds, with what else there is to tell."""
        return json.dumps({"sha256": self.digest, "manifest": self.values, "about": about}, indent=1).encode()

    def changes_since(self, path: Path) -> str:
        """Where it differs from the one at `path`, in words; empty where it does not, or no whole one is there."""
        try:
            stored = json.loads(path.read_bytes())
            other: dict[str, object] = dict(stored["manifest"])
            digest: object = stored["sha256"]
        except (OSError, ValueError, KeyError, TypeError):
            return ""
        return "" if digest == self.digest or _digest(other) != digest else changes(other, self.values)


def changes(before: Mapping[str, object], now: Mapping[str, object]) -> str:
    """Where what two results depend on differs, in words; empty where it does not."""
    names = [name for name in {**before, **now} if before.get(name, ...) != now.get(name, ...)]
    told = [f"{name} was {_entry(before, name)}, is {_entry(now, name)}" for name in names[:_CHANGES_SHOWN]]
    more = f" and {len(names) - _CHANGES_SHOWN} more" if len(names) > _CHANGES_SHOWN else ""
    return "; ".join(told) + more


def _digest(values: Mapping[str, object]) -> str:
    return hashlib.sha256(_canonical(values)).hexdigest()


def _canonical(values: Mapping[str, object]) -> bytes:
    return json.dumps(values, sort_keys=True, separators=(",", ":"), allow_nan=False).encode()


def _entry(values: Mapping[str, object], name: str) -> str:
    """A value, in words."""
    return " ".join(shown(values[name]).split()) if name in values else "not there"

"""A fingerprint of the package's sources, under which results of executed pages are cached."""

import hashlib
import os
from pathlib import Path

ROOT = Path(__file__).parents[2]
PACKAGE, GALLERY = ROOT / "vibrojax", ROOT / "notebooks" / "gallery"


def fingerprint() -> str:
    """Return a digest of the package's files, the gallery's scripts, and the size at which notebooks run."""
    digest = hashlib.sha256(os.environ.get("VIBROJAX_NOTEBOOK_VALUES", "").encode())
    for file in [*sorted(PACKAGE.rglob("*.py")), *sorted(GALLERY.glob("*.py"))]:
        digest.update(file.relative_to(ROOT).as_posix().encode())
        digest.update(file.read_bytes())
    return digest.hexdigest()[:12]

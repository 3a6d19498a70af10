"""Finished results on disk: one of something else is not replaced without being asked."""

import json
from collections.abc import Mapping
from pathlib import Path

import netCDF4

from vibrojax.errors import InputError
from vibrojax.io.atomic import ZARR
from vibrojax.io.manifest import changes
from vibrojax.io.threads import in_own_thread

IDENTITY = "identity"
"""The attribute that says what a result depends on, as JSON: equal where the same would be computed."""

_PATIENCE = 20.0
"""Seconds that reading the attributes of a damaged file may take."""


def identity_text(identity: Mapping[str, object]) -> str:
    """What the attribute holds."""
    return json.dumps(identity, sort_keys=True)


def check_replaceable(out: Path, identity: Mapping[str, object]) -> None:
    """Raise `InputError`, in one line, where `out` is there and holds anything but a result of this `identity`."""
    if not out.exists():
        return
    advice = "--fresh replaces it, or give another output with -o"
    found = _identity_of(out)
    if found is None:
        raise InputError(f"{out}: is there already, and does not say that it holds this result; {advice}")
    ours = json.loads(identity_text(identity))
    differing = changes(found, ours)
    if differing:
        raise InputError(f"{out}: holds another result: {differing}; {advice}")


def _identity_of(path: Path) -> dict[str, object] | None:
    """The identity that a dataset carries; None where it has none, or cannot be read."""

    def read() -> object:
        if path.suffix == ZARR:
            return json.loads(json.loads((path / ".zattrs").read_text())[IDENTITY])
        with netCDF4.Dataset(path) as dataset:
            return json.loads(dataset.getncattr(IDENTITY))

    try:
        found = in_own_thread(read, _PATIENCE) if path.is_file() or path.suffix == ZARR else None
    except Exception:  # whatever the library says of a file that is damaged, or none of ours
        return None
    return found if isinstance(found, dict) else None

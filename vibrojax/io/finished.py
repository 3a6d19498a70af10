"""Protection of finished results: a file with a different result is replaced only if the user requests it."""

import json
from collections.abc import Mapping
from pathlib import Path

import netCDF4

from vibrojax.errors import InputError
from vibrojax.io.atomic import ZARR
from vibrojax.io.manifest import changes
from vibrojax.io.threads import in_own_thread

IDENTITY = "identity"
"""Name of the attribute that holds, as JSON, everything that a result depends on. Runs with equal identities compute
the same result."""

_ATTRIBUTES_PATIENCE = 20.0
"""Time limit [s] for reading the attributes of a possibly damaged file."""


def identity_text(identity: Mapping[str, object]) -> str:
    """Return an identity as the JSON string that the attribute stores."""
    return json.dumps(identity, sort_keys=True)


def check_replaceable(out: Path, identity: Mapping[str, object]) -> None:
    """Raise `InputError` if `out` exists and holds anything but a result with this `identity`."""
    if not out.exists():
        return

    def read() -> object:
        if out.suffix == ZARR:
            import zarr

            return json.loads(str(zarr.open_group(out, mode="r").attrs[IDENTITY]))
        with netCDF4.Dataset(out) as dataset:
            return json.loads(dataset.getncattr(IDENTITY))

    try:
        stored = in_own_thread(read, _ATTRIBUTES_PATIENCE) if out.is_file() or out.suffix == ZARR else None
    except Exception:  # the libraries raise many types of exceptions on a damaged or foreign file
        stored = None
    advice = "--fresh replaces it, or give another output with -o"
    if not isinstance(stored, dict):
        raise InputError(f"{out}: exists already, and does not say that it holds this result; {advice}")
    differences = changes(stored, json.loads(identity_text(identity)))
    if differences:
        raise InputError(f"{out}: holds another result: {differences}; {advice}")

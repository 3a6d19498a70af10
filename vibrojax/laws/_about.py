"""What every fit says of itself: units, meanings, flags, and where it comes from."""

from collections.abc import Mapping
from datetime import UTC, datetime

import numpy as np
import xarray as xr

from vibrojax.errors import Place
from vibrojax.laws._group import REASONS
from vibrojax.store.provenance import source


def described(about: Mapping[str, tuple[str, str]]) -> dict[str, dict]:
    """CF attributes of each variable from its unit and meaning; those called reason have the flags `REASONS`."""
    flags = {"flag_values": np.arange(len(REASONS), dtype=np.int8), "flag_meanings": " ".join(REASONS)}
    return {
        name: {"units": unit, "long_name": meaning} | (flags if name.endswith("reason") else {})
        for name, (unit, meaning) in about.items()
    }


def law_title(place: Place, data: xr.Dataset) -> str:
    """The title of a fit of the rate-of-penetration law."""
    return f"rate-of-penetration law: {data.attrs.get('title') or place.file}"


def provenance(place: Place, data: xr.Dataset, what: str, title: str, more: dict) -> dict:
    """The attributes of a fit: where it comes from, and what of its data still holds."""
    kept = {name: data.attrs[name] for name in ("scene", "sweep", "parameters") if name in data.attrs}
    now = f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ} {what} {place.file}"
    earlier = [str(data.attrs["history"])] if "history" in data.attrs else []
    return {
        "title": title,
        "source": source(),
        "history": "\n".join([now, *earlier]),
        "Conventions": "CF-1.11",
        **kept,
        **more,
    }

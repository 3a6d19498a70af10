"""Flags of a variable as stated by its CF attributes: values, meanings and counts."""

import numpy as np
import xarray as xr

from vibrojax.errors import printable

LONGEST_MEANING = 60
"""Maximum number of displayed characters of a flag's meaning: more would misalign the columns of a summary."""


def flags(variable: xr.DataArray) -> dict[int, str]:
    """Return a dict from the value of each flag to its meaning, empty if the variable has no flags."""
    values = np.atleast_1d(variable.attrs.get("flag_values", [])).tolist()
    meanings = str(variable.attrs.get("flag_meanings", "")).split()
    return {value: printable(meaning, LONGEST_MEANING) for value, meaning in zip(values, meanings, strict=False)}


def flag_counts(ds: xr.Dataset, name: str) -> dict[str, int]:
    """Return the number of values with each flag of variable `name`, keyed by meaning.

    Flags without any value are left out. The dict is empty if the variable is missing.
    """
    if name not in ds:
        return {}
    values = ds[name].values
    counts = {meaning: int((values == flag).sum()) for flag, meaning in flags(ds[name]).items()}
    return {meaning: count for meaning, count in counts.items() if count}

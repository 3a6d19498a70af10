"""Flags of a variable by their CF attributes: values, meanings and counts."""

import numpy as np
import xarray as xr

from vibrojax.errors import printable

LONGEST_MEANING = 60
"""Characters of a flag's meaning that are shown: more would break the columns of a summary."""


def flags(variable: xr.DataArray) -> dict[int, str]:
    """Return the meaning of each flag by its value; an empty dict if the variable has no flags."""
    values = np.atleast_1d(variable.attrs.get("flag_values", [])).tolist()
    meanings = str(variable.attrs.get("flag_meanings", "")).split()
    return {value: printable(meaning, LONGEST_MEANING) for value, meaning in zip(values, meanings, strict=False)}


def flag_counts(ds: xr.Dataset, name: str) -> dict[str, int]:
    """Return how many values of variable `name` have each flag, without flags that none has; empty if it is missing."""
    if name not in ds:
        return {}
    values = ds[name].values
    counts = {meaning: int((values == flag).sum()) for flag, meaning in flags(ds[name]).items()}
    return {meaning: count for meaning, count in counts.items() if count}

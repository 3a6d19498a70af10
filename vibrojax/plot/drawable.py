"""The texts of a dataset as a picture can draw them: a dataset may come from anywhere."""

import re

import numpy as np
import xarray as xr

from vibrojax.errors import printable
from vibrojax.io.attributes import title_of

_LONGEST = {"long_name": 200, "units": 40, "symbol": 40}
"""Characters of a variable's attributes that are drawn."""

_LONGEST_NAME = 100
_DRAWN = ("scene", "friction", "start")
_DOLLAR = re.compile(r"(?<!\\)\$")


def drawable(ds: xr.Dataset) -> xr.Dataset:
    """Return the dataset with texts on one line, shortened, in which no part is mathematical notation."""
    ds = ds.copy(deep=False)
    if "title" in ds.attrs:
        ds.attrs["title"] = plain(title_of(ds))
    for name in _DRAWN:
        if name in ds.attrs:
            ds.attrs[name] = plain(printable(ds.attrs[name], _LONGEST_NAME))
    for variable, data in ds.variables.items():
        texts = {key: plain(printable(data.attrs[key], most)) for key, most in _LONGEST.items() if key in data.attrs}
        data.attrs.update(texts)
        if data.dtype.kind in "UO" and data.size:
            known = {one: plain(printable(one, _LONGEST_NAME)) for one in set(data.values.ravel().tolist())}
            if any(known[one] != one for one in known):
                values = np.vectorize(known.__getitem__, otypes=[object])(data.values).astype(str)
                ds = ds.assign({variable: (data.dims, values, data.attrs)})
    return ds


def plain(text: str) -> str:
    """Return the text with its dollars escaped, between which matplotlib looks for formulas."""
    return _DOLLAR.sub(r"\\$", text)

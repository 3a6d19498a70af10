"""Mutated datasets: random changes of content and structure."""

import random
from pathlib import Path

import numpy as np
import xarray as xr

import vibrojax as vj

ODD_VALUES = ("text " * 3000, "[1, null]", '{"a": 1e999}', "days since 0001-01-01", 2**62, float("nan"), ["a", "b"])
ODD_NUMBERS = {"f": [np.nan, np.inf, 1e308, 1e-320, 1e99], "i": [-128, 127, 0, 7], "u": [0, 1, 7]}
NAMES = ("__proto__", "x" * 150, "time", "start", "kind", "curve", "share", "special_kind", "region_area", "event_time")


def any_name(rng: random.Random, ds: xr.Dataset) -> str:
    return rng.choice([str(name) for name in ds.variables])


def drop(rng: random.Random, ds: xr.Dataset) -> xr.Dataset:
    attributes = rng.choice([ds.attrs, ds[any_name(rng, ds)].attrs])
    for name in rng.sample(sorted(attributes), min(len(attributes), rng.randint(0, 4))):
        if name != "source":
            del attributes[name]
    return ds.drop_vars(any_name(rng, ds)) if rng.random() < 0.5 else ds


def change_attribute(rng: random.Random, ds: xr.Dataset) -> xr.Dataset:
    attributes = ds.attrs if rng.random() < 0.2 else ds[any_name(rng, ds)].attrs
    names = [name for name in attributes if name != "source"]
    names += ["units", "flag_values", "flag_meanings", "scale_factor", "add_offset", "kind", "axes", "along", "form"]
    attributes[rng.choice(names)] = rng.choice(ODD_VALUES)
    return ds


def change_values(rng: random.Random, ds: xr.Dataset) -> xr.Dataset:
    """Change half of the values of a variable, or its type."""
    name = any_name(rng, ds)
    old = ds[name]
    values = old.values.astype(old.dtype if old.dtype.kind in ODD_NUMBERS else object)
    odd = ODD_NUMBERS.get(old.dtype.kind, ["", "x" * 300, "a\nb", "$\\frac{$"])
    for index in np.flatnonzero([rng.random() < 0.5 for _ in range(values.size)]):
        values.reshape(-1)[index] = rng.choice(odd)
    if old.dtype.kind in ODD_NUMBERS and rng.random() < 0.3:
        with np.errstate(all="ignore"):
            values = values.astype(rng.choice(["float32", "int8", "U5", "bool"]))
    place = ds.assign_coords if name in ds.coords else ds.assign
    return place({name: (old.dims, values, old.attrs)})


def change_dimension(rng: random.Random, ds: xr.Dataset) -> xr.Dataset:
    name = rng.choice(sorted(map(str, ds.sizes)) or [""])
    changes = [
        lambda: ds.isel({name: slice(rng.choice([0, 1]))}),
        lambda: ds.isel({name: np.arange(rng.choice([50, 3000])) % max(1, ds.sizes[name])}),
        lambda: ds.rename({name: rng.choice([other for other in NAMES if other not in ds.variables])}),
        lambda: ds.drop_vars(name, errors="ignore"),
    ]
    return rng.choice(changes)() if name else ds


CHANGES = (drop, change_attribute, change_values, change_values, change_dimension, change_dimension)


def write_mutant(seed: int, samples: list[Path], path: Path) -> str:
    """Write a mutant without a seal to `path`, from one of the datasets `samples`; return a description."""
    rng = random.Random(seed)
    original = rng.choice(samples)
    ds, names = vj.open_dataset(original).drop_encoding(), []
    ds.attrs.pop("sweep", None)  # it is not run again for a page
    for change in rng.sample(CHANGES, rng.randint(1, 2)):
        names.append(change.__name__)
        ds = change(rng, ds)
    try:
        ds.to_netcdf(path)
    except (ValueError, TypeError, AttributeError, RuntimeError, KeyError):  # netCDF has no such value
        path.write_bytes(original.read_bytes()[: rng.randrange(10_000)])
    return f"{seed}: {original.stem}, {', '.join(names)}"

"""Mutated datasets: random changes of content and structure, and random damage to the bytes of a file."""

import random
from collections.abc import Callable
from pathlib import Path

import numpy as np
import xarray as xr

import vibrojax as vj

ODD_VALUES: tuple[object, ...] = (
    "",
    "text " * 3000,
    "{}",
    "[1, null]",
    '{"a": 1e999}',
    "days since 0001-01-01",
    -1,
    0,
    2**62,
    1e308,
    float("nan"),
    np.array([1.5, np.inf]),
    np.array([], np.int8),
    np.arange(200, dtype=np.int64),
    ["a", "b"],
)
"""Values that an attribute may have in a file."""

DTYPES = ("float32", "float64", "int8", "int64", "uint16", "U5", "S3", "bool")
NAMES = ("__proto__", "x" * 150, "time", "start", "kind", "curve", "share", "special_kind", "region_area", "event_time")

Change = Callable[[random.Random, xr.Dataset], xr.Dataset]


def _any(rng: random.Random, ds: xr.Dataset) -> str:
    return rng.choice([str(name) for name in ds.variables])


def _with(ds: xr.Dataset, name: str, data: xr.Variable) -> xr.Dataset:
    data.attrs.update({key: value for key, value in ds[name].attrs.items() if key not in data.attrs})
    place = ds.assign_coords if name in ds.coords else ds.assign
    return place({name: (data.dims, data.values, data.attrs)})


def drop_variable(rng: random.Random, ds: xr.Dataset) -> xr.Dataset:
    return ds.drop_vars(_any(rng, ds))


def drop_attribute(rng: random.Random, ds: xr.Dataset) -> xr.Dataset:
    attributes = rng.choice([ds.attrs, ds[_any(rng, ds)].attrs])
    for name in rng.sample(sorted(attributes), min(len(attributes), rng.randint(1, 4))):
        if name != "source":
            del attributes[name]
    return ds


def change_attribute(rng: random.Random, ds: xr.Dataset) -> xr.Dataset:
    attributes = ds.attrs if rng.random() < 0.2 else ds[_any(rng, ds)].attrs
    names = [name for name in attributes if name != "source"]
    names += ["units", "flag_values", "flag_meanings", "scale_factor", "add_offset", "kind", "axes", "along", "form"]
    attributes[rng.choice(names)] = rng.choice(ODD_VALUES)
    return ds


def change_dtype(rng: random.Random, ds: xr.Dataset) -> xr.Dataset:
    name = _any(rng, ds)
    with np.errstate(all="ignore"):
        try:
            return _with(ds, name, ds[name].variable.astype(rng.choice(DTYPES)))
        except ValueError:  # a text that is no number
            return ds.drop_vars(name)


def change_values(rng: random.Random, ds: xr.Dataset) -> xr.Dataset:
    name = _any(rng, ds)
    values = ds[name].values.copy()
    if values.dtype.kind == "f":
        odd = [np.nan, np.inf, -np.inf, 1e308, -1e308, 1e-320, 0.0, 1e99]
    elif values.dtype.kind in "iu":
        odd = [np.iinfo(values.dtype).min, np.iinfo(values.dtype).max, 0, 1, 7]
    else:
        odd = ["", "x" * 300, "a\nb", "$\\frac{$"]
        values = values.astype(object)
    flat = values.reshape(-1)
    share = rng.choice([0.1, 0.5, 1.0])
    for index in range(flat.size):
        if rng.random() < share:
            flat[index] = rng.choice(odd)
    return _with(ds, name, xr.Variable(ds[name].dims, values))


def change_dimension(rng: random.Random, ds: xr.Dataset) -> xr.Dataset:
    if not ds.sizes:
        return ds
    name = rng.choice(sorted(map(str, ds.sizes)))
    kind = rng.choice(["none", "one", "many", "reversed", "renamed", "no coordinate", "transposed"])
    if kind == "many":
        return ds.isel({name: np.arange(rng.choice([50, 3000])) % max(1, ds.sizes[name])})
    if kind == "reversed":
        return ds.isel({name: slice(None, None, -1)})
    if kind == "renamed":
        return ds.rename({name: rng.choice([other for other in NAMES if other not in ds.variables])})
    if kind == "no coordinate":
        return ds.drop_vars(name, errors="ignore")
    if kind == "transposed":
        return ds.transpose()
    return ds.isel({name: slice(0 if kind == "none" else 1)})


CHANGES: tuple[Change, ...] = (
    drop_variable,
    drop_attribute,
    change_attribute,
    change_attribute,
    change_dtype,
    change_values,
    change_values,
    change_dimension,
    change_dimension,
)


def damage(rng: random.Random, content: bytes) -> bytes:
    """Return the content of a file after flips, a block of other bytes, a cut, or an insertion."""
    changed, size = bytearray(content), len(content)
    position, length = rng.randrange(size), rng.choice([1, 16, 64, 512, 4096])
    kind = rng.choice(["flip", "flips", "zeros", "zeros", "ones", "cut", "insert", "repeat"])
    if kind in ("flip", "flips"):
        for _ in range(1 if kind == "flip" else 20):
            changed[rng.randrange(size)] ^= 1 << rng.randrange(8)
    elif kind in ("zeros", "ones"):
        changed[position : position + length] = (b"\0" if kind == "zeros" else b"\xff") * length
    elif kind == "cut":
        del changed[position:]
    elif kind == "insert":
        changed[position:position] = rng.randbytes(length)
    else:
        changed[position : position + length] = changed[:length]
    return bytes(changed)


def write_sources(samples: list[Path], folder: Path) -> list[Path]:
    """Write datasets without their sweeps, which are not run again for a page, and without seals."""
    paths = [folder / f"{sample.stem}.nc" for sample in samples]
    for sample, path in zip(samples, paths, strict=True):
        ds = vj.open_dataset(sample)
        ds.attrs.pop("sweep", None)
        ds.to_netcdf(path)
    return paths


def write_mutant(seed: int, sources: list[Path], path: Path) -> str:
    """Write a mutant to `path`, from one of the datasets `sources`; return a description."""
    rng = random.Random(seed)
    original = rng.choice(sources)
    ds = vj.open_dataset(original).drop_encoding()
    if rng.random() < 0.3:
        path.write_bytes(damage(rng, original.read_bytes()))
        return f"{seed}: {original.stem}, damaged"
    names = []
    for change in rng.sample(CHANGES, rng.randint(1, 2)):
        names.append(change.__name__)
        ds = change(rng, ds)
    try:
        if rng.random() < 0.5:
            vj.write_dataset(ds, path)
        else:
            ds.to_netcdf(path)
    except (ValueError, TypeError, AttributeError, RuntimeError, KeyError, vj.InputError):  # netCDF has no such value
        path.unlink(missing_ok=True)
        path.write_bytes(damage(rng, original.read_bytes()))
        names.append("damaged instead")
    return f"{seed}: {original.stem}, {', '.join(names)}"

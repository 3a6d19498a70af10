"""Mutated datasets: random changes of content and structure, and random damage to the bytes of a file."""

import random
from pathlib import Path

import numpy as np
import xarray as xr

import vibrojax as vj

ODD_VALUES: tuple[object, ...] = (
    "text " * 3000,
    "[1, null]",
    '{"a": 1e999}',
    "days since 0001-01-01",
    2**62,
    float("nan"),
    np.array([], np.int8),
    np.arange(200, dtype=np.int64),
    ["a", "b"],
)
"""Values that an attribute may have in a file."""

NAMES = ("__proto__", "x" * 150, "time", "start", "kind", "curve", "share", "special_kind", "region_area", "event_time")


def _any(rng: random.Random, ds: xr.Dataset) -> str:
    return rng.choice([str(name) for name in ds.variables])


def drop(rng: random.Random, ds: xr.Dataset) -> xr.Dataset:
    """Drop a variable or attributes."""
    attributes = rng.choice([ds.attrs, ds[_any(rng, ds)].attrs])
    for name in rng.sample(sorted(attributes), min(len(attributes), rng.randint(0, 4))):
        if name != "source":
            del attributes[name]
    return ds.drop_vars(_any(rng, ds)) if rng.random() < 0.5 else ds


def change_attribute(rng: random.Random, ds: xr.Dataset) -> xr.Dataset:
    attributes = ds.attrs if rng.random() < 0.2 else ds[_any(rng, ds)].attrs
    names = [name for name in attributes if name != "source"]
    names += ["units", "flag_values", "flag_meanings", "scale_factor", "add_offset", "kind", "axes", "along", "form"]
    attributes[rng.choice(names)] = rng.choice(ODD_VALUES)
    return ds


def change_values(rng: random.Random, ds: xr.Dataset) -> xr.Dataset:
    """Change the type of a variable, or some of its values."""
    name = _any(rng, ds)
    old = ds[name]
    values = old.values.astype(rng.choice(["float32", "int8", "U5", "bool"])) if old.dtype.kind in "fiu" else old.values
    if rng.random() < 0.5:
        values = old.values.astype(object if old.dtype.kind not in "fiu" else old.dtype)
        odd = {"f": [np.nan, np.inf, 1e308, 1e-320, 1e99], "i": [-128, 127, 0, 7], "u": [0, 1, 7]}
        flat = values.reshape(-1)
        for index in range(flat.size):
            if rng.random() < 0.5:
                flat[index] = rng.choice(odd.get(old.dtype.kind, ["", "x" * 300, "a\nb", "$\\frac{$"]))
    place = ds.assign_coords if name in ds.coords else ds.assign
    return place({name: (old.dims, values, old.attrs)})


def change_dimension(rng: random.Random, ds: xr.Dataset) -> xr.Dataset:
    if not ds.sizes:
        return ds
    name = rng.choice(sorted(map(str, ds.sizes)))
    changes = (
        lambda: ds.isel({name: slice(0)}),
        lambda: ds.isel({name: slice(1)}),
        lambda: ds.isel({name: np.arange(rng.choice([50, 3000])) % max(1, ds.sizes[name])}),
        lambda: ds.isel({name: slice(None, None, -1)}),
        lambda: ds.rename({name: rng.choice([other for other in NAMES if other not in ds.variables])}),
        lambda: ds.drop_vars(name, errors="ignore"),
        lambda: ds.transpose(),
    )
    return rng.choice(changes)()


CHANGES = (drop, change_attribute, change_values, change_values, change_dimension, change_dimension)


def damage(rng: random.Random, content: bytes) -> bytes:
    """Return the content of a file after flips, a block of other bytes, a cut, or an insertion."""
    position, length = rng.randrange(len(content)), rng.choice([1, 16, 64, 512, 4096])
    before, after = content[:position], content[position + length :]
    return rng.choice(
        [
            before + bytes(255 - x for x in content[position : position + length]) + after,
            before + bytes(length) + after,
            before,
            before + rng.randbytes(length) + content[position:],
            before + content[:length] + after,
        ]
    )


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
    ds, names = vj.open_dataset(original).drop_encoding(), []
    if rng.random() < 0.7:
        for change in rng.sample(CHANGES, rng.randint(1, 2)):
            names.append(change.__name__)
            ds = change(rng, ds)
        try:
            ds.to_netcdf(path)
            return f"{seed}: {original.stem}, {', '.join(names)}"
        except (ValueError, TypeError, AttributeError, RuntimeError, KeyError):  # netCDF has no such value
            path.unlink(missing_ok=True)
    path.write_bytes(damage(rng, original.read_bytes()))
    return f"{seed}: {original.stem}, damaged"

"""Datasets on disk, checked when they are opened."""

import os
import shlex
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import netCDF4
import xarray as xr

from vibrojax.errors import InputError, first_line
from vibrojax.io.atomic import ZARR, restore
from vibrojax.io.attributes import check_attributes
from vibrojax.io.identity import MARK, MARKED
from vibrojax.io.kinds import KIND, check_kind, check_structure, kind_of
from vibrojax.io.trust import LAZY_FROM, readable
from vibrojax.io.variables import VARIABLES
from vibrojax.threads import in_own_thread


def open_dataset(path: str | os.PathLike[str]) -> xr.Dataset:
    """Open and check a dataset written by this package.

    **Arguments:**

    - `path`: path of the netCDF file or Zarr store.

    **Returns:** the dataset. Up to 128 MB, it is in memory. Above 128 MB, each variable is read when it is first used,
    or in parts if dask is installed.

    **Raises:** `InputError` if the file is missing, not netCDF, truncated, not written by this package, or malformed.

    **Example:**

    >>> motion = vj.simulate("rotary", duration=2.0, progress=False)
    >>> vj.write_dataset(motion, "motion.nc")
    >>> vj.open_dataset("motion.nc").equals(motion)
    True
    """
    path = Path(path)
    is_store, problem = path.suffix == ZARR, ""
    if is_store and path.parent.is_dir():
        restore(path)
    if not path.exists():
        problem = "there is no such file"
    elif path.is_dir() and not is_store:
        problem = "is a folder; give a .nc file"
    elif not path.is_file() and not is_store:
        problem = "is not a regular file; give a .nc file"
    elif path.suffix == ".toml":
        command = shlex.join(["vibrojax", "sweep", str(path)])
        problem = f"is not a dataset; give the .nc file that {command} writes"
    elif path.suffix in MARKED:
        problem = "is not a dataset; give the .nc file from which it was made"
    if problem:
        raise InputError(f"{path}: {problem}")
    if is_store:
        check_zarr(path)
    try:
        with readable(path) as source:
            dataset = in_own_thread(lambda: _opened(source, is_copy=source != path))
    except InputError:
        raise
    except Exception as error:  # the library raises many types of exceptions on a damaged or foreign file
        raise InputError(f"{path}: cannot be read as netCDF ({first_line(error)})") from None
    if not str(dataset.attrs.get("source", "")).startswith(MARK):
        raise InputError(f"{path}: was not written by {MARK} (its attribute source does not say so)")
    try:
        check_dataset(dataset)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    if kind := kind_of(dataset):  # datasets of earlier versions lack the attribute
        dataset.attrs.setdefault(KIND, kind)
    return dataset


def check_dataset(dataset: xr.Dataset) -> None:
    """Raise `InputError` if an attribute, name, coordinate or flag of a dataset is malformed."""
    check_attributes(dataset)
    check_kind(dataset)
    check_structure(dataset)


def _opened(path: Path, is_copy: bool) -> xr.Dataset:
    """Return the dataset, loaded into memory if it is small, or a copy that will be removed."""
    # By its class: by its name, xarray would search all installed packages for backends.
    netcdf: Any = {"engine": xr.backends.NetCDF4BackendEntrypoint}
    kind = {"engine": "zarr", "consolidated": True} if path.is_dir() else netcdf
    netCDF4.set_chunk_cache(1 << 20)  # bytes per variable; by default, 64 MB of each variable stay in memory
    # Times are seconds since the start of a motion; as dates, they would take a hundred times the memory.
    dataset = xr.open_dataset(path, cache=False, decode_times=False, **kind)
    if path.is_dir():  # a Zarr store does not keep the order of variables
        known = [name for name in VARIABLES if name in dataset]
        dataset = dataset[[*known, *(name for name in dataset.data_vars if name not in VARIABLES)]]
    if dataset.nbytes <= LAZY_FROM:
        with dataset:
            return dataset.load()
    if is_copy:
        raise ValueError(f"its values take {dataset.nbytes / 1e9:.3g} GB when they are unpacked")
    return dataset.chunk({}) if find_spec("dask") is not None else dataset


def check_zarr(path: Path) -> None:
    """Raise `InputError` if zarr, an optional dependency, is not installed."""
    if find_spec("zarr") is None:
        raise InputError(f'{path}: zarr is not installed; pip install "vibrojax[zarr]", or give a .nc file')

"""Datasets on disk: written completely or not at all, compressed where it pays, and checked when they are opened."""

import errno
import os
import shlex
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import netCDF4
import xarray as xr

from vibrojax.errors import InputError
from vibrojax.io.atomic import ZARR, atomic_folder, atomic_write, restore
from vibrojax.io.attributes import check_attributes
from vibrojax.io.identity import MARK
from vibrojax.io.kinds import KIND, check_kind, check_structure, kind_of
from vibrojax.io.seal import seal
from vibrojax.io.untrusted import LAZY_FROM, readable
from vibrojax.io.variables import VARIABLES
from vibrojax.threads import in_own_thread

COMPRESSED = 4096
"""Number of values above which a variable is compressed."""

LEVEL = 1
"""Level of zlib: higher levels take several times as long, and save only 1 % more of floating-point results."""

_PROBE = 1 << 20
"""Number of bytes per write when testing whether the disk is full."""


def write_dataset(dataset: xr.Dataset, path: str | os.PathLike[str]) -> None:
    """Write a netCDF-4 file or a Zarr store under a temporary name, then rename it.

    It appears complete or not at all.

    **Arguments:**

    - `dataset`: the dataset to write.
    - `path`: path of the file; a file that this package wrote is replaced. A name that ends in `.zarr` selects Zarr.

    **Raises:** `OSError` if the disk is full or the folder is not writable; `InputError` if zarr is not installed,
    or `path` is a file that this package has not written.

    **Example:**

    >>> speeds = {"scene": "rotary", "grid": {"v": [1.0, 1.5]}}
    >>> vj.write_dataset(vj.run_sweep(speeds, progress=False), "speeds.nc")
    >>> vj.open_dataset("speeds.nc").attrs["Conventions"]
    'CF-1.11'
    """
    path = Path(path)
    # No fill values: xarray reads integer flags with a fill value as floats, and NaN in floats needs none.
    encoding: dict[object, dict[str, object]] = {name: {"_FillValue": None} for name in dataset.variables}
    if path.suffix == ZARR:
        check_zarr(path)
        with atomic_folder(path) as folder:
            plain = dataset.drop_encoding()  # Zarr has other compressors than netCDF, from which it may come
            plain.to_zarr(folder, mode="w", encoding=encoding, zarr_format=2, consolidated=True)
            seal(folder)
        return
    for name, variable in dataset.data_vars.items():
        if variable.size > COMPRESSED and variable.dtype.kind in "fi":
            encoding[name] |= {"zlib": True, "complevel": LEVEL, "shuffle": True}
    with atomic_write(path) as part:
        try:
            dataset.to_netcdf(part, engine="netcdf4", format="NETCDF4", encoding=encoding)
            seal(part)
        except (RuntimeError, OSError) as error:
            raise write_failed(part, path, dataset.nbytes, error) from None


def open_dataset(path: str | os.PathLike[str]) -> xr.Dataset:
    """Open and check a dataset written by this package.

    **Arguments:**

    - `path`: path of the netCDF file or Zarr store. Attributes, names, coordinates and flags are checked, since the
      file may come from any source.

    **Returns:** the dataset, in memory. Variables of a dataset above 256 MB are read when they are used, and in parts
    by dask if dask is installed.

    **Raises:** `InputError` if the file is missing, not netCDF, truncated, not written by this package, or malformed.

    **Example:**

    >>> motion = vj.simulate("rotary", duration=2.0, progress=False)
    >>> vj.write_dataset(motion, "motion.nc")
    >>> vj.open_dataset("motion.nc").equals(motion)
    True
    """
    path = Path(path)
    if path.suffix == ZARR and path.parent.is_dir():
        restore(path)
    if not path.exists():
        raise InputError(f"{path}: there is no such file")
    if path.is_dir() and path.suffix != ZARR:
        raise InputError(f"{path}: is a folder; give a .nc file")
    if not path.is_file() and path.suffix != ZARR:
        raise InputError(f"{path}: is not a regular file; give a .nc file")
    if path.suffix == ".toml":
        command = shlex.join(["vibrojax", "sweep", str(path)])
        raise InputError(f"{path}: is not a dataset; give the .nc file that {command} writes")
    if path.suffix == ZARR:
        check_zarr(path)
    try:
        with readable(path) as source:
            dataset = in_own_thread(lambda: _opened(source, is_copy=source != path))
    except InputError:
        raise
    except Exception as error:  # the library raises many types of exceptions on a damaged or foreign file
        raise InputError(f"{path}: cannot be read as netCDF ({_first_line(error)})") from None
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


def write_failed(part: Path, path: Path, size: int, error: Exception) -> OSError:
    """Return an error that states why a dataset of `size` bytes could not be written.

    The netCDF library reports only "HDF error".
    """
    try:
        with open(part, "ab", buffering=0) as file:
            for _ in range(2 + 2 * size // _PROBE):  # a partial write raises nothing, but the next write does
                file.write(bytes(_PROBE))
            os.fsync(file.fileno())
    except OSError as reason:
        return OSError(reason.errno, reason.strerror, str(path))
    return OSError(errno.EIO, f"cannot be written ({_first_line(error)})", str(path))


def _first_line(error: Exception) -> str:
    lines = str(error).splitlines()
    return lines[0] if lines else type(error).__name__

"""Datasets that are written: complete or not at all, in one piece or region by region, as netCDF or Zarr.

Region by region, a dataset may be larger than the available memory.
"""

import errno
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import product
from math import prod
from pathlib import Path
from typing import Any, NamedTuple

import netCDF4
import numpy as np
import xarray as xr

from vibrojax.errors import first_line
from vibrojax.io.atomic import ZARR, atomic_folder, atomic_write
from vibrojax.io.dataset import check_zarr
from vibrojax.io.trust import seal

COMPRESSED = 4096
"""Number of values above which a variable is compressed."""

COMPRESSION = {"zlib": True, "complevel": 1, "shuffle": True}
"""Filters of netCDF: higher levels take several times as long, and save only 1 % more of floating-point results."""

_PROBE = 1 << 20
"""Number of bytes per write when testing whether the disk is full."""


def write_dataset(dataset: xr.Dataset, path: str | os.PathLike[str]) -> None:
    """Write a dataset as a netCDF-4 file or a Zarr store.

    The file is written under a temporary name and then renamed, so an interruption leaves no partial file.

    **Arguments:**

    - `dataset`: the dataset to write.
    - `path`: path of the file, or of a Zarr store if it ends in `.zarr`; a file that this package wrote is replaced.

    **Raises:** `OSError` if the disk is full or the folder is not writable; `InputError` if zarr is not installed, or
    if another program wrote the existing file at `path`.

    **Example:**

    >>> speeds = {"scene": "rotary", "grid": {"v": [1.0, 1.5]}}
    >>> vj.write_dataset(vj.run_sweep(speeds, progress=False), "speeds.nc")
    >>> vj.open_dataset("speeds.nc").attrs["Conventions"]
    'CF-1.11'
    """
    path = Path(path)
    # No fill values: xarray reads integer flags with a fill value as floats, and NaN in floats needs none.
    encoding: dict[object, dict[str, object]] = {name: {"_FillValue": None} for name in dataset.variables}
    with _sealed(path) as part:
        part.size = dataset.nbytes
        if path.suffix == ZARR:
            plain = dataset.drop_encoding()  # Zarr has other compressors than netCDF, from which it may come
            plain.to_zarr(part.path, mode="w", encoding=encoding, zarr_format=2, consolidated=True)
        else:
            for name, variable in dataset.data_vars.items():
                encoding[name] |= COMPRESSION if variable.size > COMPRESSED and variable.dtype.kind in "fi" else {}
            dataset.to_netcdf(part.path, engine="netcdf4", format="NETCDF4", encoding=encoding)


@dataclass
class _Part:
    """A temporary file or folder that becomes a dataset of `size` bytes."""

    path: Path
    size: int = 0


@contextmanager
def _sealed(path: Path) -> Iterator[_Part]:
    """Yield a temporary file or folder, which is sealed and renamed to `path` when the `with` block ends."""
    if path.suffix == ZARR:
        check_zarr(path)
        with atomic_folder(path) as folder:
            yield _Part(folder)
            seal(folder)
        return
    with atomic_write(path) as file:
        part = _Part(file)
        try:
            yield part
            seal(file)
        except (RuntimeError, OSError) as error:  # the netCDF library reports only "HDF error": try why
            try:
                with open(file, "ab", buffering=0) as probe:
                    for _ in range(2 + 2 * part.size // _PROBE):  # a partial write raises nothing, the next does
                        probe.write(bytes(_PROBE))
                    os.fsync(probe.fileno())
            except OSError as reason:
                raise OSError(reason.errno, reason.strerror, str(path)) from None
            raise OSError(errno.EIO, f"cannot be written ({first_line(error)})", str(path)) from None


Box = tuple[slice, ...]
"""Slices along a sweep's dimensions."""


class Region(NamedTuple):
    """The lanes from `first` (inclusive) to `end` (exclusive), in row-major order, which fill the slices `box`."""

    first: int
    end: int
    box: Box


def chunk_shape(shape: tuple[int, ...], most: int) -> tuple[int, ...]:
    """Return the shape of the regions with at most `most` values into which arrays of a `shape` are divided.

    A region spans an interval of one dimension, all of each later dimension, and one index of each earlier dimension.
    It is therefore both a box and a sequence of consecutive lanes, and forms one complete chunk of every stored array.
    """
    sizes, room = [], max(1, most)
    for size in reversed(shape):
        sizes.append(max(1, min(size, room)))
        room = room // size if size <= room else 1  # dimensions before a subdivided one contribute a single index
    return tuple(reversed(sizes))


def regions(shape: tuple[int, ...], chunk: tuple[int, ...]) -> Iterator[Region]:
    """Yield the regions of arrays in row-major order; only the last along a dimension may be smaller than `chunk`."""
    first = 0
    for corner in product(*(range(0, size, step) for size, step in zip(shape, chunk, strict=True))):
        bounds = zip(corner, shape, chunk, strict=True)
        box = tuple(slice(start, min(start + step, size)) for start, size, step in bounds)
        end = first + prod(part.stop - part.start for part in box)
        yield Region(first, end, box)
        first = end


class InMemory:
    """A dataset that is being written in memory, available as `dataset` after `finish`."""

    dataset: xr.Dataset

    def begin(self, template: xr.Dataset, chunk: tuple[int, ...], plain: frozenset[str]) -> None:
        """Create the dataset and its variables from `template`, which has placeholders as values of its data variables.

        `chunk` is the shape of a region, along the first dimensions of every variable. Variables whose names are in
        `plain` are not compressed.
        """
        data = template.data_vars.items()
        self.dataset = template.copy(data={name: np.empty(x.shape, x.dtype) for name, x in data})

    def put(self, name: str, box: Box, values: np.ndarray) -> None:
        """Write values of a variable: within `box` along its first dimensions, and all along its other dimensions."""
        self.dataset.variables[name].values[box] = values

    def finish(self, attributes: Mapping[str, Any]) -> None:
        """Complete the dataset with its attributes, after all values have been written."""
        self.dataset = self.dataset.assign_attrs(attributes)


class _Netcdf:
    def __init__(self, file: Any, part: _Part) -> None:
        self._file, self._part = file, part
        self._file.set_auto_maskandscale(False)

    def begin(self, template: xr.Dataset, chunk: tuple[int, ...], plain: frozenset[str]) -> None:
        self._part.size = template.nbytes
        for dimension, size in template.sizes.items():
            self._file.createDimension(dimension, size)
        for name in (*template.data_vars, *template.coords):
            data, large, layout = template.variables[name], False, dict[str, Any]()
            text = data.dtype.kind in "UO"
            if name in template.data_vars:
                large = data.size > COMPRESSED
                layout = {"chunksizes": _chunks(data, chunk)} if large else {"contiguous": True}
                layout |= COMPRESSION if large and name not in plain else {}
            # No fill values: xarray reads integer flags with a fill value as floats, and NaN in floats needs none.
            layout["fill_value"] = None if text else False
            variable = self._file.createVariable(name, str if text else data.dtype, data.dims, **layout)
            variable.set_auto_maskandscale(False)
            variable.setncatts(_attributes(template, name))
            if large:  # chunks are written in one piece: a cache would waste memory (0 means 64 MB)
                variable.set_var_chunk_cache(size=1, nelems=1, preemption=1.0)
            if name in template.coords:
                variable[:] = data.values.astype(object) if text else data.values

    def put(self, name: str, box: Box, values: np.ndarray) -> None:
        self._file.variables[name][box] = values

    def finish(self, attributes: Mapping[str, Any]) -> None:
        self._file.setncatts(dict(attributes))


class _Zarr:
    def __init__(self, path: Path) -> None:
        self._path = path

    def begin(self, template: xr.Dataset, chunk: tuple[int, ...], plain: frozenset[str]) -> None:
        import zarr

        template.drop_vars(list(template.data_vars)).to_zarr(self._path, mode="w", zarr_format=2, consolidated=False)
        self._group: Any = zarr.open_group(self._path, mode="r+", zarr_format=2)
        for name, data in template.data_vars.items():
            attributes = _attributes(template, name) | {"_ARRAY_DIMENSIONS": list(data.dims)}  # xarray's convention
            attributes = {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in attributes.items()}
            layout: dict[str, Any] = {"chunks": _chunks(data, chunk), "fill_value": None, "attributes": attributes}
            self._group.create_array(str(name), shape=data.shape, dtype=data.dtype, **layout)

    def put(self, name: str, box: Box, values: np.ndarray) -> None:
        self._group[name][box] = values

    def finish(self, attributes: Mapping[str, Any]) -> None:
        xr.Dataset(attrs=dict(attributes)).to_zarr(self._path, mode="a", zarr_format=2, consolidated=True)


Target = InMemory | _Netcdf | _Zarr
"""A dataset that is being written: three classes with the same methods."""


@contextmanager
def file_target(path: Path) -> Iterator[Target]:
    """Yield a target that becomes the dataset at `path` when the `with` block ends, complete or not at all.

    The suffix of `path` selects netCDF or Zarr.

    **Raises:** `OSError` if the disk is full or the folder is not writable; `InputError` if zarr is not installed.
    """
    with _sealed(path) as part:
        if path.suffix == ZARR:
            yield _Zarr(part.path)
        else:
            with netCDF4.Dataset(part.path, "w", format="NETCDF4") as file:
                yield _Netcdf(file, part)


def _chunks(data: xr.DataArray | xr.Variable, chunk: tuple[int, ...]) -> tuple[int, ...]:
    """Return the chunk shape of a variable: that of a region, and all of its other dimensions."""
    return (*chunk, *data.shape[len(chunk) :])


def _attributes(template: xr.Dataset, name: Any) -> dict[Any, Any]:
    """Return the attributes of a variable; those of data name its non-dimension coordinates in `coordinates`."""
    data, columns = template.variables[name], template.coords.items()
    beside = sorted(str(name) for name, x in columns if name not in template.sizes and set(x.dims) <= set(data.dims))
    return dict(data.attrs) | ({"coordinates": " ".join(beside)} if beside and name not in template.coords else {})

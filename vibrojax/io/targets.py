"""Destinations that a dataset is written to region by region: netCDF, Zarr, or memory. It may exceed the memory."""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import product
from math import prod
from pathlib import Path
from typing import Any

import netCDF4
import numpy as np
import xarray as xr

from vibrojax.io.atomic import ZARR, atomic_folder, atomic_write
from vibrojax.io.dataset import COMPRESSED, check_zarr, write_failed
from vibrojax.io.packing import LEVEL

Box = tuple[slice, ...]
"""Slices over a sweep's dimensions."""

Columns = Mapping[str, tuple[tuple[str, ...], np.ndarray, Mapping[str, Any]]]
"""Coordinates by name: dimensions, values, attributes."""


@dataclass(frozen=True)
class Region:
    """The lanes from `first` to before `end`, in row-major order, which fill the slices `box`."""

    first: int
    end: int
    box: Box

    @property
    def shape(self) -> tuple[int, ...]:
        return tuple(part.stop - part.start for part in self.box)


class Regions:
    """The regions of arrays of a `shape`, in row-major order, none of more than `most` values.

    A region spans a part of one dimension, all later dimensions, and one index of each earlier dimension. It is
    therefore both a box and a run of consecutive lanes, and it is one whole chunk of every stored array. `chunk` holds
    the sizes of all regions but the last ones along a dimension.
    """

    def __init__(self, shape: tuple[int, ...], most: int) -> None:
        self.shape = shape
        sizes, room = [], max(1, most)
        for size in reversed(shape):
            sizes.append(max(1, min(size, room)))
            # Dimensions before a divided one contribute a single index.
            room = room // size if size <= room else 1
        self.chunk = tuple(reversed(sizes))

    def __iter__(self) -> Iterator[Region]:
        first = 0
        for corner in product(*(range(0, size, step) for size, step in zip(self.shape, self.chunk, strict=True))):
            bounds = zip(corner, self.shape, self.chunk, strict=True)
            box = tuple(slice(start, min(start + step, size)) for start, size, step in bounds)
            end = first + prod(part.stop - part.start for part in box)
            yield Region(first, end, box)
            first = end


@dataclass(frozen=True)
class Stored:
    """A stored variable: its dimensions, dtype, attributes and chunk sizes."""

    dims: tuple[str, ...]
    dtype: np.dtype
    attributes: Mapping[str, Any]
    chunk: tuple[int, ...]


@dataclass(frozen=True)
class Frame:
    """A dataset without values: the sizes of its dimensions, its coordinates, and its variables by name."""

    sizes: Mapping[str, int]
    coordinates: Columns
    variables: Mapping[str, Stored]

    def shape(self, name: str) -> tuple[int, ...]:
        return tuple(self.sizes[dimension] for dimension in self.variables[name].dims)

    def size(self, name: str) -> int:
        """Return the number of values of a variable; it may exceed 64 bits."""
        return prod(self.shape(name))

    @property
    def nbytes(self) -> int:
        """Bytes of all values."""
        return sum(self.size(name) * stored.dtype.itemsize for name, stored in self.variables.items())

    def attributes(self, name: str) -> dict[str, Any]:
        """Return the attributes of a variable, with `coordinates`: those along its dimensions that are not axes."""
        dims = set(self.variables[name].dims)
        columns = self.coordinates.items()
        beside = sorted(column for column, (along, *_) in columns if column not in self.sizes and set(along) <= dims)
        return dict(self.variables[name].attributes) | ({"coordinates": " ".join(beside)} if beside else {})


class Target(ABC):
    """A dataset that is being written; `packs`: whether it compresses variables."""

    packs = False

    @abstractmethod
    def begin(self, frame: Frame, plain: frozenset[str]) -> None:
        """Announce the dataset, with the names of the variables that are not compressed."""

    @abstractmethod
    def put(self, name: str, box: Box, values: np.ndarray) -> None:
        """Write values of a variable, in a box over its first dimensions and all of its others."""

    @abstractmethod
    def finish(self, attributes: Mapping[str, Any]) -> None:
        """Complete the dataset with its attributes, after all values."""


class InMemory(Target):
    """A dataset in memory: `dataset`, once it is finished."""

    dataset: xr.Dataset

    def begin(self, frame: Frame, plain: frozenset[str]) -> None:
        self._frame = frame
        self._arrays = {name: np.empty(frame.shape(name), stored.dtype) for name, stored in frame.variables.items()}

    def put(self, name: str, box: Box, values: np.ndarray) -> None:
        self._arrays[name][box] = values

    def finish(self, attributes: Mapping[str, Any]) -> None:
        stored = self._frame.variables
        variables = {name: (stored[name].dims, x, dict(stored[name].attributes)) for name, x in self._arrays.items()}
        self.dataset = xr.Dataset(variables, dict(self._frame.coordinates), dict(attributes))


class _Netcdf(Target):
    packs = True

    def __init__(self, file: Any) -> None:
        self._file = file
        self._file.set_auto_maskandscale(False)
        self.nbytes = 0

    def begin(self, frame: Frame, plain: frozenset[str]) -> None:
        self.nbytes = frame.nbytes
        for dimension, size in frame.sizes.items():
            self._file.createDimension(dimension, size)
        for name, stored in frame.variables.items():
            large = frame.size(name) > COMPRESSED
            layout: dict[str, Any] = {"chunksizes": stored.chunk} if large else {"contiguous": True}
            if large and name not in plain:
                layout |= {"zlib": True, "complevel": LEVEL, "shuffle": True}
            variable = self._create(name, stored.dtype, stored.dims, frame.attributes(name), layout)
            if large:  # chunks are written whole: a cache would only take memory (0 means 64 MB)
                variable.set_var_chunk_cache(size=1, nelems=1, preemption=1.0)
        for name, (dims, values, attributes) in frame.coordinates.items():
            text = values.dtype.kind in "UO"
            variable = self._create(name, str if text else values.dtype, dims, attributes, {})
            variable[:] = values.astype(object) if text else values

    def put(self, name: str, box: Box, values: np.ndarray) -> None:
        self._file.variables[name][box] = values

    def finish(self, attributes: Mapping[str, Any]) -> None:
        self._file.setncatts(dict(attributes))

    def _create(self, name: str, dtype: Any, dims: tuple[str, ...], attributes: Mapping[str, Any], layout: Any) -> Any:
        # Flags stay integers only without a fill value, and floats keep NaN as it is.
        variable = self._file.createVariable(name, dtype, dims, fill_value=None if dtype is str else False, **layout)
        variable.set_auto_maskandscale(False)
        variable.setncatts(dict(attributes))
        return variable


class _Zarr(Target):
    def __init__(self, path: Path) -> None:
        self._path = path

    def begin(self, frame: Frame, plain: frozenset[str]) -> None:
        import zarr

        xr.Dataset(coords=dict(frame.coordinates)).to_zarr(self._path, mode="w", zarr_format=2, consolidated=False)
        self._group: Any = zarr.open_group(self._path, mode="r+", zarr_format=2)
        for name, stored in frame.variables.items():
            attributes = frame.attributes(name) | {"_ARRAY_DIMENSIONS": list(stored.dims)}  # xarray's convention
            plain_attributes = {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in attributes.items()}
            layout: dict[str, Any] = {"chunks": stored.chunk, "fill_value": None, "attributes": plain_attributes}
            self._group.create_array(name, shape=frame.shape(name), dtype=stored.dtype, **layout)

    def put(self, name: str, box: Box, values: np.ndarray) -> None:
        self._group[name][box] = values

    def finish(self, attributes: Mapping[str, Any]) -> None:
        xr.Dataset(attrs=dict(attributes)).to_zarr(self._path, mode="a", zarr_format=2, consolidated=True)


@contextmanager
def file_target(path: Path) -> Iterator[Target]:
    """Yield what becomes the dataset at `path` when the block ends, whole or not at all: netCDF, or Zarr by its name.

    **Raises:** `OSError` if the disk is full or the folder cannot be written; `InputError` if zarr is not installed.
    """
    if path.suffix == ZARR:
        check_zarr(path)
        with atomic_folder(path) as part:
            yield _Zarr(part)
        return
    with atomic_write(path) as part:
        size = 0
        try:
            with netCDF4.Dataset(part, "w", format="NETCDF4") as file:
                target = _Netcdf(file)
                try:
                    yield target
                finally:
                    size = target.nbytes
        except (RuntimeError, OSError) as error:
            raise write_failed(part, path, size, error) from None

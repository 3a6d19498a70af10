"""Where a dataset is written region by region: netCDF, Zarr, or memory; its size may be beyond what memory holds."""

import shutil
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from collections.abc import Set as AbstractSet
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from vibrojax.io.atomic import ZARR, atomic_write, sync, sync_folder
from vibrojax.io.dataset import COMPRESSED, check_zarr, write_failed
from vibrojax.io.packing import LEVEL
from vibrojax.io.regions import Box

Columns = Mapping[str, tuple[tuple[str, ...], np.ndarray, Mapping[str, Any]]]
"""Coordinates by name: dimensions, values, attributes."""


@dataclass(frozen=True)
class Stored:
    """A variable as it is stored: its dimensions, dtype, attributes, the sizes of its chunks, and whether these are
    packed."""

    dims: tuple[str, ...]
    dtype: np.dtype
    attributes: Mapping[str, Any]
    chunk: tuple[int, ...]
    packed: bool = True


@dataclass(frozen=True)
class Frame:
    """All of a dataset but its values: the sizes of its dimensions, coordinates, and variables by name."""

    sizes: Mapping[str, int]
    coordinates: Columns
    variables: Mapping[str, Stored]

    def shape(self, name: str) -> tuple[int, ...]:
        """The shape of a variable."""
        return tuple(self.sizes[dimension] for dimension in self.variables[name].dims)

    def size(self, name: str) -> int:
        """How many values a variable has."""
        return int(np.prod(self.shape(name), dtype=object))

    @property
    def nbytes(self) -> int:
        """Bytes of all values."""
        return sum(self.size(name) * one.dtype.itemsize for name, one in self.variables.items())

    def without_packing(self, names: AbstractSet[str]) -> "Frame":
        """The same, of whose variables those of these names are not packed."""
        variables = {name: replace(one, packed=name not in names) for name, one in self.variables.items()}
        return replace(self, variables=variables)

    def beside(self, name: str) -> list[str]:
        """The coordinates of a variable that are none of its dimensions."""
        dims = set(self.variables[name].dims)
        return sorted(
            one for one, (along, _, _) in self.coordinates.items() if one not in self.sizes and set(along) <= dims
        )


class Target(ABC):
    """A dataset that is being written; `packs`: whether it heeds which variables are packed."""

    packs = False

    @abstractmethod
    def begin(self, frame: Frame) -> None:
        """What is going to be written."""

    @abstractmethod
    def put(self, name: str, box: Box, values: np.ndarray) -> None:
        """Values of a variable, in a box over its first dimensions and all of the others."""

    @abstractmethod
    def finish(self, attributes: Mapping[str, Any]) -> None:
        """All values are there; the attributes of the dataset."""


class InMemory(Target):
    """A dataset in memory: `dataset`, when it is finished."""

    dataset: xr.Dataset

    def begin(self, frame: Frame) -> None:
        self._frame = frame
        self._arrays = {name: np.empty(frame.shape(name), one.dtype) for name, one in frame.variables.items()}

    def put(self, name: str, box: Box, values: np.ndarray) -> None:
        self._arrays[name][box] = values

    def finish(self, attributes: Mapping[str, Any]) -> None:
        variables = {
            name: (one.dims, self._arrays[name], dict(one.attributes)) for name, one in self._frame.variables.items()
        }
        self.dataset = xr.Dataset(variables, dict(self._frame.coordinates), dict(attributes))


class _Netcdf(Target):
    packs = True

    def __init__(self, path: Path) -> None:
        import netCDF4

        self._file = netCDF4.Dataset(path, "w", format="NETCDF4")
        self._file.set_auto_maskandscale(False)
        self._variables: dict[str, Any] = {}
        self.nbytes = 0

    def begin(self, frame: Frame) -> None:
        self.nbytes = frame.nbytes
        for dimension, size in frame.sizes.items():
            self._file.createDimension(dimension, size)
        for name, one in frame.variables.items():
            large = frame.size(name) > COMPRESSED
            how: dict[str, Any] = {"chunksizes": one.chunk} if large else {"contiguous": True}
            if large and one.packed:
                how |= {"zlib": True, "complevel": LEVEL, "shuffle": True}
            variable = self._create(name, one.dtype, one.dims, how)
            if large:  # chunks are written whole: to keep them would only take memory (0 means 64 MB)
                variable.set_var_chunk_cache(size=1, nelems=1, preemption=1.0)
            beside = frame.beside(name)
            variable.setncatts(dict(one.attributes) | ({"coordinates": " ".join(beside)} if beside else {}))
            self._variables[name] = variable
        for name, (dims, values, about) in frame.coordinates.items():
            text = values.dtype.kind in "UO"
            variable = self._create(name, str if text else values.dtype, dims, {})
            variable.setncatts(dict(about))
            variable[:] = values.astype(object) if text else values

    def put(self, name: str, box: Box, values: np.ndarray) -> None:
        self._variables[name][box] = values

    def finish(self, attributes: Mapping[str, Any]) -> None:
        self._file.setncatts(dict(attributes))

    def close(self) -> None:
        """Have all of it in the file."""
        self._file.close()

    def _create(self, name: str, dtype: Any, dims: tuple[str, ...], how: Mapping[str, Any]) -> Any:
        # Flags stay integers only without a fill value, and floats keep NaN as it is.
        variable = self._file.createVariable(name, dtype, dims, fill_value=None if dtype is str else False, **how)
        variable.set_auto_maskandscale(False)
        return variable


class _Zarr(Target):
    def __init__(self, path: Path) -> None:
        import zarr

        self._path = path
        self._group: Any = zarr.open_group(path, mode="w", zarr_format=2)

    def begin(self, frame: Frame) -> None:
        xr.Dataset(coords=dict(frame.coordinates)).to_zarr(self._path, mode="w", zarr_format=2, consolidated=False)
        for name, one in frame.variables.items():
            array = self._group.create_array(
                name, shape=frame.shape(name), dtype=one.dtype, chunks=one.chunk, fill_value=None
            )
            beside = frame.beside(name)
            attributes = {key: _plain(value) for key, value in one.attributes.items()}
            more = {"coordinates": " ".join(beside)} if beside else {}
            array.attrs.update(attributes | more | {"_ARRAY_DIMENSIONS": list(one.dims)})

    def put(self, name: str, box: Box, values: np.ndarray) -> None:
        self._group[name][box] = values

    def finish(self, attributes: Mapping[str, Any]) -> None:
        import zarr

        self._group.attrs.clear()
        self._group.attrs.update({key: _plain(value) for key, value in attributes.items()})
        zarr.consolidate_metadata(self._path, zarr_format=2)


@contextmanager
def file_target(path: Path) -> Iterator[Target]:
    """What becomes the dataset at `path` when the block ends, whole or not at all: netCDF, or Zarr by its name.

    **Raises:** `OSError` where the disk is full or the folder cannot be written; `InputError` where Zarr is not there.
    """
    if path.suffix == ZARR:
        check_zarr(path)
        with _atomic_folder(path) as part:
            yield _Zarr(part)
        return
    with atomic_write(path) as part:
        size = 0
        try:
            target = _Netcdf(part)
            try:
                yield target
            finally:
                size = target.nbytes
                target.close()
        except (RuntimeError, OSError) as error:
            raise write_failed(part, path, size, error) from None


@contextmanager
def _atomic_folder(path: Path) -> Iterator[Path]:
    """The temporary folder that becomes `path` when the block ends; nothing is left of a block that fails."""
    part, before = (path.with_name(f".{path.name}.{kind}") for kind in ("tmp", "before"))
    for left in (part, before):  # by a process that was killed
        shutil.rmtree(left, ignore_errors=True)
    try:
        yield part
        for file in part.rglob("*"):
            if file.is_file():
                sync(file)
        if path.exists():  # folders do not replace each other
            path.rename(before)
        part.rename(path)
        sync_folder(path.parent)
    finally:
        for left in (part, before):
            shutil.rmtree(left, ignore_errors=True)


def _plain(value: Any) -> Any:
    """An attribute as JSON has it."""
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value

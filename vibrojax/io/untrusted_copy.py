"""A script that copies a dataset of unknown origin, run by `io.trust` in a process of its own.

A damaged or hostile file can make HDF5 loop, crash, fill the memory, or read other files. Here all of that ends with
the process. The copy is made by this process alone, so that the file of unknown origin need not be opened again.

Arguments: source, destination, the size of values [bytes] above which nothing is copied, the greatest ratio of the size
of values to that of the source, seconds of processor time. The last line of stdout is a JSON object: `large` (nothing
was copied), or `problem`. It imports nothing of the package, whose import takes longer than all else.
"""

import json
import mmap
import os
import re
import resource
import sys
from math import prod
from pathlib import Path
from typing import Any

MOST_VARIABLES = 2000
"""Greatest number of variables: a wide design has some hundred."""

MOST_MEMORY = 900 * 2**20
"""Greatest memory of this process [bytes]."""

_VIRTUAL = re.compile(rb"\x08(\x0e\x00.(..)?|\x00[\x10\x18\x20]\x00.\x00{3})\x04\x03", re.DOTALL)
"""Header message of a variable that shows values of other files: type 8, class 3. Such files cannot be opened here, and
their values would be missing; random bytes match once in 10^11."""


class Refused(Exception):
    """A reason not to read a dataset."""


def copy_file(source: str, destination: str, most: float, packed: float) -> bool:
    """Copy a netCDF file; return False if its values take more than `most` bytes."""
    import netCDF4
    import numpy as np

    with open(source, "rb") as raw, mmap.mmap(raw.fileno(), 0, access=mmap.ACCESS_READ) as content:
        if _VIRTUAL.search(content):
            raise Refused("it has virtual variables, which show values of other files")
    with netCDF4.Dataset(destination, "w") as copy:
        free = os.open(os.devnull, os.O_RDONLY)
        os.close(free)
        # This process may open one more file at a time: an external link fails, and so does external storage.
        resource.setrlimit(resource.RLIMIT_NOFILE, (free + 1, free + 1))
        with netCDF4.Dataset(source) as file:
            file.set_auto_maskandscale(False)
            file.set_auto_chartostring(False)
            sizes = {name: len(dimension) for name, dimension in file.dimensions.items()}
            for name, variable in file.variables.items():
                is_plain = isinstance(variable.datatype, np.dtype) and variable.datatype.kind in "iufS"
                if variable.dtype is not str and not is_plain:
                    raise Refused(f"variable {json.dumps(name[:50])} has values that are neither numbers nor text")
            claimed = sum(
                prod(variable.shape) * (8 if variable.dtype is str else variable.dtype.itemsize)
                for variable in file.variables.values()
            )
            if not _is_small(len(file.variables), claimed, os.path.getsize(source), most, packed):
                for variable in file.variables.values():  # external storage shows at the first value
                    if variable.size:
                        _ = variable[(0,) * variable.ndim], variable[(-1,) * variable.ndim]
                return False
            for name, size in sizes.items():
                copy.createDimension(name, size)
            copy.setncatts({name: file.getncattr(name) for name in file.ncattrs()})
            for name, variable in file.variables.items():
                attributes = {key: variable.getncattr(key) for key in variable.ncattrs()}
                missing = attributes.pop("_FillValue", False)
                dtype = str if variable.dtype is str else variable.dtype.newbyteorder("=")
                new = copy.createVariable(
                    name, dtype, variable.dimensions, fill_value=None if dtype is str else missing
                )
                new.set_auto_maskandscale(False)
                new.set_auto_chartostring(False)
                new.setncatts(attributes)
                new[...] = variable[...]
    return True


def copy_store(source: str, destination: str, most: float, packed: float) -> bool:
    """Copy a Zarr store; return False if its values take more than `most` bytes."""
    import xarray as xr

    dataset = xr.open_dataset(source, engine="zarr", consolidated=True, decode_cf=False, cache=False)
    stored = sum(file.stat().st_size for file in Path(source).rglob("*"))
    if not _is_small(len(dataset.variables), dataset.nbytes, stored, most, packed):
        return False
    dataset.load().drop_encoding().to_zarr(destination, mode="w", zarr_format=2, consolidated=True)
    return True


def _is_small(variables: int, claimed: float, stored: float, most: float, packed: float) -> bool:
    """Return whether values take at most `most` bytes; refuse more than the stored bytes can hold."""
    if variables > MOST_VARIABLES:
        raise Refused(f"it has {variables} variables, more than {MOST_VARIABLES}")
    if claimed > packed * max(stored, 1):
        raise Refused(f"it claims {claimed / 1e9:.3g} GB, which its {stored} bytes cannot hold")
    return claimed <= most


def main(source: str, destination: str, most: str, packed: str, seconds: str) -> None:
    """Copy the dataset within the limits, and print what became of it."""
    for kind, limit in (
        (resource.RLIMIT_CORE, 0),
        (resource.RLIMIT_CPU, int(float(seconds))),
        (resource.RLIMIT_DATA, MOST_MEMORY),
        (resource.RLIMIT_FSIZE, MOST_MEMORY),
    ):
        allowed = resource.getrlimit(kind)[1]
        least = limit if allowed == resource.RLIM_INFINITY else min(limit, allowed)
        resource.setrlimit(kind, (least, least))
    answer: dict[str, Any] = {}
    try:
        copy = copy_store if os.path.isdir(source) else copy_file
        answer["large"] = not copy(source, destination, float(most), float(packed))
    except Refused as refusal:
        answer["problem"] = str(refusal)
    except MemoryError:
        answer["problem"] = f"it takes more than {MOST_MEMORY // 2**20} MiB of memory"
    except Exception as error:  # the libraries raise many types of exceptions on a damaged or foreign file
        lines = str(error).splitlines() or [type(error).__name__]
        hidden = "HDF error" in lines[0]
        answer["problem"] = "it is damaged, or refers to other files" if hidden else lines[0][:200]
    print(json.dumps(answer), flush=True)
    os._exit(0)  # closing what is damaged may not end


if __name__ == "__main__":
    main(*sys.argv[1:])

"""Arrays from an npz that lies in memory, without a copy: a tenth of the time that numpy takes for many small ones."""

import io
import struct
import zipfile
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.lib import format as npy

_LOCAL_HEADER = struct.Struct("<26xHH")
"""The end of the header before each file of a zip: how long its name is, and what else there is."""


def arrays(content: memoryview) -> dict[str, np.ndarray]:
    """The arrays of an npz by name, not to be written to; `content`: as `np.savez` wrote it, known to be whole."""
    with zipfile.ZipFile(io.BytesIO(content)) as files:
        return {one.filename.removesuffix(".npy"): _array(_stored(content, one)) for one in files.infolist()}


def _stored(content: memoryview, file: zipfile.ZipInfo) -> memoryview:
    """A file of a zip that packs nothing."""
    assert file.compress_type == zipfile.ZIP_STORED
    name, extra = _LOCAL_HEADER.unpack_from(content, file.header_offset)
    begin = file.header_offset + _LOCAL_HEADER.size + name + extra
    return content[begin : begin + file.file_size]


def _array(content: memoryview) -> np.ndarray:
    """An array from the bytes of its npy file."""
    begin = npy.MAGIC_LEN + 2 + int.from_bytes(content[npy.MAGIC_LEN : npy.MAGIC_LEN + 2], "little")
    shape, columns_first, dtype = _header(bytes(content[:begin]))
    found = np.frombuffer(content, dtype, count=int(np.prod(shape)), offset=begin)
    return found.reshape(shape, order="F" if columns_first else "C")


@lru_cache(maxsize=1024)
def _header(content: bytes) -> Any:
    """(shape, whether columns come first, dtype): the same for many arrays, and slow to read."""
    file = io.BytesIO(content)
    assert npy.read_magic(file) == (1, 0)
    return npy.read_array_header_1_0(file)

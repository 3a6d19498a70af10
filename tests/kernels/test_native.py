"""Object code may lie anywhere: whatever it refers to, it refers to by whole addresses."""

import struct
import sys

import jax.numpy as jnp
import numpy as np
import pytest

from vibrojax.compile.kernels import Kernel, native

RELOCATIONS, WHOLE_ADDRESS = 4, 1  # SHT_RELA, R_X86_64_64 (ELF-64 and x86-64 psABI)


def references(code: bytes) -> list[int]:
    """Types of all references in an ELF object file."""
    start, size, count = struct.unpack_from("<Q", code, 40)[0], *struct.unpack_from("<HH", code, 58)
    found = []
    for section in range(count):
        kind, offset, length = struct.unpack_from("<4xI16xQQ", code, start + section * size)
        if kind == RELOCATIONS:
            found += [struct.unpack_from("<8xI", code, offset + at)[0] for at in range(0, length, 24)]
    return found


@pytest.mark.skipif(sys.platform != "linux" or "x86_64" not in native.processor().triple, reason="reads ELF for x86-64")
def test_references_are_whole_addresses(monkeypatch):
    """Shorter ones ended the process in one of some dozens of kernels, where its parts came to lie too far apart."""
    codes = []
    compiled = native._object_code
    monkeypatch.setattr(native, "_object_code", lambda text: codes.append(compiled(text)) or codes[-1])
    monkeypatch.setenv("VIBROJAX_CACHE", "off")
    x = np.linspace(0.1, 2.0, 9)

    def function(x):
        return jnp.exp(x) * 3.7 + jnp.arctan2(x, 0.3) + jnp.where(x > 1.1, -x, x)

    np.testing.assert_allclose(Kernel(function, x)(x), np.asarray(function(x)), rtol=1e-14)
    [code] = codes
    assert references(code) and set(references(code)) == {WHOLE_ADDRESS}


def test_no_lanes():
    """A kernel that is given no lanes writes nothing: it once wrote a group of them behind its empty results."""
    x = np.linspace(0.1, 2.0, 9)
    kernel = Kernel(lambda x: x + 1.0, x)
    assert kernel(np.empty(0)).shape == (0,)
    given, result, workspace = np.ones(64), np.zeros(64), np.zeros(4096, np.uint8)
    pointers = np.array([given.ctypes.data, result.ctypes.data], np.uintp)
    kernel._lanes(pointers.ctypes.data, -(-workspace.ctypes.data // 1024) * 1024, 0)
    assert not result.any()

"""Tests of kernels: references in object code, the lanes of a call, pytrees of arguments and results."""

import struct
import sys
from collections import OrderedDict
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from vibrojax.compile import cache, native
from vibrojax.compile.native import Kernel
from vibrojax.compile.trees import flatten, map_leaves, unflatten

RELOCATIONS, WHOLE_ADDRESS = 4, 1  # SHT_RELA, R_X86_64_64 (ELF-64 and x86-64 psABI)


def references(code: bytes) -> list[int]:
    """Return the types of all references in an ELF object file."""
    start, size, count = struct.unpack_from("<Q", code, 40)[0], *struct.unpack_from("<HH", code, 58)
    types = []
    for section in range(count):
        kind, offset, length = struct.unpack_from("<4xI16xQQ", code, start + section * size)
        if kind == RELOCATIONS:
            types += [struct.unpack_from("<8xI", code, offset + entry)[0] for entry in range(0, length, 24)]
    return types


@pytest.mark.skipif(sys.platform != "linux" or "x86_64" not in native.processor().triple, reason="reads ELF for x86-64")
def test_references_are_whole_addresses(monkeypatch, tmp_path):
    """Shorter references once ended the process in one of some dozens of kernels, whose parts lay too far apart."""
    monkeypatch.setenv("VIBROJAX_CACHE", str(tmp_path))
    x = np.linspace(0.1, 2.0, 9)

    def function(x):
        return jnp.exp(x) * 3.7 + jnp.arctan2(x, 0.3) + jnp.where(x > 1.1, -x, x)

    np.testing.assert_allclose(Kernel(function, x)(x), np.asarray(function(x)), rtol=1e-14)
    [file] = cache.folder().iterdir()
    code = file.read_bytes()[cache.HEADER :]
    assert references(code) and set(references(code)) == {WHOLE_ADDRESS}


DTYPES = {"float64": 1.5, "float32": 1.5, "int8": 3, "int16": 3, "bool": True}


@pytest.mark.parametrize("length", [0, 1, 7, 40])
def test_selected_lanes_in_place(length):
    """Lanes at any index, of numbers of every size, are read and written at their own places only."""
    random = np.random.default_rng(length)
    rows = {name: random.permutation(40 * 3).reshape(3, 40).astype(name) for name in DTYPES}

    def function(rows, factor):
        return {name: x ^ True if name == "bool" else x * factor.astype(name) for name, x in rows.items()}

    bound = Kernel(function, rows, np.float64(2)).bind(rows, np.float64(2))
    for result in bound.results.values():
        result[...] = 1
    lanes = random.permutation(40)[:length]
    bound(lanes)
    for name, result in bound.results.items():
        expected = np.ones_like(rows[name])
        expected[:, lanes] = ~rows[name][:, lanes] if name == "bool" else rows[name][:, lanes] * np.array(2, name)
        np.testing.assert_array_equal(result, expected)


WRONG = [[0, 40], [-1], [2**62], [0.0], [[0]]]


@pytest.mark.parametrize("lanes", WRONG, ids=str)
def test_wrong_index_writes_nothing(lanes):
    """It is refused before the machine code runs, which would overwrite other memory."""
    x = np.linspace(0.1, 2.0, 40)
    bound = Kernel(lambda x: x + 1.0, x).bind(x)
    bound.results[...] = 7.0
    with pytest.raises(IndexError, match="lanes"):
        bound(np.array(lanes))
    assert (bound.results == 7.0).all()


class Pair(NamedTuple):
    """A container like those of programs."""

    first: object
    second: object = ()


TREES = (
    (1.0, [2, None, (), []], {}, "3"),
    {"b": np.ones(2), "a": {"z": None, "y": Pair(np.float32(1), (np.zeros(3),))}, "_": True},
    ({2: 1, -1: 2, 10: 3}, Pair([Pair({"b": 1, "B": 2}), 3])),
    ({"x": jnp.ones(2), "o": OrderedDict(b=1, a=[2, 3])}, jax.ShapeDtypeStruct((3,), float)),
)


@pytest.mark.parametrize("tree", TREES, ids=range(len(TREES)))
def test_trees_are_those_of_jax(tree):
    """Kernels number their arguments as jax does, and results are put together again from their numbers."""
    leaves, structure = flatten(tree)
    expected, by_jax = jax.tree.flatten(tree)
    assert list(map(id, leaves)) == list(map(id, expected))
    numbers = range(len(leaves))
    assert repr(unflatten(structure, numbers)) == repr(jax.tree.unflatten(by_jax, numbers))
    assert repr(map_leaves(lambda *x: x, tree, tree)) == repr(jax.tree.map(lambda *x: x, tree, tree))
    assert [structure == flatten(other)[1] for other in TREES] == [other is tree for other in TREES]
    assert hash(structure) == hash(flatten(tree)[1])

"""Test that commands that compute nothing import neither jax nor other libraries that they do not need."""

import subprocess
import sys

import pytest
from small_map import small_map

import vibrojax as vj

CODE = "import sys; sys.modules |= dict.fromkeys({!r}); from vibrojax.cli import main; sys.exit(main({!r}))"
"""Code of a process in which some modules cannot be imported."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("light")
    vj.write_dataset(small_map(), path / "map.nc")
    return path


@pytest.mark.parametrize(
    ("words", "absent"),
    [
        (["scenes"], ["jax", "jaxlib", "matplotlib", "pandas", "scipy", "xarray"]),
        (["info", "map.nc", "--json"], ["jax", "jaxlib", "matplotlib"]),
        (["plot", "map.nc"], ["jax", "jaxlib", "matplotlib.pyplot"]),
    ],
    ids=" ".join,
)
def test_without(folder, words, absent):
    code = [sys.executable, "-c", CODE.format(absent, words)]
    completed = subprocess.run(code, capture_output=True, text=True, cwd=folder)
    assert (completed.returncode, completed.stderr) == (0, "")
    assert completed.stdout

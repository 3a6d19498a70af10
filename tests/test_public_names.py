"""Test that Python, which imports the public names lazily, and editors, which read the stub, agree on the names."""

import ast
import tomllib
from importlib.metadata import version
from pathlib import Path

import vibrojax as vj

ROOT = Path(__file__).parents[1]
STUB = ast.parse((ROOT / "vibrojax" / "__init__.pyi").read_text())
IMPORTED = [(node.module, name) for node in STUB.body if isinstance(node, ast.ImportFrom) for name in node.names]


def test_every_public_name_resolves():
    assert all(name.asname == name.name for _, name in IMPORTED)  # a stub re-exports only names written with `as`
    assert all(getattr(vj, name) is not None for name in vj.__all__)


def test_version_is_installed_version():
    assert vj.__version__ == version("vibrojax")


def test_citation_has_same_version():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert f"\nversion: {project['version']}\n" in (ROOT / "CITATION.cff").read_text()

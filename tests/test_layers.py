"""Test that a folder of the package imports only from folders above it, in the order of CONTRIBUTING."""

import ast
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "vibrojax"
LIST = "compile physics scenes systems stepping io measures settings lanes periodic maps pictures studies explorer cli"
ORDER = tuple(LIST.split(" "))
EXCEPTIONS = {}
"""Number of imports in the wrong direction, by folders. It may only fall."""


def imported_modules(path):
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module is not None:
            yield from [f"{node.module}.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.Import):
            yield from [alias.name for alias in node.names]


def test_order_lists_all_folders():
    assert set(ORDER) == {path.parent.name for path in PACKAGE.glob("*/*.py")}
    assert not list(PACKAGE.glob("*/*/*.py"))


@pytest.mark.parametrize("folder", ORDER)
def test_imports_point_upwards(folder):
    imports = {
        (path.name, module.rpartition(".")[0])
        for path in (PACKAGE / folder).glob("*.py")
        for module in imported_modules(path)
    }
    for other in ORDER[ORDER.index(folder) + 1 :]:
        wrong = sorted(pair for pair in imports if f"{pair[1]}.".startswith(f"vibrojax.{other}."))
        assert len(wrong) <= EXCEPTIONS.get((folder, other), 0), wrong

"""Settings and class attributes that the source of a study declares, for `--help`, without importing the study.

A study imports xarray, SciPy or jax, which takes longer than everything else that `--help` does.
"""

import ast
import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

PACKAGE = Path(__file__).parents[1]


class DeclaredSetting(NamedTuple):
    """A setting: its meaning, its default (None if the source computes it), and the name of its value in `--help`."""

    help: str = ""
    default: Any = None
    metavar: str | None = None


def summary_of(module: str, name: str) -> str:
    """Return the first line of the docstring of a class, without its full stop; parsing the module takes longer."""
    match = re.search(rf'^class {name}\b[^:]*:\n    """(.+?)\.?("""|\n)', _source(module), re.MULTILINE)
    return match[1] if match else ""


@cache
def declared(module: str) -> "Declared":
    """Return the declarations of a module of this package."""
    return Declared(ast.parse(_source(module)).body)


def _source(module: str) -> str:
    path = PACKAGE.joinpath(*module.split(".")[1:])
    path = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    return path.read_text(encoding="utf-8")


class Declared(dict[str, Any]):
    """The constants and classes of a module, each evaluated when it is looked up.

    A class is a dict of its attributes, with those of its bases. What calls a function is unknown: its name is missing.
    """

    def __init__(self, body: Sequence[ast.stmt]) -> None:
        self._definitions = dict(_definitions(body))

    def __missing__(self, name: str) -> Any:
        self[name] = self._evaluated(name, self._definitions[name])
        return self[name]

    def _evaluated(self, name: str, node: ast.AST) -> Any:
        match node:
            case ast.ImportFrom(module=str(home)) if home.startswith("vibrojax."):
                return declared(home)[name]
            case ast.ClassDef():
                return self._attributes(node)
            case ast.Call(func=ast.Name(id="setting"), args=[default, meaning]):
                return DeclaredSetting(self._evaluated("", meaning), self._default(default))
            case ast.Call(func=ast.Name(id="field"), keywords=keywords):
                values = {str(keyword.arg): keyword.value for keyword in keywords}
                about = self._evaluated("", values["metadata"])
                return DeclaredSetting(about.get("help", ""), self._default(values["default"]), about.get("metavar"))
            case ast.expr():
                return eval(compile(ast.Expression(node), "<source>", "eval"), {}, self)
        raise KeyError(name)

    def _default(self, node: ast.expr) -> Any:
        with suppress(Exception):
            return self._evaluated("", node)
        return None

    def _attributes(self, node: ast.ClassDef) -> dict[str, Any]:
        attributes: dict[str, Any] = {}
        for base in node.bases:
            with suppress(KeyError):  # a class of another package
                attributes |= self[ast.unparse(base.value if isinstance(base, ast.Subscript) else base)]
        for name, value in _definitions(node.body):
            with suppress(Exception):  # pictures and the like, which need functions
                attributes[name] = self._evaluated(name, value)
        return attributes


def _definitions(body: Sequence[ast.stmt]) -> Iterator[tuple[str, ast.AST]]:
    """Yield each name that statements define, with its value, class or import."""
    for node in body:
        match node:
            case ast.ImportFrom():
                yield from ((alias.name, node) for alias in node.names)
            case ast.ClassDef():
                yield node.name, node
            case ast.AnnAssign(target=ast.Name(id=name), value=ast.expr() as value):
                yield name, value
            case ast.Assign(targets=[ast.Name(id=name)], value=value):
                yield name, value
            case ast.Assign(targets=[ast.Tuple(elts=names)], value=ast.Tuple(elts=values)):
                yield from zip(map(ast.unparse, names), values, strict=True)

"""Tests of docstring examples: every public name has one, and every example prints the output below it.

They run in a process of their own, without the strict settings of the test run: `python tests/test_examples.py NAME`"""

import ast
import doctest
import inspect
import json
import subprocess
import sys
from importlib import import_module
from itertools import pairwise
from pathlib import Path

import pytest

import vibrojax as vj

PARSER = doctest.DocTestParser()


def docstring(name: str) -> str:
    """Return the docstring that `help` and the site show; for a constant, the string below its assignment."""
    value = getattr(vj, name)
    if inspect.isclass(value) or inspect.isroutine(value) or inspect.ismodule(value):
        return inspect.getdoc(value) or ""
    for statement, below in pairwise(ast.parse(inspect.getsource(import_module(vj._HOMES[name]))).body):
        targets = getattr(statement, "targets", [getattr(statement, "target", None)])
        if [getattr(target, "id", None) for target in targets] == [name] and isinstance(below, ast.Expr):
            return inspect.cleandoc(ast.literal_eval(below.value))
    return ""


def complaint(name: str) -> str:
    """Return what is wrong with the example of a public name, or an empty string."""
    text = docstring(name).partition("**Example:**")[2]
    parsed = PARSER.get_doctest(text, {"vj": vj}, f"vibrojax.{name}", None, 0)
    if not parsed.examples:
        return f"vibrojax.{name} has no example: write one below **Example:** in its docstring"
    messages: list[str] = []
    doctest.DocTestRunner(verbose=False).run(parsed, out=messages.append)
    return "".join(messages)


@pytest.fixture(scope="module")
def complaints(tmp_path_factory):
    """Return the complaint of each name, from one process for all."""
    command = [sys.executable, "-W", "error", __file__]
    process = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path_factory.mktemp("examples"))
    assert process.returncode == 0, process.stderr
    return json.loads(process.stdout)


@pytest.mark.parametrize("name", vj.__all__)
@pytest.mark.long
def test_example_runs(name, complaints):
    assert not complaints[name], complaints[name]


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parents[1]))
    print(json.dumps({name: complaint(name) for name in sys.argv[1:] or vj.__all__}, indent=1))

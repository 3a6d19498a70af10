"""Every public name has an example in its docstring, and every example runs and says what stands below it.

They run as users have them, in a process without the strictness of the whole run: `python tests/test_examples.py NAME`
"""

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
    """What `help` and the site show of a public name; of a constant, the string below its assignment."""
    value = getattr(vj, name)
    if inspect.isclass(value) or inspect.isroutine(value) or inspect.ismodule(value):
        return inspect.getdoc(value) or ""
    for statement, below in pairwise(ast.parse(inspect.getsource(import_module(vj._HOMES[name]))).body):
        targets = getattr(statement, "targets", [getattr(statement, "target", None)])
        if [getattr(target, "id", None) for target in targets] == [name] and isinstance(below, ast.Expr):
            return inspect.cleandoc(ast.literal_eval(below.value))
    return ""


def complaint(name: str) -> str:
    """What is wrong with the example of a public name; empty where nothing is."""
    text = docstring(name).partition("**Example:**")[2]
    found = PARSER.get_doctest(text, {"vj": vj}, f"vibrojax.{name}", None, 0)
    if not found.examples:
        return f"vibrojax.{name} has no example: write one below **Example:** in its docstring"
    said: list[str] = []
    doctest.DocTestRunner(verbose=False).run(found, out=said.append)
    return "".join(said)


@pytest.fixture(scope="module")
def complaints(tmp_path_factory):
    """What is wrong, by name, from one process for all."""
    command = [sys.executable, "-W", "error", __file__]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path_factory.mktemp("examples"))
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.parametrize("name", vj.__all__)
@pytest.mark.long
def test_the_example_runs(name, complaints):
    assert not complaints[name], complaints[name]


def test_a_wrong_example_is_told(monkeypatch):
    def without():
        """Nothing."""

    def wrong():
        """One.

        **Example:**

        >>> len(vj.SCENES)
        0
        """

    monkeypatch.setattr(vj, "read_sweep", without)
    monkeypatch.setattr(vj, "picture", wrong)
    assert "has no example" in complaint("read_sweep")
    assert "Expected:" in complaint("picture")


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parents[1]))
    print(json.dumps({name: complaint(name) for name in sys.argv[1:] or vj.__all__}, indent=1))

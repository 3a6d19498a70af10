"""Test the site's pages without a build: links in texts, names in the reference, and the checker of built pages."""

import re
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from urllib.parse import unquote

import pytest
from links import faults

import vibrojax as vj

ROOT = Path(__file__).parents[1]
PAGES = sorted((ROOT / "notebooks").rglob("*.md"))
TEXTS = ["README.md", "CHANGELOG.md", ".github/CONTRIBUTING.md", "tests/benchmarks/README.md", "tests/hard/README.md"]
IMPORT = re.compile(r"from (vibrojax[\w.]*) import ([\w, ]+)")


def heading_anchors(text: str) -> set[str]:
    """Return the anchors of a text's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.+)$", text, flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("name", TEXTS)
def test_links_of_texts_have_targets(name):
    text = (ROOT / name).read_text()
    for link in re.findall(
        r"\]\(([^)\s]+)\)", re.sub(r"`[^`]*`|^```.*?^```", "", text, flags=re.MULTILINE | re.DOTALL)
    ):
        if link.startswith(("http://", "https://", "mailto:")):
            continue
        path, _, anchor = unquote(link).partition("#")
        target = (ROOT / name).parent / path if path else ROOT / name
        assert target.exists(), link
        assert not anchor or anchor in heading_anchors(target.read_text()), link


def test_files_named_in_readme_exist():
    text = (ROOT / "README.md").read_text()
    named = re.findall(r"`((?:notebooks|tests|vibrojax|\.github)/[\w/.-]+)`", text)
    assert len(named) > 8
    assert [name for name in named if not (ROOT / name).exists()] == []


def test_every_public_name_is_in_reference():
    text = "".join(path.read_text() for path in PAGES if path.parent.name == "api")
    documented = {
        name.rpartition(".")[2] for name in re.findall(r"^\.\. auto\w+:: ([\w.]+)$", text, flags=re.MULTILINE)
    }
    assert sorted(set(vj.__all__) - documented) == [], "write these onto a page of notebooks/api"


def exists(name: str) -> bool:
    """Return whether a dotted name is a module, or an attribute or field of one."""
    head, *rest = name.split(".")
    value = import_module(head)
    for index, part in enumerate(rest, 2):
        with suppress(ModuleNotFoundError):
            import_module(".".join(name.split(".")[:index]))
        if part in getattr(value, "__dataclass_fields__", {}):
            return index == len(rest) + 1
        if not hasattr(value, part):
            return False
        value = getattr(value, part)
    return True


def test_references_in_docstrings_resolve():
    names = {
        (path.name, name)
        for path in (ROOT / "vibrojax").rglob("*.py")
        for name in re.findall(r"\[(vibrojax[\w.]*)\]\[\]", path.read_text())
    }
    assert len(names) > 20
    assert [(file, name) for file, name in sorted(names) if not exists(name)] == []


def test_imports_on_pages_resolve():
    pages = [*PAGES, *(ROOT / "notebooks").rglob("*.ipynb"), *(ROOT / "notebooks").rglob("*.py"), ROOT / "README.md"]
    lines = {(path.name, line) for path in pages for line in IMPORT.findall(path.read_text())}
    assert len(lines) > 5
    for file, (module, names) in sorted(lines):
        for name in names.split(","):
            assert exists(f"{module}.{name.split()[0]}"), (file, module, name)


def test_every_page_is_in_table_of_contents():
    listed = set()
    for path in PAGES:
        for block in re.findall(r"```\{toctree\}\n(.*?)```", path.read_text(), flags=re.DOTALL):
            names = [line.strip() for line in block.splitlines() if line.strip() and not line.startswith(":")]
            listed |= {(path.parent / name).resolve() for name in names}
    pages = {path.with_suffix("").resolve() for path in [*PAGES, *(ROOT / "notebooks").glob("*.ipynb")]}
    assert pages - listed == {(ROOT / "notebooks" / "index").resolve()} and listed <= pages


def test_notebooks_have_no_stored_outputs():
    assert [path.name for path in (ROOT / "notebooks").glob("*.ipynb") if '"output_type"' in path.read_text()] == []


def test_dead_links_are_reported(tmp_path):
    page = '<h1 id="a b">x</h1><a href="other.html#c">x</a><a href="#a%20b">x</a><a href="https://x.org/">x</a>'
    (tmp_path / "page.html").write_text(page)
    (tmp_path / "other.html").write_text('<p id="c"><img src="page.html"><a href="page.html">x</a>')
    assert faults(tmp_path) == []
    wrong = '<a href="page.html#d">x</a><a href="gone.html">x</a><script src="https://x.org/y.js"></script>'
    (tmp_path / "wrong.html").write_text(wrong)
    assert faults(tmp_path) == [
        "wrong.html: loads https://x.org/y.js from elsewhere",
        "wrong.html: page.html#d has no such place",
        "wrong.html: gone.html is not there",
    ]
    assert faults(tmp_path / "none") == [f"{tmp_path / 'none'}: no pages"]

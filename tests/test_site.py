"""Test links in texts, names in the reference, the checker of built pages, and the actions and commands of CI."""

import re
import subprocess
from pathlib import Path
from urllib.parse import unquote

import pytest
from links import faults

import vibrojax as vj

ROOT = Path(__file__).parents[1]
PAGES = sorted((ROOT / "notebooks").rglob("*.md"))
TEXTS = ["README.md", "CHANGELOG.md", ".github/CONTRIBUTING.md", "tests/benchmarks/README.md", "tests/hard/README.md"]


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


def test_every_public_name_is_in_reference():
    text = "".join(path.read_text() for path in PAGES if path.parent.name == "api")
    documented = {
        name.rpartition(".")[2] for name in re.findall(r"^\.\. auto\w+:: ([\w.]+)$", text, flags=re.MULTILINE)
    }
    assert sorted(set(vj.__all__) - documented) == [], "write these onto a page of notebooks/api"


def test_gallery_shows_every_script_with_its_picture():
    """The build of the site runs the scripts, and an error in one of them ends it."""
    names = sorted(script.stem for script in (ROOT / "notebooks" / "gallery").glob("*.py"))
    page = (ROOT / "notebooks" / "gallery.md").read_text()
    assert len(names) >= 12
    assert sorted(re.findall(r"\{literalinclude\} gallery/(\w+)\.py", page)) == names
    assert sorted(re.findall(r'^made_by\("(\w+)"\)$', page, re.MULTILINE)) == names
    assert len(re.findall(r'^    alt: "[^"]+"$', page, re.MULTILINE)) == len(names)


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


def test_actions_are_pinned_by_commit():
    texts = [path.read_text() for path in (ROOT / ".github/workflows").glob("*.yml")]
    used = [action for text in texts for action in re.findall(r"uses: (\S+)", text)]
    assert len(texts) == 2 and used and all(re.fullmatch(r"[\w/-]+@[0-9a-f]{40}", action) for action in used)


@pytest.mark.parametrize("changed", ["bin/pytest", "bin/sphinx-build"])
def test_other_commands_in_the_readme_are_not_run(changed, tmp_path):
    """The script stops before it installs anything, or for the site, before it runs the command."""
    script = (ROOT / ".ci/run").read_text()
    checks = re.findall(r"^(?:test_command=|site_command=|expect ).*$", script, re.M)
    [define] = re.findall(r"^expect\(\) \{\n.*?\n\}$", script, re.M | re.S)
    for readme, passes in (((ROOT / "README.md").read_text(), True), ("", False)):
        text = readme or (ROOT / "README.md").read_text().replace(changed, f"{changed} --curl")
        (tmp_path / "README.md").write_text(text)
        words = ["bash", "-euo", "pipefail", "-c", "\n".join([define, *checks, "echo passed"])]
        done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True)
        assert ("passed" in done.stdout) == passes and ("has another command" in done.stderr) == (not passes)

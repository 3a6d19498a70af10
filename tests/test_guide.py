"""Tests of the guide: its commands run as written. The build of the site executes its Python."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import vibrojax as vj

ROOT = Path(__file__).parents[1]
NOTEBOOKS = ROOT / "notebooks"
REFERENCE = ("index", "commands", "files_and_symbols", "reproduction")
PAGES = sorted(path.stem for path in NOTEBOOKS.glob("*.md") if path.stem not in REFERENCE)
FENCE = re.compile(r"^```(?P<info>[^\n`]*)\n(?P<text>.*?)^```$", re.MULTILINE | re.DOTALL)
START = {match["info"]: match["text"] for match in FENCE.finditer((NOTEBOOKS / "start.md").read_text())}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a folder with the files of the first page, and the command."""
    path = tmp_path_factory.mktemp("start")
    (path / "map.toml").write_text(START["toml file=map.toml"].replace("num = 24", "num = 4"))
    (path / "vibrojax").write_text(f'#!/bin/sh\nexec "{sys.executable}" -m vibrojax "$@"\n')
    (path / "vibrojax").chmod(0o755)
    return path


def run(folder, block) -> subprocess.CompletedProcess:
    variables = os.environ | {"PYTHONPATH": str(ROOT), "PATH": f"{folder}:{os.environ['PATH']}"}
    return subprocess.run(["bash", "-ec", START[block]], cwd=folder, env=variables, capture_output=True, text=True)


def test_first_motion(folder):
    process = run(folder, "sh run=motion")
    assert process.returncode == 0, process.stderr
    assert process.stdout.splitlines()[0] == START[""].strip()
    assert (folder / "vibro-impact.nc").is_file() and (folder / "vibro-impact.png").is_file()


def test_wrong_name(folder):
    process = run(folder, "sh run=wrong status=2")
    assert process.returncode == 2 and process.stdout == ""
    (line,) = process.stderr.splitlines()
    assert 'did you mean "gamma"?' in line


def test_first_map(folder):
    process = run(folder, "sh run=map")
    assert process.returncode == 0, process.stderr
    assert [line.split()[0] for line in process.stdout.splitlines()[:4]] == ["lanes", "memory", "disk", "time"]
    assert (folder / "map.png").is_file()
    ds = vj.open_dataset(folder / "map.nc")
    assert dict(ds.sizes) | {"beta": 4, "gamma": 4, "start": 2} == dict(ds.sizes)
    process = run(folder, "sh run=plot")
    assert process.returncode == 0, process.stderr
    assert (folder / "stick.png").is_file()
    process = run(folder, "sh run=explore")
    assert process.returncode == 0, process.stderr
    assert (folder / "map.html").read_text().startswith("<!doctype html>")


@pytest.mark.parametrize("page", PAGES)
def test_page_first_states_what_it_teaches(page):
    text = re.sub(r"\A---\n.*?^---\n", "", (NOTEBOOKS / f"{page}.md").read_text(), flags=re.MULTILINE | re.DOTALL)
    title, first, *_ = text.strip().split("\n\n")
    assert title.startswith("# ") and "\n" not in title
    assert first.startswith("After this page you ")


@pytest.mark.parametrize("page", [page for page in PAGES if page != "large_sweeps"])
def test_all_code_of_page_is_run(page):
    """Python is executed. Commands and files are run here, except the installation and a table of another project.

    `test_large_sweeps.py` runs those of the page that is left out.
    """
    blocks = [match for match in FENCE.finditer((NOTEBOOKS / f"{page}.md").read_text())]
    code = [match["info"] for match in blocks if re.match(r"(python|sh|toml)\b", match["info"])]
    assert [info for info in code if "=" not in info] == {"start": ["sh"], "your_own": ["toml"]}.get(page, [])
    assert not [match["info"] for match in blocks if match["info"].startswith("python")]

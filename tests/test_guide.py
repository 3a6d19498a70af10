"""The guide's commands are run as they stand there; its Python is executed where the site is built."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import vibrojax as vj

ROOT = Path(__file__).parents[1]
NOTEBOOKS = ROOT / "notebooks"
PAGES = ("start", "machine", "regimes", "accuracy", "orbits_and_borders", "attractors", "rock_and_law", "your_own")
PAGES += ("limits", "comparison", "gallery")
FENCE = re.compile(r"^```(?P<info>[^\n`]*)\n(?P<text>.*?)^```$", re.MULTILINE | re.DOTALL)
START = {match["info"]: match["text"] for match in FENCE.finditer((NOTEBOOKS / "start.md").read_text())}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with the files of the first page, and the command."""
    path = tmp_path_factory.mktemp("start")
    (path / "map.toml").write_text(START["toml file=map.toml"])
    (path / "vibrojax").write_text(f'#!/bin/sh\nexec "{sys.executable}" -m vibrojax "$@"\n')
    (path / "vibrojax").chmod(0o755)
    return path


def run(folder, block) -> subprocess.CompletedProcess:
    variables = os.environ | {"PYTHONPATH": str(ROOT), "PATH": f"{folder}:{os.environ['PATH']}"}
    return subprocess.run(["bash", "-ec", START[block]], cwd=folder, env=variables, capture_output=True, text=True)


def test_the_first_motion(folder):
    done = run(folder, "sh run=motion")
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[0] == START[""].strip()
    assert (folder / "vibro-impact.nc").is_file() and (folder / "vibro-impact.png").is_file()


def test_a_wrong_name(folder):
    done = run(folder, "sh run=wrong status=2")
    assert done.returncode == 2 and done.stdout == ""
    (line,) = done.stderr.splitlines()
    assert 'did you mean "gamma"?' in line


def test_the_first_map(folder):
    done = run(folder, "sh run=map")
    assert done.returncode == 0, done.stderr
    assert [line.split()[0] for line in done.stdout.splitlines()[:4]] == ["lanes", "memory", "disk", "time"]
    assert (folder / "map.png").is_file()
    ds = vj.open_dataset(folder / "map.nc")
    assert dict(ds.sizes) | {"beta": 24, "gamma": 24, "start": 2} == dict(ds.sizes)
    done = run(folder, "sh run=plot")
    assert done.returncode == 0, done.stderr
    assert (folder / "stick.png").is_file()


@pytest.mark.parametrize("page", PAGES)
def test_a_page_says_first_what_one_can_do_after_it(page):
    text = re.sub(r"\A---\n.*?^---\n", "", (NOTEBOOKS / f"{page}.md").read_text(), flags=re.MULTILINE | re.DOTALL)
    title, first, *_ = text.strip().split("\n\n")
    assert title.startswith("# ") and "\n" not in title
    assert first.startswith("After this page you ")


@pytest.mark.parametrize("page", PAGES)
def test_no_code_of_a_page_is_only_shown(page):
    """Python is executed; commands and files are run here, but for the installation and a table of another's project."""
    shown = [match for match in FENCE.finditer((NOTEBOOKS / f"{page}.md").read_text())]
    left = [match["info"] for match in shown if re.match(r"(python|sh|toml)\b", match["info"])]
    assert [info for info in left if "=" not in info] == {"start": ["sh"], "your_own": ["toml"]}.get(page, [])
    assert not [match["info"] for match in shown if match["info"].startswith("python")]

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
PAGES = (
    "start",
    "machine",
    "regimes",
    "accuracy",
    "orbits_and_borders",
    "attractors",
    "rock_and_law",
    "rig_log",
    "your_own",
)
PAGES += ("gradients", "design", "studies", "limits", "comparison", "gallery", "how_it_works", "interactive_page")
PAGES += ("reliability", "structure", "calibration")
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
    done = run(folder, "sh run=explore")
    assert done.returncode == 0, done.stderr
    assert (folder / "map.html").read_text().startswith("<!doctype html>")


def rows(text: str) -> dict[str, list[str]]:
    """The cells of the tables of a text, by the first of each row."""
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines() if line[:1] == "|"]
    return {first: rest for first, *rest in cells}


def test_the_race_is_that_of_the_benchmarks():
    """At an error of 1e-4, with the digits that are told."""
    benchmarks = (ROOT / "tests" / "benchmarks" / "README.md").read_text()
    raced = rows("\n".join(line.replace("| 1e-04 |", "|") for line in benchmarks.splitlines() if "| 1e-04 |" in line))
    told = {way.partition(";")[0]: cells for way, cells in rows((NOTEBOOKS / "comparison.md").read_text()).items()}
    for way, name in {
        "here, certificate and twenty measures included": "vibrojax",
        "numba, the same Taylor steps written out by hand for this scene": "numba, Taylor series",
        "numba, Dormand-Prince 5(4), for this scene": "numba, Dormand-Prince 5(4)",
        "diffrax with its events, located in a loop of ours": "diffrax with its events",
        "C++ in SIMD, Runge-Kutta, smoothed friction": "C++ SIMD, RK4, smoothed",
        "diffrax, smoothed friction, adaptive": "diffrax, smoothed, adaptive",
        "SciPy, `solve_ivp` with events": "SciPy, solve_ivp with events",
    }.items():
        time, _, ratio, *_ = raced[name]
        assert [float(cell.replace(",", "")) for cell in told[way]] == pytest.approx(
            [float(time), float(ratio)], rel=0.025
        ), way


@pytest.mark.parametrize("page", PAGES)
def test_a_page_says_first_what_one_can_do_after_it(page):
    text = re.sub(r"\A---\n.*?^---\n", "", (NOTEBOOKS / f"{page}.md").read_text(), flags=re.MULTILINE | re.DOTALL)
    title, first, *_ = text.strip().split("\n\n")
    assert title.startswith("# ") and "\n" not in title
    assert first.startswith("After this page you ")


@pytest.mark.parametrize("page", PAGES)
def test_no_code_of_a_page_is_only_shown(page):
    """Python is executed; commands and files are run here, but for the installation and a table of another project."""
    shown = [match for match in FENCE.finditer((NOTEBOOKS / f"{page}.md").read_text())]
    left = [match["info"] for match in shown if re.match(r"(python|sh|toml)\b", match["info"])]
    assert [info for info in left if "=" not in info] == {"start": ["sh"], "your_own": ["toml"]}.get(page, [])
    assert not [match["info"] for match in shown if match["info"].startswith("python")]

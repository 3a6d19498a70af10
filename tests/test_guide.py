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
    """Return a folder with the files of the first page, and the command."""
    path = tmp_path_factory.mktemp("start")
    (path / "map.toml").write_text(START["toml file=map.toml"])
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
    assert dict(ds.sizes) | {"beta": 24, "gamma": 24, "start": 2} == dict(ds.sizes)
    process = run(folder, "sh run=plot")
    assert process.returncode == 0, process.stderr
    assert (folder / "stick.png").is_file()
    process = run(folder, "sh run=explore")
    assert process.returncode == 0, process.stderr
    assert (folder / "map.html").read_text().startswith("<!doctype html>")


def rows(text: str) -> dict[str, list[str]]:
    """Return the cells of the tables in a text, keyed by the first cell of each row."""
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines() if line[:1] == "|"]
    return {first: rest for first, *rest in cells}


def test_race_matches_benchmarks():
    """Compare the rows at an error of 1e-4, to the digits of the page."""
    benchmarks = (ROOT / "tests" / "benchmarks" / "README.md").read_text()
    measured = rows(
        "\n".join(line.replace("| 1e-04 |", "|") for line in benchmarks.splitlines() if "| 1e-04 |" in line)
    )
    printed = {
        label.partition(";")[0]: cells for label, cells in rows((NOTEBOOKS / "comparison.md").read_text()).items()
    }
    for label, name in {
        "here, certificate and twenty measures included": "vibrojax",
        "numba, the same Taylor steps written out by hand for this scene": "numba, Taylor series",
        "numba, Dormand-Prince 5(4), for this scene": "numba, Dormand-Prince 5(4)",
        "diffrax with its events, located in a loop of ours": "diffrax with its events",
        "C++ in SIMD, Runge-Kutta, smoothed friction": "C++ SIMD, RK4, smoothed",
        "diffrax, smoothed friction, adaptive": "diffrax, smoothed, adaptive",
        "SciPy, `solve_ivp` with events": "SciPy, solve_ivp with events",
    }.items():
        time, _, ratio, *_ = measured[name]
        assert [float(cell.replace(",", "")) for cell in printed[label]] == pytest.approx(
            [float(time), float(ratio)], rel=0.025
        ), label


@pytest.mark.parametrize("page", PAGES)
def test_page_first_states_what_it_teaches(page):
    text = re.sub(r"\A---\n.*?^---\n", "", (NOTEBOOKS / f"{page}.md").read_text(), flags=re.MULTILINE | re.DOTALL)
    title, first, *_ = text.strip().split("\n\n")
    assert title.startswith("# ") and "\n" not in title
    assert first.startswith("After this page you ")


@pytest.mark.parametrize("page", PAGES)
def test_all_code_of_page_is_run(page):
    """Python is executed. Commands and files are run here, except the installation and a table of another project."""
    blocks = [match for match in FENCE.finditer((NOTEBOOKS / f"{page}.md").read_text())]
    code = [match["info"] for match in blocks if re.match(r"(python|sh|toml)\b", match["info"])]
    assert [info for info in code if "=" not in info] == {"start": ["sh"], "your_own": ["toml"]}.get(page, [])
    assert not [match["info"] for match in blocks if match["info"].startswith("python")]

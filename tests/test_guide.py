"""Tests of the guide: its commands run as written. The build of the site executes its Python."""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
import xarray as xr

import vibrojax as vj
from vibrojax.cli import main

ROOT = Path(__file__).parents[1]
NOTEBOOKS = ROOT / "notebooks"
REFERENCE = ("index", "commands", "files_and_symbols", "reproduction")
PAGES = sorted(path.stem for path in NOTEBOOKS.glob("*.md") if path.stem not in REFERENCE)
FENCE = re.compile(r"^```(?P<info>[^\n`]*)\n(?P<text>.*?)^```$", re.MULTILINE | re.DOTALL)
START, LARGE = (
    {match["info"]: match["text"] for match in FENCE.finditer((NOTEBOOKS / f"{name}.md").read_text())}
    for name in ("start", "large_sweeps")
)


def run(block, page=START) -> list[int]:
    """Run the commands of a block, and return their exit statuses."""
    lines = [shlex.split(line) for line in page[block].splitlines()]
    assert all(line[0] == "vibrojax" for line in lines)
    return [main(line[1:]) for line in lines]


def test_first_motion(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert run("sh run=motion") == [0]
    assert capsys.readouterr().out.splitlines()[0] == START[""].strip()
    assert Path("vibro-impact.nc").is_file() and Path("vibro-impact.png").is_file()
    assert run("sh run=wrong status=2") == [2]
    (line,) = capsys.readouterr().err.splitlines()
    assert 'did you mean "gamma"?' in line


def test_first_map(tmp_path, monkeypatch, capsys):
    """With a coarser grid."""
    monkeypatch.chdir(tmp_path)
    Path("map.toml").write_text(START["toml file=map.toml"].replace("num = 24", "num = 2"))
    assert run("sh run=map") == [0, 0, 0]
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines[:4]] == ["lanes", "memory", "disk", "time"]
    ds = vj.open_dataset("map.nc")
    assert dict(ds.sizes) | {"beta": 2, "gamma": 2, "start": 2} == dict(ds.sizes)
    assert run("sh run=plot") == [0] and run("sh run=explore") == [0]
    assert Path("map.png").is_file() and Path("stick.png").is_file()
    assert Path("map.html").read_text().startswith("<!doctype html>")


@pytest.mark.long
def test_large_sweep(tmp_path, monkeypatch, capsys):
    pytest.importorskip("distributed")
    monkeypatch.chdir(tmp_path)
    Path("map.toml").write_text(LARGE["toml file=map.toml"])
    assert run("sh run=plan", LARGE) == [0]
    assert capsys.readouterr().out.startswith("lanes   60 (6 beta x 5 gamma x 2 start) in 8 chunks\n")
    Path("by_dask.py").write_text(LARGE["python file=by_dask.py"])
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    subprocess.run([sys.executable, *LARGE["sh run=dask"].split()[1:]], env=environment, check=True)
    expected = vj.run_sweep("map.toml", progress=False)
    xr.testing.assert_equal(vj.open_dataset("dask.nc"), expected)


@pytest.mark.parametrize("page", [page for page in PAGES if page != "large_sweeps"])
def test_all_code_of_page_is_run(page):
    """Python is executed. Commands and files are run here, except the installation and a table of another project.

    Another test runs those of the page that is left out.
    """
    blocks = [match for match in FENCE.finditer((NOTEBOOKS / f"{page}.md").read_text())]
    code = [match["info"] for match in blocks if re.match(r"(python|sh|toml)\b", match["info"])]
    assert [info for info in code if "=" not in info] == {"start": ["sh"], "your_own": ["toml"]}.get(page, [])
    assert not [match["info"] for match in blocks if match["info"].startswith("python")]

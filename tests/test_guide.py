"""Tests of the guide and the README: their commands run as written. The build of the site executes Python."""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
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


def test_first_motion(here, capsys):
    assert run("sh run=motion") == [0]
    assert capsys.readouterr().out.splitlines()[0] == START[""].strip()
    assert Path("vibro-impact.nc").is_file() and Path("vibro-impact.png").is_file()
    assert run("sh run=wrong status=2") == [2]
    (line,) = capsys.readouterr().err.splitlines()
    assert 'did you mean "gamma"?' in line


def test_first_map(here, capsys):
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
def test_large_sweep(here, capsys):
    pytest.importorskip("distributed")
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
    Another test runs those of the page that is left out."""
    blocks = [match for match in FENCE.finditer((NOTEBOOKS / f"{page}.md").read_text())]
    code = [match["info"] for match in blocks if re.match(r"(python|sh|toml)\b", match["info"])]
    assert [info for info in code if "=" not in info] == {"start": ["sh"], "your_own": ["toml"]}.get(page, [])
    assert not [match["info"] for match in blocks if match["info"].startswith("python")]


# The commands of the README's table, on small files of the reader's own
README = (Path(__file__).parents[1] / "README.md").read_text(encoding="utf-8")
TABLE = README.split("## I want to …")[1].split("\n\n")[1]
COMMANDS = [words for words in re.findall(r"`vibrojax ([^`]+)`", TABLE) if not words.startswith("accuracy")]
"""Without `accuracy`, which takes minutes and has tests of its own."""

MAP = """scene = "vibro-impact"
[grid]
beta = {start = 0.35, stop = 0.5, num = 4}
gamma = {start = 0.6, stop = 0.75, num = 4}
delta = [-0.005, 0.005]
"""
STARTS = """scene = "vibro-impact"
parameters = {beta = 0.4, delta = 0.0}
grid = {gamma = [0.6, 0.7]}
starts = {sample = "sobol", count = 8, box = {x2 = [-0.02, 0.0]}}
"""
ROCK = """scene = "drilling"
starts = ["stuck"]
parameters = {rock = "granite"}
grid = {v = [1.4, 1.5, 1.6]}
"""
DRILL = """scene = "vibro-impact"
start = "stuck"
data = {v = [1.2, 1.5, 1.8], period = [0.230586, 0.229602, 0.228930]}
unknown = {beta = [0.3, 0.5]}
parameters = {delta = 0.005, gamma = 0.75}
searches = 1
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a folder with the files that the table names."""
    folder = tmp_path_factory.mktemp("readme")
    for name, text in {"map": MAP, "starts": STARTS, "rock": ROCK, "drill": DRILL}.items():
        (folder / f"{name}.toml").write_text(text)
    vj.run_sweep(str(folder / "map.toml"), progress=False).to_netcdf(folder / "map.nc")
    rates = vj.run_sweep(str(folder / "rock.toml"), progress=False)
    for name in ("speeds", "rates"):
        rates.to_netcdf(folder / f"{name}.nc")
    point = {"along": "gamma", "at": 0.75, "span": (0.55, 0.8), "delta": 0.005, "start": "stuck"}
    vj.follow("vibro-impact", **point, progress=False).to_netcdf(folder / "family.nc")
    weight = np.linspace(40.0, 120.0, 200)
    log = {
        "depth (m)": 1000 + np.arange(200.0),
        "WOB (kN)": weight,
        "ROP (m/h)": 15 * np.log(weight / 30),
        "RPM": 120.0,
    }
    pd.DataFrame(log | {"torque (kN m)": 0.05 * weight}).to_csv(folder / "log.csv", index=False)
    return folder


@pytest.mark.long
@pytest.mark.parametrize("words", COMMANDS)
def test_command_of_the_readme(words, folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    before = {path.name for path in folder.iterdir()}
    assert main(shlex.split(words)) == 0, capsys.readouterr().err
    quiet = words.split()[0] in ("info", "scenes") or "--dry-run" in words
    assert quiet or {path.name for path in folder.iterdir()} > before

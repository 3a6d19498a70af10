"""Test that every command of the README's table runs, on small files of the reader's own, and writes its result."""

import re
import shlex
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import vibrojax as vj
from vibrojax.cli import main

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

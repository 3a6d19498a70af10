"""Tests of the page on large sweeps: its commands run as written, and give the result of a plain run."""

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import vibrojax as vj

pytestmark = pytest.mark.long

ROOT = Path(__file__).parents[1]
BLOCK = re.compile(r"^```(\w+) (file|run)=(\S+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
BLOCKS = {name: text for _, _, name, text in BLOCK.findall((ROOT / "notebooks/large_sweeps.md").read_text())}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a folder with the files of the page."""
    path = tmp_path_factory.mktemp("page")
    for name, text in BLOCKS.items():
        if "." in name:
            (path / name).write_text(text)
    commands = path / "bin"
    commands.mkdir()
    (commands / "vibrojax").write_text(f'#!/bin/sh\nexec "{sys.executable}" -m vibrojax "$@"\n')
    (commands / "python").write_text(f'#!/bin/sh\nexec "{sys.executable}" "$@"\n')
    for command in commands.iterdir():
        command.chmod(0o755)
    return path


@pytest.fixture(scope="module")
def expected(folder):
    return vj.run_sweep(folder / "map.toml", progress=False)


def start_script(folder, script, **environment) -> subprocess.Popen:
    variables = os.environ | {"PYTHONPATH": str(ROOT), "PATH": f"{folder / 'bin'}:{os.environ['PATH']}"} | environment
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen(["bash", "-e", *script], cwd=folder, env=variables, **pipes)


def output_of(process) -> str:
    out, errors = process.communicate()
    assert process.returncode == 0, errors
    return out


def assert_same(path, expected):
    result = vj.open_dataset(path)
    for name in expected.variables:
        np.testing.assert_array_equal(result[name].values, expected[name].values, err_msg=name)


def test_plan(folder):
    lines = output_of(start_script(folder, ["-c", BLOCKS["plan"]])).splitlines()
    assert [line.split()[0] for line in lines] == ["lanes", "memory", "disk", "time"] * 2
    assert lines[0] == "lanes   60 (6 beta x 5 gamma x 2 start) in 8 chunks"


def test_dask(folder, expected):
    pytest.importorskip("distributed")
    output_of(start_script(folder, ["-c", BLOCKS["dask"]]))
    assert_same(folder / "dask.nc", expected)

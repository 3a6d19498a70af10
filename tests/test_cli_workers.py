"""Test the options for workers: one-line refusals, and the progress of a sweep."""

import tracemalloc

import pytest

from vibrojax.cli import main

TEXT = """
scene = "rotary"
title = "a map"
starts = ["stuck"]
[grid]
v = { start = 1.0, stop = 2.0, num = 20 }
[run]
settle = 0.5
observe = 0.5
chunk = 4
"""


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "map.toml").write_text(TEXT)
    return tmp_path


def refused(capsys, *argv) -> str:
    assert main(list(argv)) == 2
    captured = capsys.readouterr()
    assert captured.out == "" and captured.err.count("\n") == 1 and captured.err.startswith("vibrojax: ")
    return captured.err


@pytest.mark.parametrize(
    "words, problem",
    [
        (["--workers", "nonsense"], '--workers: "nonsense" is not dask://HOST:PORT, slurm or slurm:N'),
        (["--workers", "slurm:0"], "slurm:N (N from 1 to 1000)"),
        (["--workers", "slurm"], "--workers slurm: there is no sbatch and no srun here"),
    ],
)
def test_bad_options_are_refused_before_any_work(words, problem, capsys, folder, monkeypatch):
    monkeypatch.setenv("PATH", str(folder))
    assert problem in refused(capsys, "sweep", "map.toml", *words)
    assert [path.name for path in folder.iterdir()] == ["map.toml"]


MANY = TEXT.replace("chunk = 4", "").replace(
    "v = { start = 1.0, stop = 2.0, num = 20 }",
    "v = { start = 1.0, stop = 2.0, num = 10000 }\nc2 = { start = 0.0, stop = 2500.0, num = 10000 }",
)


def test_hundred_million_lanes_need_only_disk(capsys, folder):
    """Neither the memory of the plan nor that of the estimate grows with the number of lanes."""
    (folder / "map.toml").write_text(MANY)
    tracemalloc.start()
    main(["sweep", "map.toml", "--dry-run"])  # refused on a small disk
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 50e6 and not (folder / "map.nc.chunks").exists()
    captured = capsys.readouterr()
    assert "100000000 lanes" in captured.err or captured.out.startswith("lanes   100000000 (10000 v x 10000 c2 x 1")

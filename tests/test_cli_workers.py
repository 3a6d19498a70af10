"""Test the options for workers: one-line refusals, and the progress of a sweep."""

import sys
import tracemalloc
from types import SimpleNamespace

import pytest

from vibrojax.cli import main
from vibrojax.periodic.lane_stages import CHUNK

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
        (["--workers", "2"], "is not dask://HOST:PORT, slurm or slurm:N"),
        (["--workers", "dask://host"], "is not dask://HOST:PORT"),
        (["--workers", "slurm:0"], "slurm:N (N from 1 to 1000)"),
        (["--workers", "slurm"], "--workers slurm: there is no sbatch and no srun here"),
    ],
)
def test_bad_options_are_refused_before_any_work(words, problem, capsys, folder, monkeypatch):
    monkeypatch.setenv("PATH", str(folder))
    assert problem in refused(capsys, "sweep", "map.toml", *words)
    assert [path.name for path in folder.iterdir()] == ["map.toml"]


@pytest.mark.parametrize(
    "words, module, extra",
    [
        (["--workers", "dask://localhost:8786"], "distributed", "dask"),
        (["--workers", "slurm"], "submitit", "slurm"),
        (["-o", "map.zarr"], "zarr", "zarr"),
    ],
)
def test_missing_extra_is_named(words, module, extra, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, module, None)
    assert f'not installed; pip install "vibrojax[{extra}]"' in refused(capsys, "sweep", "map.toml", *words)


def test_unreachable_scheduler_is_reported(capsys, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr("vibrojax.cli.sweeps.SCHEDULER_TIMEOUT", "0.3 s")
    line = refused(capsys, "sweep", "map.toml", "--workers", "dask://127.0.0.1:1")
    assert "--workers dask://127.0.0.1:1: no scheduler of dask answers there" in line


def test_dry_run(capsys, folder):
    assert main(["sweep", "map.toml", "--dry-run"]) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == ["lanes", "memory", "disk", "time"]
    assert [path.name for path in folder.iterdir()] == ["map.toml"]


MANY = TEXT.replace("chunk = 4", "").replace(
    "v = { start = 1.0, stop = 2.0, num = 20 }",
    "v = { start = 1.0, stop = 2.0, num = 10000 }\nc2 = { start = 0.0, stop = 2500.0, num = 10000 }",
)
MANY_CHUNKS = -(-(10**8) // CHUNK)


@pytest.mark.parametrize("free, fits", [(10**10, False), (10**11, True)])
def test_hundred_million_lanes_need_only_disk(free, fits, capsys, folder, monkeypatch):
    """Neither the memory of the plan nor that of the estimate grows with the number of lanes."""
    (folder / "map.toml").write_text(MANY)
    monkeypatch.setattr("vibrojax.maps.cost.shutil.disk_usage", lambda _: SimpleNamespace(free=free))
    tracemalloc.start()
    status = main(["sweep", "map.toml", "--dry-run"])
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    captured = capsys.readouterr()
    assert status == (0 if fits else 2) and peak < 50e6
    if fits:
        lines = dict(line.split(maxsplit=1) for line in captured.out.splitlines())
        assert lines["lanes"].startswith(f"100000000 (10000 v x 10000 c2 x 1 start) in {MANY_CHUNKS} chunks")
        assert float(lines["memory"].removesuffix(" MB")) < 1500
    else:
        assert (
            "grid: 100000000 lanes need about" in captured.err
            and "; there is 10 GB of disk: give shorter axes" in captured.err
        )
        assert main(["sweep", "map.toml"]) == 2 and not (folder / "map.nc.chunks").exists()

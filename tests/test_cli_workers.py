"""Test the options for workers: one-line refusals, and the progress of a sweep."""

import json
import sys
import tracemalloc
from types import SimpleNamespace

import pytest

from vibrojax.analyses.sweep.run import run_share
from vibrojax.analyses.sweep.workers.work import by_cost
from vibrojax.cli import main
from vibrojax.sweep.engine.chunks import CHUNK, Chunks
from vibrojax.sweep.input.read import read_sweep

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
        (["--only", "4/3"], '--only: "4/3" is not I/N with I from 1 to N; write 2/3'),
        (["--only", "0/3"], "is not I/N"),
        (["--only", "1"], "is not I/N"),
        (["--only", "a/b"], "is not I/N"),
        (["--only", "1/2", "--fresh"], "--fresh: has no use with --only"),
        (["--only", "1/2", "--workers", "2"], "not allowed with argument"),
        (["--workers", "nonsense"], '--workers: "nonsense" is not a number (1 to 1000), dask://HOST:PORT, slurm'),
        (["--workers", "0"], "is not a number (1 to 1000)"),
        (["--workers", "-1"], "--workers"),
        (["--workers", "dask://host"], "is not a number (1 to 1000), dask://HOST:PORT"),
        (["--workers", "slurm:0"], "slurm or slurm:JOBS"),
        (["--workers", "slurm"], "--workers slurm: there is no sbatch and no srun on this machine"),
        (["--measure"], "--measure: has no use without --dry-run"),
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


def test_progress_of_shared_sweep(capsys, folder):
    assert main(["sweep", "map.toml", "--only", "1/3"]) == 0
    assert capsys.readouterr().out == "map.nc: share 1/3 is done; 3 of 5 chunks are left to others\n"
    (folder / "map.nc.chunks" / "chunk-00000002.failed").write_text(
        json.dumps({"chunk": 2, "by": "far, process 7", "why": "MemoryError: too much"})
    )
    for name in ("map.nc", "map.nc.chunks"):
        assert main(["info", name]) == 0
        lines = capsys.readouterr().out.splitlines()
        assert lines[:3] == ["title     a map", "finished  2 of 5 chunks (40 %)", "lanes     8 of 20"]
        assert "failed    chunk 2: MemoryError: too much (far, process 7)" in lines
        assert "at work   none" in lines
    assert main(["info", "map.nc", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["chunks"] == {"finished": 2, "all": 5, "size": 4} and facts["lanes"] == {"finished": 8, "all": 20}
    assert [failure["chunk"] for failure in facts["failures"]] == [2]
    assert main(["sweep", "map.toml", "--only", "2/3", "--quiet"]) == 0
    assert main(["sweep", "map.toml", "--only", "3/3"]) == 0
    assert capsys.readouterr().out.startswith("map.nc: 20 lanes (a point from one start each); picture map.png")
    assert not (folder / "map.nc.chunks").exists()


def test_shares_of_another_sweep_are_refused(capsys):
    assert main(["sweep", "map.toml", "--only", "1/3", "--quiet"]) == 0
    line = refused(capsys, "sweep", "map.toml", "--only", "2/3", "--set", "mu=0.3")
    assert "holds chunks of another sweep: parameters.mu was 0.4, is 0.3" in line


def test_failed_chunk_is_reported(capsys, monkeypatch, folder):
    from vibrojax.sweep.engine.chunks import Chunks
    from vibrojax.sweep.input.read import read_sweep

    def compute(self, index, *rest):
        raise MemoryError("too much")

    monkeypatch.setattr(Chunks, "compute", compute)
    with pytest.raises(MemoryError):
        run_share(read_sweep("map.toml"), folder / "map.nc", (2, 3), progress=False)
    assert main(["info", "map.nc"]) == 0
    assert "failed    chunk 1: MemoryError: too much (" in capsys.readouterr().out


def test_folder_without_chunks_is_refused(capsys, folder):
    (folder / "other.nc.chunks").mkdir()
    assert "other.nc.chunks: is not a folder of a sweep's chunks" in refused(capsys, "info", "other.nc.chunks")
    assert "none.nc: there is no such file" in refused(capsys, "info", "none.nc")


def test_dry_run_with_measurement(capsys):
    assert main(["sweep", "map.toml", "--dry-run", "--measure"]) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == ["lanes", "memory", "disk", "time"]
    assert main(["sweep", "map.toml", "--dry-run", "--set", "v=[1.0,2.0]", "--set", "run.settle=1e9"]) == 0


MANY = TEXT.replace("chunk = 4", "").replace(
    "v = { start = 1.0, stop = 2.0, num = 20 }",
    "v = { start = 1.0, stop = 2.0, num = 10000 }\nc2 = { start = 0.0, stop = 2500.0, num = 10000 }",
)
MANY_CHUNKS = -(-(10**8) // CHUNK)


@pytest.mark.parametrize("free, fits", [(10**10, False), (10**11, True)])
def test_hundred_million_lanes_need_only_disk(free, fits, capsys, folder, monkeypatch):
    """Neither the memory of the plan nor that of the estimate grows with the number of lanes."""
    (folder / "map.toml").write_text(MANY)
    monkeypatch.setattr("vibrojax.sweep.engine.costs.shutil.disk_usage", lambda _: SimpleNamespace(free=free))
    tracemalloc.start()
    status = main(["sweep", "map.toml", "--dry-run"])
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    captured = capsys.readouterr()
    assert status == (0 if fits else 2) and peak < 50e6
    lines = dict(line.split(maxsplit=1) for line in captured.out.splitlines())
    assert lines["lanes"].startswith(f"100000000 (10000 v x 10000 c2 x 1 start) in {MANY_CHUNKS} chunks")
    assert float(lines["memory"].removesuffix(" MB")) < 1500
    if not fits:
        assert (
            "grid: 100000000 lanes need about" in captured.err
            and "; there is 10 GB of disk: give shorter axes" in captured.err
        )
        assert main(["sweep", "map.toml"]) == 2 and not (folder / "map.nc.chunks").exists()


def test_chunks_of_hundred_million_lanes_are_ordered(folder):
    """Order by cost, a few thousand chunks at a time."""
    (folder / "map.toml").write_text(MANY)
    chunks = Chunks(read_sweep("map.toml"))
    order = by_cost(chunks, range(chunks.count))
    assert sorted(order) == list(range(MANY_CHUNKS)) and order != sorted(order)

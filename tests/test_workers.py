"""Test that a sweep by several workers gives the same dataset, bit for bit, whoever computes its chunks."""

import json
import multiprocessing
import tracemalloc
from concurrent.futures import BrokenExecutor, Future, ProcessPoolExecutor, ThreadPoolExecutor

import pytest
import xarray as xr
from commands import TEXT
from refusals import command_refusal

import vibrojax as vj
from vibrojax.cli import main
from vibrojax.maps.run import run_to_file

SPAWN = multiprocessing.get_context("spawn")


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "map.toml"
    path.write_text(TEXT)
    return path


@pytest.fixture(scope="module")
def expected(tmp_path_factory):
    path = tmp_path_factory.mktemp("expected") / "map.toml"
    path.write_text(TEXT)
    return vj.run_sweep(path, progress=False)


def assert_same(dataset, expected):
    """Check that values are equal bit for bit, with names, order and units, and attributes of the result."""
    assert list(dataset.data_vars) == list(expected.data_vars)
    xr.testing.assert_identical(dataset.drop_attrs(deep=False), expected.drop_attrs(deep=False))
    assert dataset.attrs.keys() == expected.attrs.keys()
    for name in ("identity", "certified", "sweep", "lanes"):
        assert dataset.attrs[name] == expected.attrs[name], name
    assert json.loads(dataset.attrs["solver"])["steps"] == json.loads(expected.attrs["solver"])["steps"]


def test_spawned_pool_in_memory(file, expected):
    with ProcessPoolExecutor(1, mp_context=SPAWN) as executor:
        assert_same(vj.run_sweep(file, progress=False, executor=executor), expected)


def test_dask_cluster(file, expected):
    distributed = pytest.importorskip("distributed")
    out = file.with_name("out.nc")
    options = {"processes": False, "protocol": "tcp", "dashboard_address": ":0", "silence_logs": 50}
    with distributed.LocalCluster(1, threads_per_worker=1, **options) as cluster:
        address = cluster.scheduler_address.replace("tcp://", "dask://")
        assert main(["sweep", str(file), "-o", str(out), "--workers", address, "--quiet"]) == 0
    assert_same(vj.open_dataset(out), expected)


def test_zarr_output(file, expected):
    pytest.importorskip("zarr")
    out = file.with_name("out.zarr")
    for _ in range(2):  # the second run replaces the first
        dataset = run_to_file(vj.read_sweep(file), out, progress=False)
        assert_same(dataset, expected)
    assert {path.name for path in file.parent.iterdir()} == {"map.toml", "out.zarr"}


class FailingExecutor:
    """An executor that computes each chunk immediately, in this thread, unless `fails` holds of the requested ones."""

    def __init__(self, fails=lambda asked: False, error=None):
        self.fails, self.error, self.asked, self.threads = fails, error, [], set()

    def submit(self, fn, task, index, threads):
        future: Future = Future()
        self.asked.append(index)
        self.threads.add(threads)
        if self.fails(self.asked):
            future.set_exception(self.error)
        else:
            future.set_result(fn(task, index, threads))
        return future


FAILURES = [
    (lambda asked: asked[-1] == 3, MemoryError("too much"), "chunk 3 failed with a worker (MemoryError: too much)"),
    (lambda asked: len(asked) > 2, BrokenExecutor("a worker died"), "(BrokenExecutor: a worker died); the rest is"),
]


@pytest.mark.parametrize(("fails", "error", "warning"), FAILURES)
def test_failed_chunks_are_computed_locally(file, expected, capsys, fails, error, warning):
    """No chunk is requested twice."""
    executor = FailingExecutor(fails, error)
    assert_same(vj.run_sweep(file, progress=False, executor=executor), expected)
    lines = capsys.readouterr().err
    assert lines.count(warning) == 1 and lines.count("computed here") == 1
    assert sorted(executor.asked) == [0, 1, 2, 3, 4]


def test_workers_of_unknown_machines_use_one_core(file):
    """An executor such as that of SLURM states its number of workers, which do not share the cores of this machine."""
    executor = FailingExecutor()
    executor._max_workers = 1
    vj.run_sweep(file, progress=False, executor=executor)
    assert executor.threads == {1}


def test_executor_of_forked_processes_is_refused(file, tmp_path):
    executor = ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("fork"))
    with pytest.raises(vj.InputError, match="its processes are forked, and jax hangs in such; make it with mp_context"):
        vj.run_sweep(file, progress=False, executor=executor)
    law = vj.FrictionLaw(name="mine", reference="", parameters=vj.parameters.table(), mu=lambda u, p: 0.3 - 0.1 * u)
    sweep = {"scene": "vibro-impact", "parameters": {"friction": law}, "grid": {"beta": [0.4]}}
    with ThreadPoolExecutor(1) as executor, pytest.raises(vj.InputError, match="cannot be sent to other processes"):
        vj.run_sweep(sweep, progress=False, executor=executor)


def test_bad_options_are_refused_before_any_work(capsys, file, monkeypatch):
    monkeypatch.setenv("PATH", str(file.parent))
    for word, problem in (
        ("nonsense", '--workers: "nonsense" is not dask://HOST:PORT, slurm or slurm:N'),
        ("slurm:0", "slurm:N (N from 1 to 1000)"),
        ("slurm", "--workers slurm: there is no sbatch and no srun here"),
    ):
        assert problem in command_refusal(capsys, "sweep", file, "--workers", word)
    assert [path.name for path in file.parent.iterdir()] == ["map.toml"]


def test_hundred_million_lanes_need_only_disk(capsys, file):
    """Neither the memory of the plan nor that of the estimate grows with the number of lanes."""
    axes = "v = { start = 1.0, stop = 2.0, num = 10000 }\nc2 = { start = 0.0, stop = 2500.0, num = 10000 }"
    file.write_text(f'scene = "rotary"\nstarts = ["stuck"]\n[grid]\n{axes}\n[run]\nsettle = 0.5\nobserve = 0.5\n')
    out = file.with_name("map.nc")
    tracemalloc.start()
    main(["sweep", str(file), "-o", str(out), "--dry-run"])  # refused on a small disk
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 50e6 and [path.name for path in file.parent.iterdir()] == ["map.toml"]
    captured = capsys.readouterr()
    assert "100000000 lanes" in captured.err or captured.out.startswith("lanes   100000000 (10000 v x 10000 c2 x 1")

"""Test that a sweep by several workers gives the same dataset, bit for bit, whoever computes its chunks."""

import json
import multiprocessing
import os
import shutil
import subprocess
import sys
from concurrent.futures import BrokenExecutor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from commands import ROOT, TEXT

import vibrojax as vj
from vibrojax.errors import InputError
from vibrojax.maps.executor import compute_chunk
from vibrojax.maps.read import read_sweep
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
    assert list(dataset.data_vars) == list(expected.data_vars) and dataset.coords.keys() == expected.coords.keys()
    for name in expected.variables:
        variable, reference = dataset[name], expected[name]
        assert (
            variable.dims == reference.dims
            and variable.dtype == reference.dtype
            and variable.attrs.keys() == reference.attrs.keys()
        ), name
        assert (
            variable.values.tolist() == reference.values.tolist()
            or variable.values.tobytes() == reference.values.tobytes()
        ), name
    assert dataset.attrs.keys() == expected.attrs.keys()
    for name in ("identity", "certified", "sweep", "lanes"):
        assert dataset.attrs[name] == expected.attrs[name], name
    assert json.loads(dataset.attrs["solver"])["steps"] == json.loads(expected.attrs["solver"])["steps"]


def test_spawned_pool_in_memory(file, expected):
    with ProcessPoolExecutor(2, mp_context=SPAWN) as executor:
        assert_same(vj.run_sweep(file, progress=False, executor=executor), expected)


def test_dask_cluster(file, expected):
    distributed = pytest.importorskip("distributed")
    from vibrojax.cli import main

    out = file.with_name("out.nc")
    with distributed.LocalCluster(
        2, processes=True, threads_per_worker=1, dashboard_address=":0", silence_logs=50
    ) as cluster:
        with distributed.Client(cluster, set_as_default=False) as client:
            assert_same(vj.run_sweep(file, progress=False, executor=client.get_executor()), expected)
        address = cluster.scheduler_address.replace("tcp://", "dask://")
        assert main(["sweep", str(file), "-o", str(out), "--workers", address, "--quiet"]) == 0
    assert_same(vj.open_dataset(out), expected)


@pytest.mark.parametrize("library", ["submitit", "loky"])
@pytest.mark.long
def test_executors_of_other_libraries(file, expected, tmp_path, library):
    module = pytest.importorskip(library)
    if library == "loky":
        executor = module.ProcessPoolExecutor(2)
    else:
        file.write_text(TEXT.replace("chunk = 5", "chunk = 12"))  # one process per chunk
        executor = module.LocalExecutor(folder=tmp_path / "jobs")
    dataset = vj.run_sweep(file, progress=False, executor=executor)
    assert_same(dataset.assign_attrs(sweep=expected.attrs["sweep"]), expected)
    if library == "loky":
        executor.shutdown()


BY_MPI = """
import sys
from mpi4py.futures import MPIPoolExecutor
import vibrojax as vj
if __name__ == "__main__":
    with MPIPoolExecutor(2) as executor:
        vj.write_dataset(vj.run_sweep(sys.argv[1], progress=False, executor=executor), sys.argv[2])
"""


def test_mpi_executor(file, expected):
    """Needs mpi4py and an MPI library, such as from `pip install mpi4py mpich`."""
    pytest.importorskip("mpi4py")
    mpiexec = shutil.which("mpiexec", path=f"{Path(sys.executable).parent}:{os.environ['PATH']}")
    if mpiexec is None:
        pytest.skip("there is no mpiexec")
    (file.parent / "by_mpi.py").write_text(BY_MPI)
    command = [mpiexec, "-n", "3", sys.executable, "-m", "mpi4py.futures", "by_mpi.py", file.name, "out.nc"]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, cwd=file.parent, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert_same(vj.open_dataset(file.with_name("out.nc")), expected)


def test_zarr_output(file, expected):
    pytest.importorskip("zarr")
    out = file.with_name("out.zarr")
    for _ in range(2):  # the second run replaces the first
        dataset = run_to_file(read_sweep(file), out, progress=False)
        assert_same(dataset, expected)
    with pytest.raises(InputError, match=r"holds another result: parameters\.v was 1\.5, is 1\.2"):
        run_to_file(read_sweep(file, ["v=1.2"]), out, progress=False)
    assert {path.name for path in file.parent.iterdir()} == {"map.toml", "out.zarr"}


class LocalExecutor:
    """An executor that computes each chunk immediately, in this thread, by `compute`."""

    def __init__(self, compute):
        self.compute, self.asked = compute, []

    def submit(self, fn, task, index, threads):
        future: Future = Future()
        self.asked.append(index)
        try:
            future.set_result(self.compute(self, fn, task, index, threads))
        except Exception as error:
            future.set_exception(error)
        return future


@pytest.mark.parametrize(
    ("fails", "error", "warning"),
    [
        (
            lambda requested: requested[-1] == 3,
            MemoryError("too much"),
            "chunk 3 failed with a worker (MemoryError: too much)",
        ),
        (
            lambda requested: len(requested) > 2,
            BrokenExecutor("a worker died"),
            "(BrokenExecutor: a worker died); the rest is",
        ),
    ],
)
def test_failed_chunks_are_computed_locally(file, expected, capsys, fails, error, warning):
    """No chunk is requested twice."""

    def compute(self, fn, task, index, threads):
        if fails(self.asked):
            raise error
        return fn(task, index, threads)

    executor = LocalExecutor(compute)
    assert_same(vj.run_sweep(file, progress=False, executor=executor), expected)
    lines = capsys.readouterr().err
    assert lines.count(warning) == 1 and lines.count("computed here") == 1
    assert sorted(executor.asked) == [0, 1, 2, 3, 4]


def test_error_in_sweep_is_raised_once(file):
    def compute(*_):
        raise InputError("wrong")

    with pytest.raises(InputError, match="wrong"):
        vj.run_sweep(file, progress=False, executor=LocalExecutor(compute))


def test_foreign_futures_are_polled(file, expected):
    """Like those of submitit, they have done() and result(), but none of the other methods of Python's futures."""

    class Job:
        def __init__(self, work):
            self.work, self.looks = work, 0

        def done(self):
            self.looks += 1
            return self.looks > 1

        def result(self):
            return self.work()

        def cancel(self):
            pass

    class Jobs:
        def submit(self, fn, *arguments):
            return Job(lambda: fn(*arguments))

    assert_same(vj.run_sweep(file, progress=False, executor=Jobs()), expected)


@pytest.mark.parametrize(
    "executor, problem",
    [
        (lambda: 4, "executor: int has no submit; give a concurrent.futures.Executor"),
        (
            lambda: ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("fork")),
            "its processes are forked, and jax hangs in such; make it with mp_context",
        ),
    ],
)
def test_unsuitable_executors_are_refused(file, executor, problem):
    with pytest.raises(InputError, match=problem):
        vj.run_sweep(file, progress=False, executor=executor())


def test_unpicklable_physics_is_refused(tmp_path):
    law = vj.FrictionLaw(
        name="mine", reference="", parameters=vj.parameters.table(), mu=lambda speed, p: 0.3 - 0.1 * speed
    )
    sweep = {"scene": "vibro-impact", "parameters": {"friction": law}, "grid": {"beta": [0.4]}}
    with ThreadPoolExecutor(1) as executor, pytest.raises(InputError, match="cannot be sent to other processes"):
        vj.run_sweep(sweep, progress=False, executor=executor)


def test_workers_share_cores(file):
    """Each of two workers on this machine uses half of its cores, unless the environment overrides it."""
    from vibrojax.compile.xla import threads, usable_cores, with_threads

    for workers, expected_threads in ((None, 1), (2, max(1, usable_cores() // 2))):
        executor = LocalExecutor(
            lambda self, fn, task, index, threads: self.threads.add(threads) or fn(task, index, threads)
        )
        executor.threads, executor._max_workers = set(), workers
        vj.run_sweep(file, progress=False, executor=executor)
        assert executor.threads == {expected_threads}
    with with_threads(3):
        assert threads() == 3
    assert threads() == usable_cores()


def test_worker_compiles_once(file, monkeypatch):
    from vibrojax.lanes.engine import Engine
    from vibrojax.maps.executor import pickled

    compiled = []
    compile_ = Engine.compile
    monkeypatch.setattr(Engine, "compile", lambda self, *words: (compiled.append(1), compile_(self, *words)))
    task = pickled(read_sweep(file, ["title=once"]))
    parts = [compute_chunk(task, index, 1) for index in (0, 1, 2)]
    assert len(compiled) == 1 and all(np.isfinite(part["period"]).any() for part in parts)

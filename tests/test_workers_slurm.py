"""`--workers slurm` as where there is SLURM: sbatch, srun, sacct and scancel are `fake_slurm.py`'s."""

import os
import signal
import time
from functools import partial
from pathlib import Path

import pytest
import xarray as xr
from commands import TEXT, start

import vibrojax as vj

fake_slurm = pytest.importorskip("fake_slurm")
pytest.importorskip("submitit")


pytestmark = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks for processes where Linux has them")


@pytest.fixture
def slurm(tmp_path):
    """A folder with a sweep, and what starts the command where SLURM is."""
    fake_slurm.install(tmp_path / "bin")
    (tmp_path / "map.toml").write_text(TEXT)
    path = {"PATH": f"{tmp_path / 'bin'}:{os.environ['PATH']}"}
    return partial(start, environment=path, cwd=tmp_path)


def test_jobs_of_an_array_compute_it(slurm, tmp_path):
    began = slurm("sweep", "map.toml", "-o", "out.nc", "--workers", "slurm:2")
    out, said = began.communicate()
    assert began.returncode == 0, said + "".join(log.read_text() for log in (tmp_path / "bin").glob("*.log"))
    assert out.startswith("out.nc: 24 lanes") and said.splitlines()[-1].startswith("24/24 lanes")
    assert sorted(job.name for job in (tmp_path / "bin/jobs").iterdir()) == ["100_0", "100_1"]
    found, expected = vj.open_dataset(tmp_path / "out.nc"), vj.run_sweep(tmp_path / "map.toml", progress=False)
    xr.testing.assert_identical(found.drop_attrs(), expected.drop_attrs())
    assert {path.name for path in tmp_path.iterdir()} == {"bin", "map.toml", "out.nc", "out.png"}


def test_an_interrupt_cancels_the_jobs(slurm, tmp_path):
    (tmp_path / "map.toml").write_text(TEXT.replace("settle = 3.0", "settle = 20000.0\nend_early = false"))
    began = slurm("sweep", "map.toml", "-o", "out.nc", "--workers", "slurm:2", "--quiet")
    end = time.monotonic() + 300.0
    while not list(tmp_path.glob("out.nc.chunks/chunk-*.claim")):
        assert began.poll() is None and time.monotonic() < end
        time.sleep(0.05)
    began.send_signal(signal.SIGINT)
    said = began.communicate()[1]
    assert began.returncode == 130 and "to go on: vibrojax sweep map.toml -o out.nc --workers slurm:2" in said, said
    assert {path.name for path in (tmp_path / "bin").glob("cancelled-*")} == {"cancelled-100_0", "cancelled-100_1"}
    jobs = [int(path.read_text()) for path in (tmp_path / "bin/jobs").iterdir()]
    while any(fake_slurm.runs(job) for job in jobs):
        assert time.monotonic() < end
        time.sleep(0.05)


def test_a_folder_of_jobs_that_others_write_to_is_refused(slurm, tmp_path):
    """Jobs unpickle what lies there: somebody else's file would run."""
    (tmp_path / "out.nc.jobs").mkdir()
    (tmp_path / "out.nc.jobs").chmod(0o777)
    began = slurm("sweep", "map.toml", "-o", "out.nc", "--workers", "slurm:2", "--quiet")
    said = began.communicate()[1]
    assert began.returncode == 2 and "others can write to it, and could run code in the jobs; remove it" in said, said
    assert said.count("\n") == 1 and not list(tmp_path.glob("bin/jobs/*"))

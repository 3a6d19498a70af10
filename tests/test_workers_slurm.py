"""Test `--workers slurm` with the sbatch, srun, sacct and scancel of `fake_slurm.py`."""

import os
import signal
import time
from functools import partial
from pathlib import Path

import fake_slurm
import pytest
import xarray as xr
from commands import TEXT, start

import vibrojax as vj
from vibrojax.cli import main

pytest.importorskip("submitit")
pytestmark = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks for processes where Linux has them")


@pytest.fixture
def slurm(tmp_path):
    """Prepare a folder with a sweep, and return a function that starts the command where SLURM is available."""
    fake_slurm.install(tmp_path / "bin")
    (tmp_path / "map.toml").write_text(TEXT)
    path = {"PATH": f"{tmp_path / 'bin'}:{os.environ['PATH']}"}
    return partial(start, environment=path, cwd=tmp_path)


@pytest.mark.long
def test_jobs_compute_sweep(slurm, tmp_path):
    driver = slurm("sweep", "map.toml", "-o", "out.nc", "--workers", "slurm:2")
    out, messages = driver.communicate()
    assert driver.returncode == 0, messages + "".join(log.read_text() for log in (tmp_path / "bin").glob("*.log"))
    assert out.startswith("out.nc: 24 lanes") and messages.splitlines()[-1].startswith("24/24 lanes")
    assert len(list((tmp_path / "bin/jobs").iterdir())) == 5  # one for each chunk
    dataset, expected = vj.open_dataset(tmp_path / "out.nc"), vj.run_sweep(tmp_path / "map.toml", progress=False)
    xr.testing.assert_identical(dataset.drop_attrs(), expected.drop_attrs())
    assert {path.name for path in tmp_path.iterdir()} == {"bin", "map.toml", "out.nc", "out.png"}


def test_interrupt_cancels_jobs(slurm, tmp_path):
    (tmp_path / "map.toml").write_text(TEXT.replace("settle = 3.0", "settle = 20000.0\nend_early = false"))
    driver = slurm("sweep", "map.toml", "-o", "out.nc", "--workers", "slurm:2", "--quiet")
    end = time.monotonic() + 300.0
    while len(list(tmp_path.glob("out.nc.jobs/*_submitted.pkl"))) < 4:  # two that run, and two that wait
        assert driver.poll() is None and time.monotonic() < end
        time.sleep(0.05)
    driver.send_signal(signal.SIGINT)
    messages = driver.communicate()[1]
    assert driver.returncode == 130 and "to go on: vibrojax sweep map.toml -o out.nc --workers slurm:2" in messages, (
        messages
    )
    assert len(list((tmp_path / "bin").glob("cancelled-*"))) == 4
    jobs = [int(path.read_text()) for path in (tmp_path / "bin/jobs").iterdir()]
    while any(fake_slurm.runs(job) for job in jobs):
        assert time.monotonic() < end
        time.sleep(0.05)


def test_job_folder_writable_by_others_is_refused(slurm, here, monkeypatch, capsys):
    """Jobs unpickle the files in the folder, so a file from someone else would run code."""
    monkeypatch.setenv("PATH", f"{here / 'bin'}:{os.environ['PATH']}")
    Path("out.nc.jobs").mkdir()
    Path("out.nc.jobs").chmod(0o777)
    assert main(["sweep", "map.toml", "-o", "out.nc", "--workers", "slurm:2", "--quiet"]) == 2
    messages = capsys.readouterr().err
    assert "others can write to it, and could run code in the jobs; remove it" in messages and messages.count("\n") == 1
    assert not list(here.glob("bin/jobs/*"))

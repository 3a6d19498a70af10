"""Tests of seals and of files of unknown origin: damage is refused, edits open, nothing hangs or reads elsewhere."""

import json
import os
import random
import shutil
import subprocess
import sys
import time
from pathlib import Path

import netCDF4
import numpy as np
import pytest
import xarray as xr
from refusals import refusal

import vibrojax as vj
from vibrojax.io import trust

DATA = Path(__file__).parent / "data"
RATES = DATA / "versions" / "0.1.0" / "rates.nc"
LOOPING = 3430
"""Position in `rates.nc` where 64 zeros make HDF5 loop."""


@pytest.fixture(scope="module")
def rates() -> xr.Dataset:
    return vj.open_dataset(RATES)


@pytest.fixture(params=[".nc", ".zarr"])
def written(request, rates, tmp_path) -> Path:
    if request.param == ".zarr":
        pytest.importorskip("zarr")
    path = tmp_path / f"rates{request.param}"
    vj.write_dataset(rates, path)
    return path


def test_no_flip_opens_with_other_values(written, rates):
    """Flip single bits: the dataset is the original, or refused. A cut or longer file is refused."""
    files = [file for file in written.rglob("*") if file.is_file()] if written.is_dir() else [written]
    sizes, rng = [file.stat().st_size for file in files], random.Random(1)
    for _ in range(40):
        file = rng.choices(files, sizes)[0]
        content = file.read_bytes()
        flipped = bytearray(content)
        flipped[rng.randrange(len(content))] ^= 1 << rng.randrange(8)
        file.write_bytes(flipped)
        try:
            xr.testing.assert_identical(vj.open_dataset(written), rates)
        except vj.InputError as error:
            assert "\n" not in str(error)
        file.write_bytes(content)
    xr.testing.assert_identical(vj.open_dataset(written), rates)
    if written.suffix == ".nc":
        for damaged in (content[:-1], content[:-100] + bytes(100), content + b"\0"):
            written.write_bytes(damaged)
            assert "damaged" in refusal(vj.open_dataset, written) or "netCDF" in refusal(vj.open_dataset, written)


def test_edited_datasets_open(written, rates):
    """A dataset that other software writes has no seal, whether it was opened here or there."""
    other = written.with_name(f"selected{written.suffix}")
    edit = lambda ds: ds.isel(frequency=slice(2)).assign_attrs(title="mine")
    if written.suffix == ".nc":
        with xr.open_dataset(written) as stored:
            edit(stored).to_netcdf(other)
        with netCDF4.Dataset(written, "a") as file:
            file.title = "mine"
            file["rate_of_penetration"][:] = 1.0
    else:
        edit(xr.open_zarr(written)).to_zarr(other, zarr_format=2)
        ones = xr.ones_like(rates[["rate_of_penetration"]])
        ones.to_zarr(written, mode="a", zarr_format=2, consolidated=True)
    assert (vj.open_dataset(written)["rate_of_penetration"] == 1.0).all()
    selected = vj.open_dataset(other)
    for name in rates.data_vars:
        np.testing.assert_array_equal(selected[name].values, edit(rates)[name].values)
    assert selected.attrs["title"] == "mine"
    vj.write_dataset(selected, other)
    assert trust.is_own(other)


def test_dataset_without_secret_is_read_as_unknown(rates, tmp_path, monkeypatch):
    """Another user's dataset opens with the same values, after a check in a process of its own."""
    vj.write_dataset(rates, tmp_path / "rates.nc")
    monkeypatch.setenv("VIBROJAX_CACHE", str(tmp_path / "another"))
    trust._secret.cache_clear()
    try:
        assert not trust.is_own(tmp_path / "rates.nc")
        xr.testing.assert_identical(vj.open_dataset(tmp_path / "rates.nc"), rates)
    finally:
        trust._secret.cache_clear()


@pytest.mark.parametrize("private", [True, False])
def test_secret_is_private(private, tmp_path, monkeypatch):
    monkeypatch.setenv("VIBROJAX_CACHE", str(tmp_path / "cache"))
    secret = trust._secret.__wrapped__()
    path = tmp_path / "cache" / "seal"
    assert len(secret) == 32 and path.stat().st_mode & 0o777 == 0o600 and len(list(path.parent.iterdir())) == 1
    path.chmod(0o600 if private else 0o640)
    assert trust._secret.__wrapped__() == (secret if private else None)
    monkeypatch.setenv("VIBROJAX_CACHE", "off")
    assert trust._secret.__wrapped__() is None


def test_looping_file_leaves_no_lock(rates, tmp_path, monkeypatch):
    """The patch only shortens the wait."""
    monkeypatch.setattr(trust, "PROCESSOR_SECONDS", 1.0)
    content = bytearray(RATES.read_bytes())
    content[LOOPING : LOOPING + 64] = bytes(64)
    (tmp_path / "damaged.nc").write_bytes(content)
    assert "its structure is damaged" in refusal(vj.open_dataset, tmp_path / "damaged.nc")
    began = time.monotonic()
    xr.testing.assert_identical(vj.open_dataset(RATES), rates)
    vj.write_dataset(rates, tmp_path / "whole.nc")
    xr.testing.assert_identical(vj.open_dataset(tmp_path / "whole.nc"), rates)
    assert time.monotonic() - began < 20


@pytest.mark.parametrize("kind", ["storage", "link", "virtual"])
def test_other_files_are_not_read(kind, here):
    """Values of `period` are those of `secret.bin` or `other.h5`; see `tests/data/README.md`."""
    (here / "secret.bin").write_bytes(np.arange(4.0).tobytes())
    for file in (DATA / "links").iterdir():
        shutil.copy(file, here)
    if kind == "storage":
        with xr.open_dataset("storage.nc") as ds:
            assert ds["period"].values.tolist() == [0.0, 1.0, 2.0, 3.0]
    assert "refers to other files" in (line := refusal(vj.open_dataset, f"{kind}.nc")) or "values of other" in line


def test_store_cannot_name_files_elsewhere(rates, tmp_path):
    pytest.importorskip("zarr")
    store, metadata = tmp_path / "rates.zarr", tmp_path / "rates.zarr" / ".zmetadata"
    vj.write_dataset(rates, store)
    (tmp_path / "elsewhere").mkdir()
    whole = json.loads(metadata.read_text())
    whole["metadata"]["../elsewhere/.zarray"] = whole["metadata"]["relief/.zarray"]
    metadata.write_text(json.dumps(whole))
    assert "a name that is no variable's" in refusal(vj.open_dataset, store)


MEASURED = """
import re, resource, sys, vibrojax as vj
from pathlib import Path
try:
    print(vj.open_dataset(sys.argv[1]).sizes)
except vj.InputError as error:
    print(error)
own = int(re.search(r"VmHWM:\\s*(\\d+) kB", Path("/proc/self/status").read_text())[1])
print(max(own, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss) / 2**20)
"""


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="ru_maxrss includes the memory of the parent")
def test_memory_is_bounded(tmp_path):
    """The file has 30 kB that are 30 MB as numbers, and 3 GB as dates."""
    path = tmp_path / "sent.nc"
    with netCDF4.Dataset(path, "w") as file:
        file.source = "vibrojax 0"
        file.createDimension("row", 30_000_000)
        x = file.createVariable("x", "i1", ("row",), zlib=True, complevel=9, chunksizes=(10_000_000,), fill_value=False)
        x.setncatts({"units": "days since 0001-01-01", "calendar": "noleap"})
        x[:] = np.zeros(30_000_000, np.int8)
    words = [sys.executable, "-c", MEASURED, str(path)]
    ended = subprocess.run(words, capture_output=True, text=True, check=True, timeout=120)
    line, gigabytes = ended.stdout.splitlines()
    assert float(gigabytes) < 1.0 and "30000000" in line, ended.stdout


CUT_OFF = """
import os, sys
from pathlib import Path
from vibrojax.io.atomic import atomic_folder
rename = Path.rename
def rename_and_end(self, target):
    rename(self, target)
    os._exit(9)
Path.rename = rename_and_end
with atomic_folder(Path(sys.argv[1])) as part:
    (part / ".zattrs").write_text("{}")
"""


def test_store_survives_a_kill_while_it_is_replaced(rates, tmp_path):
    pytest.importorskip("zarr")
    store = tmp_path / "rates.zarr"
    vj.write_dataset(rates, store)
    assert subprocess.run([sys.executable, "-c", CUT_OFF, str(store)], check=False).returncode == 9
    assert not store.exists()
    xr.testing.assert_identical(vj.open_dataset(store), rates)
    vj.write_dataset(rates, store)
    assert os.listdir(tmp_path) == ["rates.zarr"]

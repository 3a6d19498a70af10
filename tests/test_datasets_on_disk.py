"""Test stored datasets: released versions stay readable, foreign files are refused, and all follow CF."""

import json
import os
import pickle
import socket
import subprocess
from pathlib import Path

import jax
import numpy as np
import pytest
import xarray as xr

import vibrojax as vj
from vibrojax.cli import main
from vibrojax.io.untrusted import check_store

SAMPLES = sorted((Path(__file__).parent / "data" / "versions").glob("*/*.nc"))
RATES = next(path for path in SAMPLES if path.name == "rates.nc")
EXPECTED_LINES = {
    "regimes.nc": ["scene     vibro-impact", "beta: 0.3 to 0.5 (2)", "start: drive, stuck (2)", "lanes     12"],
    "rates.nc": ["rock: sandstone, granite (2)", "frequency: 10 to 40 s-1 (4)", "failures  0"],
    "points.nc": ["failures  1", "gamma=1e+160", ": not-finite"],
    "law.nc": ["form: literal, percent, onset, line, power (5)"],
    "motion.nc": ["scene     drilling", "time: 0 to 0.3 s"],
}


def printed(capsys, *argv) -> str:
    """Return what a successful command prints."""
    assert main(list(map(str, argv))) == 0
    return capsys.readouterr().out


def refused(capsys, *argv) -> str:
    assert main(list(map(str, argv))) == 2
    line = capsys.readouterr().err
    assert line.startswith("vibrojax: ") and line.count("\n") == 1
    return line


@pytest.mark.parametrize("path", SAMPLES, ids=lambda path: f"{path.parent.name}-{path.stem}")
def test_datasets_of_earlier_versions_stay_readable(path, capsys, tmp_path):
    text = printed(capsys, "info", path)
    assert all(line in text for line in EXPECTED_LINES[path.name]), text
    picture = tmp_path / "picture.png"
    printed(capsys, "plot", path, "-o", picture)
    assert picture.stat().st_size > 10_000
    if path.name == "rates.nc":
        with jax.numpy_dtype_promotion("standard"):
            assert "rock=granite" in printed(capsys, "fit", path, "-o", tmp_path / "law.nc")
        with xr.open_dataset(tmp_path / "law.nc") as fit, xr.open_dataset(path.with_name("law.nc")) as kept:
            np.testing.assert_allclose(fit.C.sel(form=kept.form).values, kept.C.values, rtol=1e-6)


def test_foreign_files_are_refused(tmp_path, capsys):
    foreign, text, garbage, folder = (tmp_path / f"{name}.nc" for name in ("foreign", "text", "garbage", "folder"))
    xr.Dataset({"x": ("t", [1.0])}, attrs={"source": "somebody's"}).to_netcdf(foreign)
    text.write_text("scene = 'rotary'\n")
    garbage.write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(range(256)) * 20)
    folder.mkdir()
    sweep = tmp_path / "map.toml"
    sweep.write_text("scene = 'rotary'\n")
    cut = tmp_path / "cut.nc"
    cut.write_bytes(RATES.read_bytes()[: RATES.stat().st_size // 2])
    for command, path, problem in (
        ("info", foreign, "was not written by vibrojax"),
        ("plot", text, "cannot be read as netCDF"),
        ("info", garbage, "cannot be read as netCDF"),
        ("fit", cut, "cannot be read as netCDF"),
        ("plot", folder, "is a folder"),
        ("info", ".", "is a folder"),
        ("fit", tmp_path / "gone.nc", "there is no such file"),
        ("info", sweep, f"is not a dataset; give the .nc file that vibrojax sweep {sweep} writes"),
    ):
        assert f"{path}: {problem}" in refused(capsys, command, path)


def test_temporary_files_of_dead_writers_are_removed(tmp_path):
    """Temporary files of running processes stay, and those of other machines that share the folder."""
    from vibrojax.io.writers import write_dataset

    dead = subprocess.Popen(["true"])
    dead.wait()
    some, here = "0123456789abcdef", socket.gethostname()
    others = [f".out.nc.{host}-{pid}-{some}.tmp" for host, pid in ((here, os.getppid()), ("another.one", dead.pid))]
    others += [".out.nc.tmp", f".out.nc.{dead.pid}.tmp"]
    for name in (f".out.nc.{here}-{dead.pid}-{some}.tmp", *others):
        (tmp_path / name).write_text("somebody's")
    write_dataset(xr.Dataset({"x": 1.0}), tmp_path / "out.nc")
    assert {path.name for path in tmp_path.iterdir()} == {"out.nc", *others}


def test_name_with_zarr_suffix_is_a_zarr_store(tmp_path):
    pytest.importorskip("zarr")
    store = tmp_path / "rates.zarr"
    store.write_bytes(RATES.read_bytes())  # as earlier versions did
    for ds in (vj.open_dataset(RATES).isel(frequency=slice(2)), vj.open_dataset(RATES)):
        vj.write_dataset(ds, store)
        assert store.is_dir() and [path.name for path in tmp_path.iterdir()] == ["rates.zarr"]
        xr.testing.assert_identical(vj.open_dataset(store), ds)


class Trap:
    """An object whose pickle creates a file when it is loaded."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return (open, (str(self.path), "w"))


def change_array(store, **changes):
    """Change the metadata of an array `x`, in the file with all metadata and in its own."""
    whole = json.loads((store / ".zmetadata").read_text())
    whole["metadata"]["x/.zarray"] |= changes
    (store / ".zmetadata").write_text(json.dumps(whole))
    (store / "x/.zarray").write_text(json.dumps(whole["metadata"]["x/.zarray"]))


@pytest.mark.parametrize("kind", ["pickle", "object", "compressor", "link", "damaged"])
def test_stores_that_may_run_code_are_refused(kind, tmp_path):
    pytest.importorskip("zarr")
    from vibrojax.io.writers import write_dataset

    store, trap = tmp_path / "sent.zarr", tmp_path / "trap"
    attributes = {"source": f"vibrojax {vj.__version__}"}
    write_dataset(xr.Dataset({"x": ("k", [1.0, 2.0]), "word": ("k", ["a", "bc"])}, attrs=attributes), store)
    assert check_store(store) is None
    if kind == "pickle":
        change_array(store, dtype="|O", filters=[{"id": "pickle", "protocol": 4}], compressor=None)
        (store / "x/0").write_bytes(pickle.dumps(np.array([Trap(trap)] * 2, dtype=object)))
    elif kind == "object":
        change_array(store, dtype="|O")
    elif kind == "compressor":
        change_array(store, compressor={"id": "pickle"})
    elif kind == "link":
        (store / "x/0").unlink()
        (store / "x/0").symlink_to("/dev/zero")
    else:
        (store / ".zmetadata").write_text('{"metadata": 3}')
    messages = {"pickle": "the filter .pickle.|the type", "object": "the type", "compressor": "compressor .pickle."}
    messages |= {"link": "is a link or a device", "damaged": "damaged"}
    with pytest.raises(vj.InputError, match=messages[kind]):
        vj.open_dataset(store)
    assert not trap.exists()

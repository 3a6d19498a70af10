"""Test stored datasets: earlier versions stay readable, foreign files are refused and never replaced."""

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
from refusals import command_refusal, refusal

import vibrojax as vj
from vibrojax.cli import main
from vibrojax.io.trust import check_store

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


@pytest.mark.parametrize("path", SAMPLES, ids=lambda path: f"{path.parent.name}-{path.stem}")
def test_datasets_of_earlier_versions_stay_readable(path, capsys, tmp_path):
    own = tmp_path / path.name
    vj.write_dataset(vj.open_dataset(path), own)  # sealed, so that no process of its own reads it each time
    text = printed(capsys, "info", own)
    assert all(line in text for line in EXPECTED_LINES[path.name]), text
    picture = tmp_path / "picture.png"
    printed(capsys, "plot", own, "-o", picture)
    assert picture.stat().st_size > 10_000
    if path.name == "rates.nc":
        with jax.numpy_dtype_promotion("standard"):
            assert "rock=granite" in printed(capsys, "fit", own, "-o", tmp_path / "law.nc")
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
    picture = tmp_path / "map.png"
    picture.write_bytes(b"\x89PNG")
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
        ("explore", picture, "is not a dataset; give the .nc file from which it was made"),
    ):
        assert f"{path}: {problem}" in command_refusal(capsys, command, path)


def test_temporary_files_of_dead_writers_are_removed(tmp_path):
    """Temporary files of running processes stay, and those of other machines that share the folder."""
    dead = subprocess.Popen(["true"])
    dead.wait()
    some, here = "0123456789abcdef", socket.gethostname()
    others = [f".out.nc.{host}-{pid}-{some}.tmp" for host, pid in ((here, os.getppid()), ("another.one", dead.pid))]
    others += [".out.nc.tmp", f".out.nc.{dead.pid}.tmp"]
    for name in (f".out.nc.{here}-{dead.pid}-{some}.tmp", *others):
        (tmp_path / name).write_text("somebody's")
    vj.write_dataset(xr.Dataset({"x": 1.0}, attrs={"source": "vibrojax 0"}), tmp_path / "out.nc")
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


MESSAGES = {
    "pickle": "the filter .pickle.|the type",
    "object": "the type",
    "compressor": "compressor .pickle.",
    "link": "is a link or a device",
    "damaged": "damaged",
}


@pytest.mark.parametrize("kind", MESSAGES)
def test_stores_that_may_run_code_are_refused(kind, tmp_path):
    pytest.importorskip("zarr")
    store, trap = tmp_path / "sent.zarr", tmp_path / "trap"
    attributes = {"source": f"vibrojax {vj.__version__}"}
    vj.write_dataset(xr.Dataset({"x": ("k", [1.0, 2.0]), "word": ("k", ["a", "bc"])}, attrs=attributes), store)
    assert check_store(store) is None
    if kind == "pickle":
        change_array(store, dtype="|O", filters=[{"id": "pickle", "protocol": 4}], compressor=None)
        (store / "x/0").write_bytes(pickle.dumps(np.array([Trap(trap)] * 2, dtype=object)))
    elif kind == "link":
        (store / "x/0").unlink()
        (store / "x/0").symlink_to("/dev/zero")
    elif kind == "damaged":
        (store / ".zmetadata").write_text('{"metadata": 3}')
    else:
        change_array(store, **({"dtype": "|O"} if kind == "object" else {"compressor": {"id": "pickle"}}))
    with pytest.raises(vj.InputError, match=MESSAGES[kind]):
        vj.open_dataset(store)
    assert not trap.exists()


# Only files that this package wrote are replaced
SWEEP = 'scene = "rotary"\n[grid]\ngamma = [0.6, 0.7]\n[run]\nsettle = 0.5\nobserve = 0.5\n'
ADVICE = "give another name, or remove it"


@pytest.fixture(scope="module")
def motion() -> xr.Dataset:
    return vj.simulate("rotary", duration=0.5, progress=False)


@pytest.fixture
def folder(here, motion) -> Path:
    (here / "map.toml").write_text(SWEEP)
    vj.write_dataset(motion, here / "ref.nc")
    return here


COMMANDS = {
    "sweep map.toml -o pic.nc --fresh": "pic.png",
    "sweep map.toml --fresh": "map.nc",
    "orbits map.toml": "map-orbits.png",
    "plot ref.nc": "ref.png",
    "explore ref.nc": "ref.html",
    "accuracy -o . --quick": "accuracy.md",
    "sweep map.toml -o mine.zarr --fresh": "mine.zarr/notes.txt",
}


@pytest.mark.parametrize("command", COMMANDS)
def test_command_replaces_no_foreign_file(folder, capsys, command):
    foreign = folder / COMMANDS[command]
    foreign.parent.mkdir(exist_ok=True)
    foreign.write_bytes(b"somebody's")
    before = sorted(path.name for path in folder.iterdir())
    line = command_refusal(capsys, *command.split())
    assert foreign.name in line and ADVICE in line
    assert foreign.read_bytes() == b"somebody's" and sorted(path.name for path in folder.iterdir()) == before


@pytest.mark.parametrize("name", ["a.png", "a.pdf", "a.html", "a.nc", "a.zarr"])
def test_own_files_are_replaced_and_others_are_not(folder, motion, name):
    if name == "a.zarr":
        pytest.importorskip("zarr")
    write = {"html": vj.write_page, "nc": vj.write_dataset, "zarr": vj.write_dataset}.get(name[2:], vj.save_picture)
    for _ in range(2):
        write(motion, name)
    if name == "a.zarr":
        (folder / name / "notes.txt").write_text("somebody's")
    else:
        Path(name).write_bytes(Path(name).read_bytes().replace(b"vibrojax", b"another_"))
    assert ADVICE in refusal(write, motion, name)


def test_dataset_of_other_origin_is_replaced_if_it_says_so(folder, motion, capsys):
    motion.to_netcdf("own.nc")  # as users save one that they have edited
    motion.assign_attrs(source="somebody's").to_netcdf("other.nc")
    vj.write_dataset(motion, "own.nc")
    line = refusal(vj.write_dataset, motion, "other.nc")
    assert line.startswith("other.nc: exists already") and ADVICE in line
    Path("empty.nc").touch()
    vj.write_dataset(motion, "empty.nc")
    (folder / "map.nc.chunks").mkdir()
    (folder / "map.nc.chunks" / "manifest.json").write_text('{"name": "somebody\'s"}')
    assert "manifest.json: exists already" in command_refusal(capsys, "sweep", "map.toml")
    assert "somebody's" in (folder / "map.nc.chunks" / "manifest.json").read_text()

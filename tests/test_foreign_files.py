"""Tests that commands and functions replace only files that this package wrote."""

from pathlib import Path

import pytest
import xarray as xr

import vibrojax as vj
from vibrojax.cli import main

SWEEP = 'scene = "rotary"\n[grid]\ngamma = [0.6, 0.7]\n[run]\nsettle = 0.5\nobserve = 0.5\n'
ADVICE = "give another name, or remove it"


@pytest.fixture(scope="module")
def motion() -> xr.Dataset:
    return vj.simulate("rotary", duration=0.5, progress=False)


@pytest.fixture
def folder(tmp_path, monkeypatch, motion) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "map.toml").write_text(SWEEP)
    vj.write_dataset(motion, tmp_path / "ref.nc")
    return tmp_path


COMMANDS = {
    "sweep map.toml -o pic.nc --fresh": "pic.png",
    "sweep map.toml --fresh": "map.nc",
    "simulate rotary duration=0.1 -o pic.nc --fresh": "pic.nc",
    "orbits map.toml": "map-orbits.png",
    "plot ref.nc": "ref.png",
    "plot ref.nc -o pic.pdf": "pic.pdf",
    "plot ref.nc -o pic.svg --variable x1": "pic.svg",
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
    assert main(command.split()) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1 and foreign.name in err and ADVICE in err
    assert foreign.read_bytes() == b"somebody's" and sorted(path.name for path in folder.iterdir()) == before


@pytest.mark.parametrize(
    "name", ["a.png", "a.svg", "a.html", "a.nc", "a.zarr", pytest.param("a.pdf", marks=pytest.mark.long)]
)
def test_own_files_are_replaced_and_others_are_not(folder, motion, name):
    if name == "a.zarr":
        pytest.importorskip("zarr")

    def write() -> None:
        if name == "a.html":
            vj.write_page(motion, name, progress=False)
        elif name in ("a.nc", "a.zarr"):
            vj.write_dataset(motion, name)
        else:
            vj.save_picture(motion, name)

    write()
    write()
    if name == "a.zarr":
        (folder / name / "notes.txt").write_text("somebody's")
    else:
        Path(name).write_bytes(Path(name).read_bytes().replace(b"vibrojax", b"another_"))
    with pytest.raises(vj.InputError, match=ADVICE):
        write()


def test_dataset_of_other_origin_is_replaced_if_it_says_so(folder, motion):
    motion.to_netcdf("own.nc")  # as users save one that they have edited
    motion.assign_attrs(source="somebody's").to_netcdf("other.nc")
    vj.write_dataset(motion, "own.nc")
    with pytest.raises(vj.InputError, match=f"other.nc: exists already.*{ADVICE}"):
        vj.write_dataset(motion, "other.nc")
    Path("empty.nc").touch()
    vj.write_dataset(motion, "empty.nc")


def test_foreign_manifest_stays(folder, capsys):
    (folder / "map.nc.chunks").mkdir()
    (folder / "map.nc.chunks" / "manifest.json").write_text('{"name": "somebody\'s"}')
    assert main(["sweep", "map.toml"]) == 2
    assert "manifest.json: exists already" in capsys.readouterr().err
    assert "somebody's" in (folder / "map.nc.chunks" / "manifest.json").read_text()

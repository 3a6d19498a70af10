"""A finished result of another sweep or point is not replaced without `--fresh`."""

import numpy as np
import pytest

import vibrojax as vj
from vibrojax.cli import main
from vibrojax.io.manifest import check_replaceable
from vibrojax.sweep.input.read import read_sweep

SWEEP = 'scene = "rotary"\ntitle = "{title}"\n[grid]\ngamma = [{gamma}]\n[run]\nsettle = 0.5\nobserve = 0.5\n'


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def swept(folder, gamma, *argv, title="a"):
    (folder / "map.toml").write_text(SWEEP.format(gamma=gamma, title=title))
    return main(["sweep", "map.toml", "--quiet", *argv])


def test_another_sweep(folder, capsys):
    assert swept(folder, 0.6) == 0
    kept = (folder / "map.nc").read_bytes()
    assert swept(folder, 0.7) == 2
    assert capsys.readouterr().err == (
        "vibrojax: map.nc: holds another result: grid.gamma was [0.6], is [0.7]; "
        "--fresh replaces it, or give another output with -o\n"
    )
    assert (folder / "map.nc").read_bytes() == kept and not (folder / "map.nc.chunks").exists()
    assert swept(folder, 0.7, "--fresh") == 0
    np.testing.assert_array_equal(vj.open_dataset(folder / "map.nc").gamma, [0.7])
    assert swept(folder, 0.7, title="said otherwise") == 0


def test_another_point(folder, capsys):
    point = ["simulate", "rotary", "duration=0.2"]
    assert main([*point, "gamma=0.6"]) == 0 and main([*point, "gamma=0.6"]) == 0
    capsys.readouterr()
    assert main([*point, "gamma=0.7"]) == 2
    assert "rotary.nc: holds another result: gamma was 0.6, is 0.7; --fresh replaces it" in capsys.readouterr().err
    assert main([*point, "gamma=0.6", "start=[0,0,0,1]"]) == 2
    assert main([*point, "gamma=0.7", "--fresh"]) == 0


@pytest.mark.parametrize("content", [b"", b"no netCDF at all", None])
def test_what_is_none_of_ours_stays(folder, content):
    """A damaged file, a file of something else, a dataset of an earlier version."""
    path = folder / "map.nc"
    if content is None:
        vj.write_dataset(vj.open_dataset(vj.__path__[0] + "/../tests/data/versions/0.1.0/rates.nc"), path)
    else:
        path.write_bytes(content)
    identity = read_sweep({"scene": "rotary", "grid": {"gamma": [0.7]}}).identity()
    with pytest.raises(vj.InputError, match=r"exists already, and does not say that it holds this result; --fresh"):
        check_replaceable(path, identity)
    check_replaceable(folder / "other.nc", identity)

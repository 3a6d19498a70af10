"""Tests of results that survive: interrupted sweeps continue, damaged or foreign chunks are never accepted, and other
results, of other code too, need `--fresh`."""

import json
import os
import subprocess
import sys
import zipfile
from io import BytesIO
from pathlib import Path
from textwrap import dedent

import numpy as np
import pytest
from refusals import refusal
from systems import mass
from systems import system as build

import vibrojax as vj
from vibrojax.cli import main
from vibrojax.io.files import source
from vibrojax.io.identity import canonical, check_replaceable, digest
from vibrojax.maps.store import FORMAT, open_store
from vibrojax.settings.code_identity import code_identity

SWEEP = 'scene = "rotary"\ntitle = "{title}"\n[grid]\ngamma = [{gamma}]\n[run]\nsettle = 0.5\nobserve = 0.5\n'


def sweep_status(folder, gamma, *argv, title="a"):
    (folder / "map.toml").write_text(SWEEP.format(gamma=gamma, title=title))
    return main(["sweep", "map.toml", "--quiet", *argv])


def test_other_result_is_replaced_only_with_fresh(here, capsys):
    assert sweep_status(here, 0.6) == 0
    content = (here / "map.nc").read_bytes()
    assert sweep_status(here, 0.7) == 2
    assert capsys.readouterr().err == (
        "vibrojax: map.nc: holds another result: grid.gamma was [0.6], is [0.7]; "
        "--fresh replaces it, or give another output with -o\n"
    )
    assert (here / "map.nc").read_bytes() == content and not (here / "map.nc.chunks").exists()
    assert sweep_status(here, 0.7, "--fresh") == 0
    np.testing.assert_array_equal(vj.open_dataset(here / "map.nc").gamma, [0.7])
    assert sweep_status(here, 0.7, title="said otherwise") == 0


def test_finished_sweep_is_not_recomputed(here, capsys):
    (here / "map.toml").write_text(SWEEP.format(gamma=0.6, title="a"))
    argv = ["sweep", "map.toml", "-o", "map.nc"]
    assert main(argv) == 0
    written_at, lines = (here / "map.nc").stat().st_mtime_ns, capsys.readouterr().out.splitlines()
    (here / "map.png").unlink()
    assert main(argv) == 0 and (here / "map.png").exists()
    line = f"map.nc: is there already ({source()}); it is not computed again without --fresh; picture map.png"
    assert capsys.readouterr() == ("\n".join([line, *lines[1:], ""]), "")
    assert (here / "map.nc").stat().st_mtime_ns == written_at
    assert main([*argv, "--fresh"]) == 0 and "is there already" not in capsys.readouterr().out
    assert (here / "map.nc").stat().st_mtime_ns > written_at


POINT = ["simulate", "rotary", "duration=0.2"]


def test_single_motions_are_numbered(here, capsys):
    """A motion takes the next free number, or the number of an equal result, and replaces no other file."""
    (here / "rotary-2.nc").write_bytes(b"no netCDF at all")
    (here / "rotary-x.nc").mkdir()
    for gamma, name in ((0.6, "rotary"), (0.7, "rotary-3")):
        assert main([*POINT, f"gamma={gamma}"]) == 0
        assert capsys.readouterr().out.splitlines()[-1] == f"{name}.nc; picture {name}.png"
        assert vj.open_dataset(here / f"{name}.nc").attrs["parameters"].count(f'"gamma": {gamma}') == 1
    (here / "rotary.nc").unlink()
    assert main([*POINT, "gamma=0.7"]) == 0
    assert "rotary-3.nc: is there already" in capsys.readouterr().out


def test_dataset_of_an_earlier_version_is_not_replaced(here):
    path = here / "map.nc"
    vj.write_dataset(vj.open_dataset(Path(__file__).parent / "data" / "versions" / "0.1.0" / "rates.nc"), path)
    identity = vj.read_sweep({"scene": "rotary", "grid": {"gamma": [0.7]}}).identity()
    assert "it holds this result; --fresh" in refusal(check_replaceable, path, identity)
    check_replaceable(here / "other.nc", identity)


# The identity of a result includes the code of a user's own scene or law.
OWN = {
    "aid.py": "def share(u):\n    return 0.9 + 0.1 / (1.0 + u)\n",
    "own.py": """
        from dataclasses import dataclass
        import jax.numpy as jnp
        import vibrojax as vj
        import aid

        LEAST = 0.2

        def unrelated():
            return 1

        law = vj.FrictionLaw("own", "mine", {}, mu=lambda u, p: (
            LEAST * aid.share(u)
            + 0.1
        ))

        @dataclass(frozen=True)
        class Drill(vj.SCENES["rotary"]):
            factor: float = 1.0
            name = "own-drill"

            def pull(self, c, state):
                return self.factor * super().pull(c, state)
        """,
}

DIGESTS = """
import json, own, vibrojax as vj
sweep = {"scene": own.Drill(), "parameters": {"friction": own.law}, "grid": {"v": [1.0]}}
digests = {name: x for name, x in vj.read_sweep(sweep).identity().items() if name.startswith("code.")}
print(json.dumps(digests))
"""


def own_code(folder, old="", new=""):
    """Write the user's modules, with `old` replaced by `new`."""
    folder.mkdir()
    for name, text in OWN.items():
        (folder / name).write_text(dedent(text).replace(old, new))
    return folder


def digests(folder, monkeypatch):
    """Return the digests of the user's code in the identity of a sweep."""
    with monkeypatch.context() as patch:
        patch.syspath_prepend(folder)
        for name in OWN:
            patch.delitem(sys.modules, name.removesuffix(".py"), raising=False)
        namespace = {}
        exec(DIGESTS, namespace)
        return namespace["digests"]


def test_identity_follows_code_of_own_scenes_and_laws(tmp_path, monkeypatch, capsys):
    before = digests(own_code(tmp_path / "before"), monkeypatch)
    assert set(before) == {"code.scene", "code.friction"}
    edits = (
        ("return 1", "return 2", set()),  # a function that neither of them uses
        ("+ 0.1\n", "+ 0.2\n", {"code.friction"}),  # the last line of the lambda
        ("LEAST = 0.2", "LEAST = 0.3", {"code.friction"}),
        ("0.9 + 0.1", "0.8 + 0.2", {"code.friction"}),  # in another module
        ("self.factor *", "-self.factor *", {"code.scene"}),
        ("float = 1.0", "float = 2.0", {"code.scene"}),
    )
    for index, (old, new, expected) in enumerate(edits):
        after = digests(own_code(tmp_path / f"after-{index}", old, new), monkeypatch)
        assert {name for name in before if after[name] != before[name]} == expected, old
    environment = {**os.environ, "PYTHONHASHSEED": "7"}  # another process agrees
    argv = [sys.executable, "-c", DIGESTS]
    process = subprocess.run(argv, capture_output=True, text=True, cwd=tmp_path / "before", env=environment, check=True)
    assert json.loads(process.stdout) == before


# The code of a system, to the last constant of every function
PARTS = ("field", "period", "rate", "gap", "reset", "restitution", "force", "law", "mass", "surface")


def system(changed=None, c=1.1):
    """Return a system in which one function differs in a constant. Each function has a variable of its own."""
    numbers = (c if name == changed else 1.0 for name in PARTS)
    field, period, rate, gap, reset, restitution, force, law, mass, surface = numbers
    falling = vj.FrictionLaw("falling", "own", {}, lambda u, p: law * 0.3 + 0.1 * vj.elementary.exp(-u))
    slides, presses = lambda t, y, p: y["w"] - surface, lambda t, y, p: force
    belt = vj.Friction("belt", slides, presses, law=falling, acts_on="w", mass=lambda p: mass)
    stop = vj.Impact("stop", lambda t, y, p: gap - y["x"], velocity="v", restitution=lambda p: 0.8 * restitution)
    kick = vj.Impact("kick", lambda t, y, p: 9.0 - y["y"], reset=lambda t, y, p: {"w": -0.5 * reset * y["w"]})
    rates = lambda t, y, p: {"x": y["v"], "v": -field * y["x"], "y": y["w"], "w": -y["y"] - 0.1 * y["w"]}
    options = {"period": lambda p: period * 6.0, "rate": lambda p: 3.0 * rate}
    return build("xvyw", rates, stop, kick, belt, name="all-parts", **options)


@pytest.mark.parametrize("part", PARTS)
def test_identity_has_every_constant(part):
    assert code_identity(system(part)) != code_identity(system()) == code_identity(system())


def test_definition_that_has_changed_is_refused():
    """A later definition does not run an earlier dataset. Compiled code keeps the value that a variable had."""
    stiffness = 1.0
    rate = lambda t, y, p: vj.elementary.cos(0.9 * t) - 0.1 * y["v"] - stiffness * y["x"]
    first, second = (mass(rate if k == 1 else lambda t, y, p: -y["x"], period=2 * np.pi / 0.9) for k in (1, 2))
    family = vj.follow(first, along="q", at=0.9, span=(0.85, 0.95), start=[0.0, 0.0], progress=False)
    ds, _ = (vj.run_sweep({"scene": own, "grid": {"q": [0.9]}}, progress=False) for own in (first, second))
    assert "code.scene has changed since; follow the fam" in refusal(vj.curves, family, by="q", span=(0.85, 0.95))
    assert "code.scene has changed since; give the sweep itself" in refusal(vj.orbits, ds, progress=False)
    stiffness = 2.0
    changed = "a value that its functions use has changed since its first run"
    assert changed in refusal(vj.run_sweep, {"scene": first, "grid": {"q": [0.9]}}, progress=False)


MANIFEST = {"scene": "rotary", "chunk": 4, "grid.beta": [0.1, 0.2], "version": "1"}
OWNER = digest(json.loads(canonical(MANIFEST | {"store": FORMAT})))


def arrays(index: int) -> dict[str, np.ndarray]:
    regime = np.full(4, index, np.int8)
    return {"period": np.array([0.1, np.nan, index, 3.0]), "regime": regime, "kept": np.arange(8.0).reshape(4, 2)}


@pytest.fixture
def store(tmp_path):
    """Return a closed folder in which chunks 0 and 2 are finished."""
    with open_store(tmp_path / "out.nc.chunks", MANIFEST, resume=True) as opened:
        opened.write(2, arrays(2))
        opened.write(0, arrays(0))
    return opened


def reopen(store, resume=True, **changes):
    return open_store(store.folder, MANIFEST | changes, resume)


def chunk_path(store, index):
    return store.folder / f"chunk-{index:08d}.zip"


def test_no_flipped_bit_changes_a_value(store):
    """A few bits of an archive mean nothing, such as those of its date."""
    path, detected = chunk_path(store, 2), 0
    content = path.read_bytes()
    for place in range(len(content)):
        path.write_bytes(content[:place] + bytes([content[place] ^ 1]) + content[place + 1 :])
        chunk = store.read(2)
        detected += chunk is None
        for name, x in (chunk or {}).items():
            np.testing.assert_array_equal(x, arrays(2)[name], strict=True)
        path.write_bytes(content)
    assert detected > 0.6 * len(content)


def test_chunk_in_place_of_another_is_detected(store):
    os.replace(chunk_path(store, 2), chunk_path(store, 1))
    with reopen(store) as opened:
        assert opened.finished() == {0}


def archive(name: str, content: bytes, compression=zipfile.ZIP_STORED) -> bytes:
    """Return a file of the sweep's chunk 1 with one member."""
    file = BytesIO()
    with zipfile.ZipFile(file, "w", compression) as members:
        members.comment = f"{OWNER} 1".encode()
        members.writestr(name, content)
    return file.getvalue()


@pytest.mark.parametrize(
    "content",
    [
        b"no archive",
        archive('["x", "<f8"]', bytes(8)),
        archive('["x", "<f8", []]', bytes(16)),
        archive('["x", "<f8", [99999999, 99999999]]', bytes(8)),
        archive('["x", "|O8", []]', bytes(8)),
        archive('["x", "<f8", [4]]', bytes(32), zipfile.ZIP_DEFLATED),
    ],
    ids=["no-archive", "no-shape", "too-long", "too-short", "objects", "compressed"],  # archives contain the time
)
def test_files_from_anywhere_are_refused(store, content):
    """No pickle is loaded, nothing unpacks to more than its size, and no array exceeds its file."""
    with reopen(store) as opened:
        chunk_path(opened, 1).write_bytes(content)
        assert opened.finished() == {0, 2}


def test_changed_manifest_is_refused(store):
    line = refusal(lambda: reopen(store, chunk=8).__enter__())
    assert "chunk was 4, is 8" in line and "--fresh" in line and "scene" not in line
    with reopen(store) as opened:  # nothing was lost, and the lock is free
        assert opened.finished() == {0, 2}
    for resume in (False, True):
        with reopen(store, resume, chunk=8) as opened:
            assert opened.finished() == set()


def test_chunks_are_checked_individually_without_valid_manifest(store):
    for chunk, finished in ((4, {0, 2}), (8, set())):
        (store.folder / "manifest.json").write_bytes(b"{")
        with reopen(store, chunk=chunk) as opened:
            assert opened.finished() == finished


def test_partial_files_of_killed_processes_are_removed_and_foreign_ones_kept(store):
    half = store.folder / "chunk-00000001.zip.tmp"
    half.write_bytes(b"half")
    with reopen(store) as opened:
        assert not half.exists() and opened.finished() == {0, 2}
    note = store.folder / "note.txt"
    note.write_text("mine")
    with reopen(store, resume=False) as opened:
        opened.remove()
    assert [path.name for path in store.folder.iterdir()] == ["note.txt"]

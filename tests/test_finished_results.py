"""Tests of finished results: interrupted sweeps continue, and other results, of other code too, need `--fresh`."""

import json
import os
import subprocess
import sys
from pathlib import Path
from textwrap import dedent

import numpy as np
import pytest

import vibrojax as vj
from vibrojax.cli import main
from vibrojax.io.files import source
from vibrojax.io.identity import check_replaceable
from vibrojax.maps.read import read_sweep
from vibrojax.settings.code_identity import code_identity

SWEEP = 'scene = "rotary"\ntitle = "{title}"\n[grid]\ngamma = [{gamma}]\n[run]\nsettle = 0.5\nobserve = 0.5\n'


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def sweep_status(folder, gamma, *argv, title="a"):
    (folder / "map.toml").write_text(SWEEP.format(gamma=gamma, title=title))
    return main(["sweep", "map.toml", "--quiet", *argv])


def test_other_result_is_replaced_only_with_fresh(folder, capsys):
    assert sweep_status(folder, 0.6) == 0
    content = (folder / "map.nc").read_bytes()
    assert sweep_status(folder, 0.7) == 2
    assert capsys.readouterr().err == (
        "vibrojax: map.nc: holds another result: grid.gamma was [0.6], is [0.7]; "
        "--fresh replaces it, or give another output with -o\n"
    )
    assert (folder / "map.nc").read_bytes() == content and not (folder / "map.nc.chunks").exists()
    assert sweep_status(folder, 0.7, "--fresh") == 0
    np.testing.assert_array_equal(vj.open_dataset(folder / "map.nc").gamma, [0.7])
    assert sweep_status(folder, 0.7, title="said otherwise") == 0


def test_finished_sweep_is_not_recomputed(folder, capsys):
    (folder / "map.toml").write_text(SWEEP.format(gamma=0.6, title="a"))
    argv = ["sweep", "map.toml", "-o", "map.nc"]
    assert main(argv) == 0
    written_at, lines = (folder / "map.nc").stat().st_mtime_ns, capsys.readouterr().out.splitlines()
    (folder / "map.png").unlink()
    assert main(argv) == 0 and (folder / "map.png").exists()
    line = f"map.nc: is there already ({source()}); it is not computed again without --fresh; picture map.png"
    assert capsys.readouterr() == ("\n".join([line, *lines[1:], ""]), "")
    assert (folder / "map.nc").stat().st_mtime_ns == written_at
    assert main([*argv, "--fresh"]) == 0 and "is there already" not in capsys.readouterr().out
    assert (folder / "map.nc").stat().st_mtime_ns > written_at


POINT = ["simulate", "rotary", "duration=0.2"]


def test_single_motions_are_numbered(folder, capsys):
    """A motion takes the next free number, or the number of an equal result, and replaces no other file."""
    (folder / "rotary-2.nc").write_bytes(b"no netCDF at all")
    (folder / "rotary-x.nc").mkdir()
    for gamma, name in ((0.6, "rotary"), (0.7, "rotary-3")):
        assert main([*POINT, f"gamma={gamma}"]) == 0
        assert capsys.readouterr().out.splitlines()[-1] == f"{name}.nc; picture {name}.png"
        assert vj.open_dataset(folder / f"{name}.nc").attrs["parameters"].count(f'"gamma": {gamma}') == 1
    (folder / "rotary.nc").unlink()
    assert main([*POINT, "gamma=0.7"]) == 0
    assert "rotary-3.nc: is there already" in capsys.readouterr().out


def test_dataset_of_an_earlier_version_is_not_replaced(folder):
    path = folder / "map.nc"
    vj.write_dataset(vj.open_dataset(Path(__file__).parent / "data" / "versions" / "0.1.0" / "rates.nc"), path)
    identity = read_sweep({"scene": "rotary", "grid": {"gamma": [0.7]}}).identity()
    with pytest.raises(vj.InputError, match="it holds this result; --fresh"):
        check_replaceable(path, identity)
    check_replaceable(folder / "other.nc", identity)


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
import json
import vibrojax as vj
import own
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
    field, period, rate, gap, reset, restitution, force, law, mass, surface = (
        c if name == changed else 1.0 for name in PARTS
    )
    falling = vj.FrictionLaw("falling", "own", {}, lambda u, p: law * 0.3 + 0.1 * vj.elementary.exp(-u))
    belt = vj.Friction(
        "belt", lambda t, y, p: y["w"] - surface, lambda t, y, p: force, law=falling, acts_on="w", mass=lambda p: mass
    )
    bounce = lambda p: 0.8 * restitution  # noqa: E731
    stop = vj.Impact("stop", lambda t, y, p: gap - y["x"], velocity="v", restitution=bounce)
    kick = vj.Impact("kick", lambda t, y, p: 9.0 - y["y"], reset=lambda t, y, p: {"w": -0.5 * reset * y["w"]})
    return vj.System(
        "all-parts",
        states={"x": "m", "v": "m s-1", "y": "m", "w": "m s-1"},
        parameters={"a": 1.0},
        field=lambda t, y, p: {"x": y["v"], "v": -field * y["x"], "y": y["w"], "w": -y["y"] - 0.1 * y["w"]},
        period=lambda p: period * 6.0,
        rate=lambda p: 3.0 * rate,
        events=[stop, kick, belt],
    )


@pytest.mark.parametrize("part", PARTS)
def test_identity_has_every_constant(part):
    assert code_identity(system(part)) != code_identity(system()) == code_identity(system())


def oscillator(stiffness):
    return vj.System(
        "oscillator",
        states={"x": "m", "v": "m s-1"},
        parameters={"w": 0.9},
        field=lambda t, y, p: {"x": y["v"], "v": vj.elementary.cos(p["w"] * t) - 0.1 * y["v"] - stiffness * y["x"]},
        period=lambda p: 2 * np.pi / p["w"],
    )


def test_dataset_of_an_earlier_definition_is_not_run_with_a_later_one():
    first = vj.run_sweep({"scene": oscillator(1.0), "grid": {"w": [0.9]}}, progress=False)
    vj.run_sweep({"scene": oscillator(2.0), "grid": {"w": [0.9]}}, progress=False)
    with pytest.raises(vj.InputError, match=r"code\.scene has changed since; give the sweep itself"):
        vj.orbits(first, progress=False)


def test_changed_variable_is_refused():
    """Compiled code keeps the value that the variable had."""
    stiffness = 1.0
    decay = lambda t, y, p: {"x": -stiffness * y["x"]}  # noqa: E731
    own = vj.System("variable", states={"x": "m"}, parameters={"a": 1.0}, field=decay, period=lambda p: 1.0)
    vj.simulate(own, duration=1.0, progress=False)
    stiffness = 2.0
    with pytest.raises(vj.InputError, match="a value that its functions use has changed since its first run"):
        vj.simulate(own, duration=1.0, progress=False)

"""Tests of `vibrojax follow`: its files and output, refused input, and `info` and `plot` of its files."""

import json
from contextlib import redirect_stdout

import numpy as np
import pytest
from refusals import command_refusal

import vibrojax as vj
from vibrojax.cli import main
from vibrojax.studies.family_analysis import family_lines

ARGUMENTS = ("along=gamma", "at=0.45", "from=0.36", "to=0.5", "beta=0.4", "settle=30", "cycles=2")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a folder with a family, the output of its command, and two families over a second parameter."""
    folder = tmp_path_factory.mktemp("follow")
    with (folder / "said.txt").open("w") as output, redirect_stdout(output):
        assert main(["follow", "vibro-impact", *ARGUMENTS, "-o", str(folder / "one.nc")]) == 0
    rest = [word for word in ARGUMENTS if "beta" not in word]
    assert main(["follow", "vibro-impact", *rest, "beta=0.38,0.4", "-o", str(folder / "two.nc"), "--quiet"]) == 0
    return folder


@pytest.fixture
def here(folder, monkeypatch):
    monkeypatch.chdir(folder)
    return folder


def test_command_writes_result_of_python(here):
    settings = {"along": "gamma", "at": 0.45, "span": (0.36, 0.5), "beta": 0.4, "settle": 30.0, "cycles": 2}
    expected, written = vj.follow("vibro-impact", progress=False, **settings), vj.open_dataset("one.nc")
    assert (here / "one.png").exists()
    assert set(written.variables) == set(expected.variables)
    for name in expected.variables:
        np.testing.assert_array_equal(written[name], expected[name], name)
    assert written.attrs["start"] == "drive" and written.attrs["span"].tolist() == [0.36, 0.5]
    lines = (here / "said.txt").read_text().splitlines()
    assert "on 2 branches over gamma 0.36 to 0.5" in lines[0]
    (doubling,) = (line for line in lines if line.startswith("period-doubling"))
    assert "1 on branch 0 at gamma 0.392500037; 2 on other branches" in doubling
    assert "branch 0 is stable for gamma 0.392500037 (period-doubling) to 0.5 (end)" in lines
    assert lines[-1] == f"{here}/one.nc; picture {here}/one.png"


def test_json_output(here, capsys):
    assert main(["follow", "vibro-impact", *ARGUMENTS, "-o", "one.nc", "--json"]) == 0  # the same result again
    facts = json.loads(capsys.readouterr().out, parse_constant=pytest.fail)
    assert facts["scene"] == "vibro-impact" and facts["start"] == "drive" and facts["parameters"]["beta"] == 0.4
    assert (facts["dataset"], facts["picture"]) == ("one.nc", "one.png") and facts["branches"] == 2


def test_list_gives_as_many_families(here, capsys):
    two, single = vj.open_dataset("two.nc"), vj.open_dataset("one.nc")
    assert two["beta"].values.tolist() == [0.38, 0.4] and two["beta"].dims == ("family",)
    same = two.isel(point=np.flatnonzero(two["point_family"] == 1))
    np.testing.assert_allclose(same["gamma"], single["gamma"], rtol=1e-9)
    np.testing.assert_allclose(same["impact_velocity"], single["impact_velocity"], rtol=1e-7)
    text = "\n".join(family_lines(two))
    assert text.startswith("2 families, ") and "beta 0.4: 0.392500037 (period-doubling) to 0.5 (end)" in text
    assert main(["plot", "two.nc", "--where", "beta=0.4", "-o", "second.png"]) == 0


def test_family_is_drawn_over_returns_of_sweep(here, capsys):
    run = {"settle": 5.0, "observe": 3.0, "keep_returns": 6}
    sweep = {"scene": "vibro-impact", "grid": {"gamma": np.linspace(0.38, 0.48, 5).tolist()}, "run": run}
    vj.write_dataset(vj.run_sweep(sweep | {"parameters": {"beta": 0.4}}, progress=False), "returns.nc")
    (here / "returns.png").write_bytes(b"the picture of the sweep")
    assert main(["plot", "returns.nc", "--over", "one.nc"]) == 0
    assert (here / "returns-over-one.png").exists() and capsys.readouterr().out == "returns-over-one.png\n"
    assert (here / "returns.png").read_bytes() == b"the picture of the sweep"
    vj.write_dataset(vj.run_sweep(sweep | {"parameters": {"beta": 0.5}}, progress=False), "other.nc")
    assert "the families are of beta = 0.4, the returns of 0.5" in command_refusal(
        capsys, "plot", "other.nc", "--over", "one.nc"
    )
    assert "no such file" in command_refusal(capsys, "plot", "returns.nc", "--over", "no.nc")
    assert "laid over the returns of a sweep" in command_refusal(capsys, "plot", "one.nc", "--over", "one.nc")


BASE = {"along": "gamma", "at": "0.45", "from": "0.36", "to": "0.5"}
WRONG = {
    "vibro-impact along= at=": "along and at missing; write vibrojax follow SCENE along=NAME at=VALUE",
    "penetration": 'along: "gamma" is not a parameter of the scene; choose from',
    "vibro-impact along=rpm": '"rpm" is not a parameter of the scene; v follows from rpm and bit_radius',
    # gamma = 2 pi f sqrt(m1/k1), with m1 = 250 and k1 = 156250: 2 pi 3/25
    "rotary along=striker_frequency at=3.0": "give gamma, and follow along gamma; 3 Hz is gamma=0.753982",
    "vibro-impact along=k1 striker_frequency=3": "fixes gamma only at one k1, and k1 varies along the family",
    "vibro-impact gamma=0.4": "gamma: is the parameter of the continuation; say where it begins by at=0.4",
    "vibro-impact at=0.7": "at: 0.7 is not between from = 0.36 and to = 0.5",
    "vibro-impact beta=0.3,x": 'beta[1]: "x" is text',
    "vibro-impact beta=0.3,0.4 v=1,1.1,1.2": "lists of different lengths (beta 2, v 3)",
}


@pytest.mark.parametrize("words", WRONG)
def test_wrong_input_is_refused_in_one_line(here, capsys, words):
    """An argument without a value is left out."""
    scene, *changes = words.split()
    arguments = BASE | dict(change.split("=") for change in changes)
    given = [f"{name}={value}" for name, value in arguments.items() if value]
    line = command_refusal(capsys, "follow", scene, *given, "-o", "wrong.nc")
    assert line.startswith("follow: ") and WRONG[words] in line and not (here / "wrong.nc").exists()

"""Test the option `--set NAME=VALUE`, which changes values of a sweep."""

import pytest

import vibrojax as vj
from vibrojax.cli import main

BASE = {"scene": "vibro-impact", "parameters": {"k1": 2e5}, "grid": {"beta": [0.3, 0.4], "gamma": [0.6, 0.7]}}


def changed(*words):
    return vj.read_sweep(BASE, words)


def test_parameters_become_fixed_values_or_axes():
    sweep = changed("k1=312500", "v = 2", "beta=0.5", "friction=coulomb", "delta={start=-0.005, stop=0.005, num=3}")
    assert sweep.parameters["k1"] == 312500 and sweep.parameters["v"] == 2.0 and sweep.parameters["beta"] == 0.5
    assert sweep.friction == "coulomb" and list(sweep.axes) == ["gamma", "delta"] and len(sweep.axes["delta"]) == 3
    assert list(changed("k1=[2e5, 3e5]").axes) == ["beta", "gamma", "k1"]


def test_objects_are_kept():
    law = vj.FRICTION_LAWS["coulomb"]
    sweep = vj.read_sweep({**BASE, "parameters": {"friction": law}}, ["v=2"])
    assert sweep.system.friction is law and 'friction = "coulomb"' in sweep.text


@pytest.mark.parametrize(
    ("word", "line"),
    [
        ("k1", '--set: "k1" is not NAME=VALUE; write one, like k1=312500 or run.settle=200'),
        ("ran.settle=3", '--set: ran.settle: unknown table "ran"; did you mean "run"?'),
        ("kk1=3", 'scene "vibro-impact" has no such parameter; did you mean "k1"?'),
        ("settle=long", 'run.settle: "long" is text'),
    ],
)
def test_bad_words_are_refused(word, line):
    with pytest.raises(vj.InputError) as refused:
        changed(word)
    assert line in str(refused.value)


def test_command(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    words = ["run.settle=0.5", "observe=0.5", "beta=0.4", "gamma=[0.6,0.7]", "delta=0.005"]
    words = [part for word in words for part in ("--set", word)]
    assert main(["sweep", "regime-map", "--dry-run", *words]) == 0
    assert capsys.readouterr().out.startswith("lanes   4 (2 gamma x 2 start)")

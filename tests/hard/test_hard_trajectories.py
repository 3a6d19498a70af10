"""Tests of trajectories that need too much: one line refuses them before any work, with the amount and a remedy."""

import re

import pytest

import vibrojax as vj
from vibrojax.cli import main
from vibrojax.errors import InputError

TOO_LONG = r"simulate: duration: \S+ s need about \S+ steps.*; there is room for \S+ steps.*: give a shorter duration"


@pytest.mark.parametrize(
    ("scene", "settings", "message"),
    [
        ("vibro-impact", {"duration": 1e12}, TOO_LONG),
        ("rotary", {"duration": 1e12, "method": "diffrax"}, TOO_LONG),
        ("rotary", {"duration": 20.0, "step": 1e-12}, TOO_LONG + ", a longer step or a greater error"),
        (
            "rotary",
            {"duration": 20.0, "sampling": 1e-12},
            r"simulate: sampling: 1e-12 s gives 2e\+13 samples in 20 s; ",
        ),
        ("rotary", {"duration": 1.0, "sampling": 3.0}, ".* between 1 and 2000000 are needed, so 5e-07 to 1 s"),
        ("vibro-impact", {"k0": 1e300}, "simulate: the point cannot be run: too stiff, .*; give a smaller k0, c0, "),
    ],
)
def test_refused_before_any_work(scene, settings, message):
    with pytest.raises(InputError) as refusal:
        vj.simulate(scene, **settings, progress=False)
    assert re.match(message, str(refusal.value)), refusal.value


def test_command_refuses_in_one_line(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["simulate", "rotary", "duration=1e12"]) == 2
    errors = capsys.readouterr().err
    assert re.fullmatch(f"vibrojax: {TOO_LONG}\n", errors) and list(tmp_path.iterdir()) == []

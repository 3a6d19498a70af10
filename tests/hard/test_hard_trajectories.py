"""Tests of trajectories that need too much: one line refuses them before any work, with the amount and a remedy."""

import re

import pytest

import vibrojax as vj
from vibrojax.cli import main
from vibrojax.errors import InputError
from vibrojax.lanes import record as _record

TOO_LONG = r"simulate: duration: \S+ s need about \S+ steps.*; there is room for \S+ steps.*: give a shorter duration"


@pytest.mark.parametrize(
    ("scene", "settings", "message"),
    [
        ("vibro-impact", {"duration": 1e12}, TOO_LONG),
        ("vibro-impact", {"duration": 1e300}, TOO_LONG),
        ("penetration", {"duration": 1e12}, TOO_LONG),
        ("coupled-drilling", {"duration": 1e12}, TOO_LONG),
        ("rotary", {"duration": 1e12, "method": "diffrax"}, TOO_LONG),
        ("rotary", {"duration": 20.0, "step": 1e-12}, TOO_LONG + ", a longer step or a greater error"),
        ("rotary", {"duration": 20.0, "method": "smoothed"}, TOO_LONG + ", a longer step or a greater error"),
        ("rotary", {"duration": 5e-324}, "simulate: duration: .* is too short; give a longer one"),
        (
            "rotary",
            {"duration": 20.0, "sampling": 1e-12},
            r"simulate: sampling: 1e-12 s gives 2e\+13 samples in 20 s; ",
        ),
        ("rotary", {"duration": 1e300, "sampling": 1e-300}, "simulate: sampling: .* gives inf samples"),
        ("rotary", {"duration": 1.0, "sampling": 3.0}, ".* between 1 and 2000000 are needed, so 5e-07 to 1 s"),
        ("vibro-impact", {"k0": 1e300}, "simulate: the point cannot be run: too stiff, .*; give a smaller k0, c0, "),
        ("vibro-impact", {"c0": 1e300}, "simulate: the point cannot be run: too stiff, "),
    ],
)
def test_refused_before_any_work(scene, settings, message, monkeypatch):
    monkeypatch.setattr(_record, "record_batch", None)
    with pytest.raises(InputError) as refusal:
        vj.simulate(scene, **settings, progress=False)
    assert re.match(message, str(refusal.value)), refusal.value


def test_command_refuses_in_one_line(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["simulate", "rotary", "duration=1e12"]) == 2
    errors = capsys.readouterr().err
    assert re.fullmatch(f"vibrojax: {TOO_LONG}\n", errors) and list(tmp_path.iterdir()) == []


def test_memory_is_limited(monkeypatch):
    """Memory is checked before and during the run: the estimate before the run cannot include events."""
    monkeypatch.setattr(_record, "memory", lambda: 2e6)
    message = r"duration: 10000 s need about 1.8e\+05 steps and 2\d\d MB of memory; .* and 2 MB of memory"
    with pytest.raises(InputError, match=message):
        vj.simulate("rotary", duration=1e4, sampling=100.0, progress=False)
    message = r"duration: \d{4} steps, all there is room for, led to \S+ s of 80 s; give a shorter duration"
    with pytest.raises(InputError, match=message):
        vj.simulate("rotary", duration=80.0, sampling=1.0, progress=False)


def test_trajectory_shorter_than_its_samples_has_two():
    motion = vj.simulate("rotary", duration=1e-9, progress=False)
    assert motion.time.values.tolist() == [0.0, 1e-9]

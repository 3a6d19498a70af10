"""Test that a value in the wrong unit is accepted, with a one-line warning that names the likely unit."""

import csv
import warnings
from pathlib import Path

import pytest

import vibrojax as vj
from vibrojax.cli import main
from vibrojax.errors import Place
from vibrojax.maps.read import read_point
from vibrojax.physics.friction import FRICTION_LAWS
from vibrojax.scenes import SCENES
from vibrojax.settings.toml import bundled_names

SWEEPS = Path(__file__).parents[1] / "sweeps"


def warning_text(scene, **parameters):
    """Return the text of the only warning for a point."""
    with pytest.warns(vj.UnusualValue) as caught:
        read_point(Place("simulate"), scene, parameters)
    assert len(caught) == 1 and "\n" not in str(caught[0].message)
    return str(caught[0].message)


@pytest.mark.parametrize(
    ("scene", "name", "value", "suggestion"),
    [
        ("vibro-impact", "delta", 5.0, "if in mm, write 0.005 m"),
        ("vibro-impact", "delta", -5.0, "if in mm, write -0.005 m"),
        ("vibro-impact", "k0", 50.0, "if in kN/mm, write 5e+07 N/m"),
        ("rotary", "k1", 156.25, "if in N/mm, write 156250 N/m"),
        ("rotary", "m1", 0.25, "if in t, write 250 kg"),
        ("rotary", "beta", 40.0, "if in %, write 0.4"),
        ("rotary", "v", 120.0, "of a rotation give rpm and bit_radius"),
        ("rotary", "v", 1500.0, "if in mm/s, write 1.5 m/s"),
        ("penetration", "threshold", 150.0, "if in kN, write 150000 N"),
        ("penetration", "force", 0.2, "if in MN, write 200000 N"),
        ("penetration", "frequency", 1200.0, "if in 1/min, write 20 1/s"),
        ("penetration", "k3", 300.0, "if in kN/mm, write 3e+08 N/m"),
        ("penetration", "zeta", 110.0, "if in %, write 1.1"),
    ],
)
def test_value_in_wrong_unit_gives_warning(scene, name, value, suggestion):
    line = warning_text(scene, **{name: value})
    assert line.startswith(f"simulate: {name}: ") and "far outside what the source and rigs have" in line
    assert suggestion in line


def test_defaults_and_limits_of_usual_range_give_no_warning():
    for scene_type in SCENES.values():
        for parameter in scene_type().parameters().values():
            assert not parameter.is_far(parameter.default)
            for end in parameter.usual or ():
                assert not parameter.is_far(end)
                assert parameter.is_far(1e9 * (end or 1.0))
    for law in FRICTION_LAWS.values():
        assert not any(parameter.is_far(parameter.default) for parameter in law.parameters.values())


def test_bundled_sweeps_and_zeros_give_no_warning():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for name in bundled_names():
            vj.read_sweep(name)
        read_point(Place("simulate"), "vibro-impact", {"c0": 0.0, "c2": 0.0, "v": 0.0, "delta": 0.0, "mu": 0.0})


def test_hard_cases_give_warnings():
    rows = list(csv.DictReader((SWEEPS / "hard_cases.csv").read_text().splitlines()))
    points = {name: [float(row[name]) for row in rows] for name in rows[0] if name != "start"}
    with pytest.warns(vj.UnusualValue) as caught:
        vj.read_sweep({"scene": "vibro-impact", "points": points})
    lines = [str(record.message) for record in caught]
    assert any("points.k0: 2 of 53 values, such as 1e+200 N/m, are far outside" in line for line in lines)
    assert all(line.endswith("; unusual = true says that it is meant") for line in lines)


def test_sweep_warns_once_per_axis_unless_marked_unusual():
    sweep = {"scene": "vibro-impact", "parameters": {"k0": 50.0}, "grid": {"delta": [-5.0, 0.0, 5.0]}}
    with pytest.warns(vj.UnusualValue) as caught:
        vj.read_sweep(sweep)
    assert [str(record.message).partition(" far ")[0] for record in caught] == [
        "sweep: parameters.k0: 50 N/m is",
        "sweep: grid.delta: 2 of 3 values, such as -5 m, are",
    ]
    assert caught[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        vj.read_sweep(sweep | {"unusual": True})
        vj.read_sweep(sweep, ["unusual=true"])
    with pytest.raises(vj.InputError, match="sweep: unusual: 1 is neither true nor false"):
        vj.read_sweep(sweep | {"unusual": 1})


def test_command_warns_once_and_continues(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with pytest.warns(vj.UnusualValue) as caught:
        assert main(["simulate", "penetration", "threshold=150", "duration=0.05"]) == 0
    assert len(caught) == 1 and (tmp_path / "penetration.nc").exists()

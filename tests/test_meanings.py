"""Misnamed parameters are suggested by meaning, in every command and in Python."""

import numpy as np
import pytest
import xarray as xr

import vibrojax as vj
from vibrojax.cli import main
from vibrojax.errors import InputError
from vibrojax.models.physics.meanings import suggest_by_meaning

SPEEDS = "v (drive speed [m/s]), v_cr (Stribeck speed [m/s]) or rpm (rotation speed of the drive [1/min])"
STIFFNESSES = "k1 (main spring stiffness [N/m]) or k0 (contact stiffness [N/m])"
PULSES = "frequency (pulses per second [1/s])"


@pytest.mark.parametrize(
    ("scene", "word", "meant"),
    [
        ("vibro-impact", "gap", "delta (gap [m])"),
        ("vibro-impact", "clearance", "delta (gap [m])"),
        ("vibro-impact", "gap_width", "delta (gap [m])"),
        ("vibro-impact", "preload", "delta (gap [m])"),
        ("vibro-impact", "Δ", "delta (gap [m])"),
        ("vibro-impact", "k₁", "k1 (main spring stiffness [N/m])"),
        ("vibro-impact", "speed", SPEEDS),
        ("vibro-impact", "velocity", SPEEDS),
        ("vibro-impact", "mass", "m1 (bit mass [kg]) or beta (mass ratio m2/m1)"),
        ("vibro-impact", "damping", "c2 (damping [N s/m]) or c0 (contact damping [N s/m])"),
        ("vibro-impact", "stiffness", STIFFNESSES),
        ("vibro-impact", "contact-stiffness", "k0 (contact stiffness [N/m])"),
        ("vibro-impact", "w2/w1", "gamma (frequency ratio w2/w1)"),
        ("vibro-impact", "freq", "gamma (frequency ratio w2/w1)"),
        ("vibro-impact", "frequency", "gamma (frequency ratio w2/w1)"),  # a parameter of another scene
        ("penetration", "freq", PULSES),
        ("penetration", "hz", PULSES),
        ("penetration", "f", PULSES),
        ("drilling", "strength", "threshold (force at which the rock yields [N])"),
    ],
)
def test_names_are_suggested_by_meaning(scene, word, meant):
    with pytest.raises(InputError) as caught:
        vj.read_sweep({"scene": scene, "grid": {word: [1.0, 2.0]}})
    assert str(caught.value).endswith(f"; did you mean {meant}?")


@pytest.mark.parametrize("word", ["gama", "zzz", "", "_"])
def test_other_words_have_no_meaning(word):
    assert suggest_by_meaning(word, vj.SCENES["vibro-impact"]().parameters().values()) == ""


@pytest.mark.parametrize(
    "argv",
    [
        ["simulate", "vibro-impact", "gap=0.005"],
        ["push", "vibro-impact", "gap=0.005"],
        ["tolerance", "vibro-impact", "gap=0.005+-0.001"],
        ["follow", "vibro-impact", "gap=0.005", "along=gamma", "at=0.7", "from=0.6", "to=0.8"],
        ["follow", "vibro-impact", "along=gap", "at=0", "from=-0.001", "to=0.001"],
        ["sweep", "regime-map", "--dry-run", "--set", "gap=0.005"],
    ],
)
def test_every_command_suggests_by_meaning(argv, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as caught:
        raise SystemExit(main(argv))
    assert caught.value.code == 2
    line = capsys.readouterr().err
    assert line.endswith("did you mean delta (gap [m])?\n") and line.count("\n") == 1


GAP = {"units": "m", "long_name": "gap between striker and bit (negative: preload)", "symbol": "Δ"}


def rates():
    rate = xr.DataArray(np.linspace(1e-3, 2e-3, 4), dims="delta", attrs={"units": "m s-1"})
    coords = {"delta": ("delta", np.linspace(0.0, 1e-3, 4), GAP)}
    return xr.Dataset({"rate_of_penetration": rate, "relief": 1e3 * rate}, coords)


@pytest.mark.parametrize(
    "call",
    [
        lambda: vj.simulate("vibro-impact", gap=0.005, progress=False),
        lambda: vj.derivatives("vibro-impact", of="period", by="gap", progress=False),
        lambda: vj.picture(rates(), where={"gap": 0.0}),
        lambda: vj.fit_rop(rates(), along="gap"),
    ],
)
def test_python_suggests_by_meaning(call):
    with pytest.raises(InputError, match=r"did you mean delta \(gap \[m\]\)\?$"):
        call()

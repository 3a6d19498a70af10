"""Tests that misnamed parameters are suggested by meaning, in every command and in Python."""

import numpy as np
import pytest
import xarray as xr

import vibrojax as vj
from vibrojax.cli import main
from vibrojax.errors import InputError
from vibrojax.physics.meanings import suggest_by_meaning

SPEEDS = "v (drive speed [m/s]), v_cr (Stribeck speed [m/s]) or rpm (rotation speed of the drive [1/min])"
STIFFNESSES = "k1 (main spring stiffness [N/m]) or k0 (contact stiffness [N/m])"
FREQUENCIES = (
    "bit_frequency (natural frequency of the bit alone [Hz]), striker_frequency (natural frequency of the striker "
    "alone [Hz]) or gamma (frequency ratio w2/w1)"
)
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
        ("vibro-impact", "freq", FREQUENCIES),
        ("vibro-impact", "hz", FREQUENCIES),
        ("vibro-impact", "frequency", FREQUENCIES),  # a parameter of another scene
        ("penetration", "freq", PULSES),
        ("penetration", "hz", PULSES),
        ("penetration", "f", PULSES),
        ("drilling", "strength", "threshold (force at which the rock yields [N])"),
    ],
)
def test_names_are_suggested_by_meaning(scene, word, meant):
    with pytest.raises(InputError) as error:
        vj.read_sweep({"scene": scene, "grid": {word: [1.0, 2.0]}})
    assert str(error.value).endswith(f"; did you mean {meant}?")


@pytest.mark.parametrize(
    ("scene", "values", "line"),
    [
        ("rotary", {"gap": 1}, 'gap: scene "rotary" has no delta (gap [m]); scenes with one: coupled-drilling, '),
        ("vibro-impact", {"blows": 200}, "blows: is a result of the motion and determines no parameter; give v"),
        ("drilling", {"blow_frequency": 200}, "blow_frequency: is a result of the motion"),
        ("rotary", {"gamma": 0.7, "striker_frequency": 3}, "striker_frequency: gamma is given as well; give gamma, or"),
        ("rotary", {"k1": 1e5, "bit_frequency": 3}, "bit_frequency: k1 is given as well; give k1, or bit_frequency"),
        ("rotary", {"striker_frequency": 0}, "striker_frequency: is 0; it must be above 0 Hz"),
        ("penetration", {"bit_frequency": 3}, 'bit_frequency: scene "penetration" has no such parameter'),
    ],
)
def test_values_that_determine_no_parameter_are_refused(scene, values, line):
    for call in (
        lambda: vj.simulate(scene, **values, progress=False),
        lambda: vj.read_sweep({"scene": scene, "parameters": values, "grid": {"m1": [250.0]}}),
    ):
        with pytest.raises(InputError) as error:
            call()
        assert line in str(error.value) and "\n" not in str(error.value)


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
    with pytest.raises(SystemExit) as error:
        raise SystemExit(main(argv))
    assert error.value.code == 2
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
        lambda: vj.sensitivity("vibro-impact", of="period", by="gap", progress=False),
        lambda: vj.picture(rates(), where={"gap": 0.0}),
        lambda: vj.fit_rop(rates(), along="gap"),
    ],
)
def test_python_suggests_by_meaning(call):
    with pytest.raises(InputError, match=r"did you mean delta \(gap \[m\]\)\?$"):
        call()

"""Tests that misnamed parameters are suggested by meaning, in every command and in Python."""

import pytest

import vibrojax as vj
from vibrojax.errors import InputError

SPEEDS = "v (drive speed [m/s]), v_cr (Stribeck speed [m/s]) or rpm (rotation speed of the drive [1/min])"
FREQUENCIES = (
    "bit_frequency (natural frequency of the bit alone [Hz]), striker_frequency (natural frequency of the striker "
    "alone [Hz]) or gamma (frequency ratio w2/w1)"
)
PULSES = "frequency (pulses per second [1/s])"


@pytest.mark.parametrize(
    ("scene", "word", "meant"),
    [
        ("vibro-impact", "gap", "delta (gap [m])"),
        ("vibro-impact", "speed", SPEEDS),
        ("vibro-impact", "freq", FREQUENCIES),
        ("penetration", "hz", PULSES),
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
        ("rotary", {"gamma": 0.7, "striker_frequency": 3}, "striker_frequency: gamma is given as well; give gamma, or"),
        ("rotary", {"striker_frequency": 0}, "striker_frequency: is 0; it must be above 0 Hz"),
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

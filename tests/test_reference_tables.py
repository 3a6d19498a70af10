"""Test that tables and texts about scenes agree with what sweeps accept, and warnings of values in a wrong unit."""

import re
import warnings

import pytest
from refusals import refusal

import vibrojax as vj
from vibrojax.cli import main
from vibrojax.errors import Place
from vibrojax.io.variables import VARIABLES
from vibrojax.lanes.labels import feature_names
from vibrojax.maps.read import read_point
from vibrojax.settings.run_settings import RunSettings
from vibrojax.studies.catalogue import scene_text


@pytest.mark.parametrize("scene", ["rotary", "vibro-impact", "penetration", "drilling", "coupled-drilling"])
def test_parameters_agree_with_those_of_sweeps(scene):
    table = vj.list_parameters(scene)
    always = table[table["where"] == ""]
    sweep = vj.read_sweep({"scene": scene, "parameters": dict(always.default.drop("m1")), "grid": {"m1": [200.0]}})
    usual = sweep.friction or "rectangular"
    own = table[table["where"].str.contains(f'"{usual}"')]
    assert {*always.index, *own.index} == set(sweep.system.parameters())
    assert {**always.default, **own.default} == {"m1": 250.0, **sweep.parameters}


@pytest.mark.parametrize(("scene", "axis"), [("vibro-impact", "gamma"), ("penetration", "m1")])
def test_variables_agree_with_those_of_dataset(scene, axis):
    run = {"settle": 0.5, "observe": 0.5, "orbits": True} | ({} if scene == "penetration" else {"keep_returns": 1})
    ds = vj.run_sweep({"scene": scene, "grid": {axis: [0.7]}, "run": run}, progress=False)
    listed = vj.list_variables(scene)
    assert list(listed.index[listed["where"] == ""]) == list(ds.data_vars)


def test_measures_of_the_package_are_variables():
    """The others end as labels, or as inputs of orbits and error estimates."""
    hidden = {"finished", "finite", "steps", "trend", "load", "return_interval", "return_growth"}
    for scene in (vj.SCENES["vibro-impact"](), vj.SCENES["drilling"]()):
        states = (f"return_{name}" for name in scene.return_states)
        scales = (f"{name}_scale" for name in scene.return_states)
        assert feature_names(scene) <= {*VARIABLES, *hidden, *states, *scales}


def test_settings_agree_with_run_settings():
    assert vj.list_settings().default.to_dict() == vars(RunSettings())


def test_scenes_command(capsys):
    assert main(["scenes"]) == 0
    assert "vibro-impact      Bit and striker with stick-slip friction; the striker hits" in capsys.readouterr().out
    assert main(["scenes", "rotary"]) == 0
    text = capsys.readouterr().out
    assert text == scene_text("rotary") + "\n"
    assert re.search(r"  gamma +γ +0.75    1 +above 0     0.15 to 15      frequency ratio w2/w1\n", text)
    assert re.search(r"  striker_frequency +f₂ +2.984   Hz .* in place of gamma\n", text)
    assert main(["scenes", "rotry"]) == 2
    assert capsys.readouterr().err == 'vibrojax: scenes: "rotry" is unknown; did you mean "rotary"?\n'


@pytest.mark.parametrize(
    ("scene", "name", "value", "suggestion"),
    [
        ("vibro-impact", "delta", -5.0, "if in mm, write -0.005 m"),
        ("rotary", "k1", 156.25, "if in N/mm, write 156250 N/m"),
        ("rotary", "v", 120.0, "of a rotation give rpm and bit_radius"),
        ("penetration", "frequency", 1200.0, "if in 1/min, write 20 1/s"),
        ("vibro-impact", "m1", 20.0, "(100 to 500 kg); check its unit"),
    ],
)
def test_value_in_wrong_unit_gives_warning(scene, name, value, suggestion):
    with pytest.warns(vj.UnusualValue) as caught:
        read_point(Place("simulate"), scene, {name: value})
    [line] = [str(each.message) for each in caught]
    assert line.startswith(f"simulate: {name}: ") and "far outside what the source and rigs have" in line
    assert suggestion in line and "\n" not in line


def test_defaults_and_limits_of_usual_range_give_no_warning():
    for scene_type in vj.SCENES.values():
        for parameter in scene_type().parameters().values():
            assert not parameter.is_far(parameter.default)
            for end in parameter.usual or ():
                assert not parameter.is_far(end)
                assert parameter.is_far(1e9 * (end or 1.0))
    for law in vj.FRICTION_LAWS.values():
        assert not any(parameter.is_far(parameter.default) for parameter in law.parameters.values())


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
    assert "sweep: unusual: 1 is neither true nor false" in refusal(vj.read_sweep, sweep | {"unusual": 1})

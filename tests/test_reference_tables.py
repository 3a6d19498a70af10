"""Test that the tables and texts about scenes agree with what sweeps accept and return."""

import re

import pytest

import vibrojax as vj
from vibrojax.cli import main
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

"""Test how scenes declare options that are given by name."""

from dataclasses import fields

import pytest

import vibrojax as vj


@pytest.mark.parametrize("name", vj.SCENES)
def test_every_option_of_scene_has_registry(name):
    scene = vj.SCENES[name]()
    for option in fields(scene):
        assert getattr(scene, option.name) in scene.choices[option.name].values()


@pytest.mark.parametrize("name", vj.SCENES)
def test_other_choices_stand_for_parameters(name):
    scene = vj.SCENES[name]()
    short = {choice: values for choice, values in scene.choices.items() if not hasattr(scene, choice)}
    assert set(short) == ({"rock"} if isinstance(scene, vj.HasRock) else set())
    for values in short.values():
        for value in values.values():
            assert {"threshold", "k3"} <= {field.name for field in fields(value)} & set(scene.parameters())


def test_choices_are_live_registry_of_laws():
    assert vj.SCENES["rotary"].choices["friction"] is vj.FRICTION_LAWS

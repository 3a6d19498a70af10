"""Test that the code of a scene is part of the identity of results, to the last constant of every function."""

import numpy as np
import pytest

import vibrojax as vj
from vibrojax.settings.code_identity import code_identity

PARTS = ("field", "period", "rate", "gap", "reset", "restitution", "force", "law", "mass", "surface")


def system(changed=None, c=1.1):
    """Return a system in which one function differs in a constant. Each function has a variable of its own."""
    field, period, rate, gap, reset, restitution, force, law, mass, surface = (
        c if name == changed else 1.0 for name in PARTS
    )
    falling = vj.FrictionLaw("falling", "own", {}, lambda u, p: law * 0.3 + 0.1 * vj.elementary.exp(-u))
    belt = vj.Friction(
        "belt", lambda t, y, p: y["w"] - surface, lambda t, y, p: force, law=falling, acts_on="w", mass=lambda p: mass
    )
    bounce = lambda p: 0.8 * restitution  # noqa: E731
    stop = vj.Impact("stop", lambda t, y, p: gap - y["x"], velocity="v", restitution=bounce)
    kick = vj.Impact("kick", lambda t, y, p: 9.0 - y["y"], reset=lambda t, y, p: {"w": -0.5 * reset * y["w"]})
    return vj.System(
        "all-parts",
        states={"x": "m", "v": "m s-1", "y": "m", "w": "m s-1"},
        parameters={"a": 1.0},
        field=lambda t, y, p: {"x": y["v"], "v": -field * y["x"], "y": y["w"], "w": -y["y"] - 0.1 * y["w"]},
        period=lambda p: period * 6.0,
        rate=lambda p: 3.0 * rate,
        events=[stop, kick, belt],
    )


@pytest.mark.parametrize("part", PARTS)
def test_identity_has_every_constant(part):
    assert code_identity(system(part)) != code_identity(system()) == code_identity(system())


def oscillator(stiffness):
    return vj.System(
        "oscillator",
        states={"x": "m", "v": "m s-1"},
        parameters={"w": 0.9},
        field=lambda t, y, p: {"x": y["v"], "v": vj.elementary.cos(p["w"] * t) - 0.1 * y["v"] - stiffness * y["x"]},
        period=lambda p: 2 * np.pi / p["w"],
    )


def test_dataset_of_an_earlier_definition_is_not_run_with_a_later_one():
    first = vj.run_sweep({"scene": oscillator(1.0), "grid": {"w": [0.9]}}, progress=False)
    vj.run_sweep({"scene": oscillator(2.0), "grid": {"w": [0.9]}}, progress=False)
    with pytest.raises(vj.InputError, match=r"code\.scene has changed since; give the sweep itself"):
        vj.orbits(first, progress=False)


def test_changed_variable_is_refused():
    """Compiled code keeps the value that the variable had."""
    stiffness = 1.0
    decay = lambda t, y, p: {"x": -stiffness * y["x"]}  # noqa: E731
    own = vj.System("variable", states={"x": "m"}, parameters={"a": 1.0}, field=decay, period=lambda p: 1.0)
    vj.simulate(own, duration=1.0, progress=False)
    stiffness = 2.0
    with pytest.raises(vj.InputError, match="a value that its functions use has changed since its first run"):
        vj.simulate(own, duration=1.0, progress=False)

"""What a user writes outside the package stands where names stand: a friction law, a scene, a stepper, a measure."""

from dataclasses import dataclass
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
import pytest

import vibrojax as vj
from vibrojax.measure import Gauge
from vibrojax.physics.friction import FRICTION_LAWS, FrictionLaw
from vibrojax.scenes.vibro_impact import VibroImpact
from vibrojax.stepping import Located

RUN = {"settle": 6.0, "observe": 6.0}
POINT = {"beta": 0.4, "gamma": 0.7}


def sweep(scene="vibro-impact", parameters=None, **run):
    return vj.run_sweep(
        {"scene": scene, "parameters": parameters or {}, "grid": {"gamma": [0.65, 0.7]}, "run": RUN | run},
        progress=False,
    )


@pytest.fixture(scope="module")
def usual():
    return sweep()


def my_law():
    """Eq. 5.9 once more, under another name."""
    stribeck = FRICTION_LAWS["stribeck"]
    return FrictionLaw("mine", "eq. 5.9", stribeck.parameters, stribeck.mu, stribeck.mu_impact)


def test_a_friction_law(usual):
    own = sweep(parameters={"friction": my_law()})
    assert own.attrs["friction"] == "mine" and 'friction = "mine"' in own.attrs["sweep"]
    for name in usual.data_vars:
        np.testing.assert_array_equal(own[name], usual[name], err_msg=name)
    motion = vj.simulate("vibro-impact", friction=my_law(), **POINT, duration=1.0, progress=False)
    known = vj.simulate("vibro-impact", **POINT, duration=1.0, progress=False)
    np.testing.assert_array_equal(motion.x2, known.x2)


def test_a_scene_with_its_law_chosen(usual):
    own = sweep(VibroImpact(friction=my_law()))
    assert own.attrs["scene"] == "vibro-impact" and own.attrs["friction"] == "mine"
    np.testing.assert_array_equal(own.impact_velocity, usual.impact_velocity)


def test_a_stepper(usual):
    """One of a higher order: the same motion, within what either accepts."""
    finer = sweep(method=Located(order=12))
    assert '"order": 12' in finer.attrs["solver"]
    np.testing.assert_array_equal(finer.regime, usual.regime)
    np.testing.assert_allclose(finer.period, usual.period, rtol=1e-6)
    assert np.any(finer.period != usual.period)


@dataclass(frozen=True)
class MeanSpeed(Gauge):
    """Mean of |x2'| over whole returns [m/s]: the striker's way up and down, per time."""

    summed: ClassVar[tuple[str, ...]] = ("way",)
    variables: ClassVar[dict[str, tuple[str, str]]] = {"striker_mean_speed": ("m s-1", "mean speed of the striker")}

    def increments(self, scene, c, moment):
        place = scene.place("x2")
        return {"way": jnp.abs(moment.step.after[place] - moment.step.before[place])}

    def read(self, scene, c, carry, whole):
        return {"striker_mean_speed": whole.sums["way"] / whole.time}


@dataclass(frozen=True)
class Measured(VibroImpact):
    measures = (*VibroImpact.measures, MeanSpeed())


def test_a_measured_quantity(usual):
    """It is in the dataset with its unit; the striker goes up and down by its swing in a period, as steps end on its
    turns."""
    own = sweep(Measured())
    assert own.striker_mean_speed.attrs["units"] == "m s-1"
    clean = (own.cycles == 1) & (own.striker_turns == 1)
    assert clean.any()
    swings = 4 * own.striker_amplitude / own.period
    np.testing.assert_allclose(own.striker_mean_speed.where(clean), swings.where(clean), rtol=1e-2)
    np.testing.assert_allclose(own.impact_velocity, usual.impact_velocity, rtol=1e-9)

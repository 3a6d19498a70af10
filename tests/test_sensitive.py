"""Test the flag for lanes in which rounding errors decide the attractor."""

import numpy as np
import pytest

import vibrojax as vj
from vibrojax.lanes import certificate as module
from vibrojax.scenes import SCENES


def test_slow_regular_transients_are_not_flagged():
    """Some lanes settle only after 40 returns, but slightly perturbed parameters lead to the same attractor."""
    sweep = {
        "scene": "vibro-impact",
        "starts": ["drive", "stuck"],
        "parameters": {"delta": -0.005},
        "grid": {"beta": [0.8, 0.9, 1.0], "gamma": [0.5, 0.6]},
    }
    lanes = vj.run_sweep(sweep, progress=False)
    assert (lanes.settling_time > module.GROWTH_RETURNS * lanes.period).sum() >= 3
    assert (lanes.cycles > 0).all()
    assert (lanes.sensitive == 0).all()
    assert lanes.sensitive.dtype == np.int8


def test_lanes_on_a_chaotic_transient_are_flagged():
    """Here a chaotic transient ends on a single impact, at a time that rounding decides."""
    points = {"beta": (0.8944 * (1 + 1e-10 * np.arange(64))).tolist(), "gamma": [0.8] * 64, "delta": [0.005] * 64}
    sweep = {"scene": "vibro-impact", "starts": ["drive"], "points": points, "run": {"settle": 52.0}}
    lanes = vj.run_sweep(sweep, progress=False)
    periodic = lanes.sensitive.values[lanes.cycles.values > 0]
    assert len(periodic) >= 5 and periodic.mean() >= 0.9


def crossings(periodic_since, seed, lanes=1):
    """Return features of aperiodic lanes whose crossings are equal from the crossing with this number on."""
    rng = np.random.default_rng(seed)
    time = 0.2 * np.arange(25.0)
    later = np.arange(25) >= periodic_since
    features = {f"return_{name}": np.where(later, 0.3, rng.random((lanes, 25))) for name in ("x1", "x2", "v2")}
    features |= {name: np.ones(lanes) for name in ("bit_amplitude", "striker_amplitude")}
    features |= {"cycles": np.zeros(lanes), "finished": np.ones(lanes, bool), "finite": np.ones(lanes, bool)}
    features["period"] = np.full(lanes, 0.2)
    return features | {"return_time": np.tile(time, (lanes, 1)), "return_interval": np.full((lanes, 25), 0.2)}


@pytest.mark.parametrize(("fine", "check", "differ"), [(99, 99, False), (10, 13, True), (99, 10, True)])
def test_ends_of_transients_are_compared(fine, check, differ):
    """A lane is flagged if only one of its two runs becomes periodic, or each at another time."""
    runs = crossings(fine, 1), crossings(check, 2)
    assert module.ends_differ(*runs, SCENES["rotary"].section).tolist() == [differ]

"""Test the drift of a lane, which is estimated from its last returns, against linear return maps."""

import numpy as np
import pytest

import vibrojax as vj
from vibrojax.lanes import drift as drift_module
from vibrojax.scenes import SCENES


def drift(features, precision, tolerance):
    return drift_module.drift(features, SCENES["rotary"].section, precision, tolerance)


PERIOD, VELOCITY = 0.23, 1.4
OF_PERIOD, OF_VELOCITY = np.array([0.3, -0.2, 0.1]), np.array([2.0, 1.0, -3.0])
ORBIT = np.array([0.5, -0.3, 0.8])
BASIS = np.array([[1.0, 0.2, -0.4], [0.3, 1.0, 0.5], [-0.2, 0.1, 1.0]])


def spiral_map(modulus, angle):
    """Return a return map with a complex pair of multipliers, and a third near zero."""
    c, s = modulus * np.cos(angle), modulus * np.sin(angle)
    return BASIS @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 0.07]]) @ np.linalg.inv(BASIS)


def real_map(first, second):
    """Return a return map with two real multipliers, and a third near zero."""
    return BASIS @ np.diag([first, second, 0.07]) @ np.linalg.inv(BASIS)


def lane(return_map, away, cycles=1, returns=25, seen=25, alternating=0.0, impacts=True):
    """Return features and true drift of a lane whose first return has the relative distance `away` from its orbit.

    `alternating` is the amplitude by which successive returns on the orbit alternate.
    """
    states, period, velocity = [], [], []
    state = ORBIT + away * np.array([0.4, -1.0, 0.7])
    for k in range(returns):
        alternation = alternating * (-1) ** k
        states.append(state + alternation)
        period.append(PERIOD * (1 + OF_PERIOD @ (state - ORBIT) + alternation))
        velocity.append(VELOCITY * (1 + OF_VELOCITY @ (state - ORBIT) - alternation))
        state = ORBIT + return_map @ (state - ORBIT)
    whole_cycles = (returns - 1) // cycles * cycles
    features = {
        "cycles": np.array([float(cycles)]),
        "period": np.array([np.mean(period[-whole_cycles:])]),
        "impact_velocity": np.array([np.mean(velocity[-whole_cycles:])]),
        "bit_amplitude": np.array([1.0]),
        "striker_amplitude": np.array([1.0]),
        "return_time": np.cumsum(period)[None],
        "return_interval": np.array(period)[None],
        "return_impacts": np.ones((1, returns)),
        "return_impact_velocity": np.array(velocity)[None],
    }
    features |= {f"return_{name}": np.array(states)[None, :, i] for i, name in enumerate(("x1", "x2", "v2"))}
    kept = {name: x[:, -seen:] if x.ndim == 2 else x for name, x in features.items()}
    if not impacts:
        kept = {name: x for name, x in kept.items() if "impact" not in name}
    settled = {"period": PERIOD, "impact_velocity": VELOCITY}
    means = [abs(kept[name][0] / value - 1) for name, value in settled.items() if name in kept]
    scales = np.array([1.0, 1.0, 2 * np.pi / kept["period"][0]])
    motion = np.abs(states[-1] - ORBIT - alternating * (-1) ** (returns - 1)) / scales
    return kept, max(*means, *motion)


@pytest.mark.parametrize(
    "return_map", [spiral_map(0.985, 0.9), spiral_map(0.7, 0.1), real_map(0.99, 0.6), real_map(-0.97, 0.3)]
)
@pytest.mark.parametrize("returns", [9, 12, 25])
def test_linear_map(return_map, returns):
    """Drift is the distance of means and section states from their limits.

    With few returns, the third multiplier still contributes, and the estimate is up to two and a half times too large.
    """
    features, true = lane(return_map, 1e-3, returns=returns)
    assert true > 5e-5
    assert 0.99 * true <= drift(features, "float64", 1e-7)[0] <= (1.01 if returns == 25 else 2.5) * true


@pytest.mark.parametrize("cycles, returns", [(2, 25), (2, 10), (3, 25), (8, 25)])
def test_drift_of_longer_repeats(cycles, returns):
    """The estimate uses each `cycles`-th return, of which there are few for eight cycles."""
    features, true = lane(
        real_map(0.99, 0.9), 1e-3, cycles=cycles, returns=returns, alternating=0.1 if cycles == 2 else 0.0
    )
    estimate = drift(features, "float64", 1e-7)
    if cycles == 2:
        assert 0.99 * true <= estimate[0] <= 3 * true
    else:
        assert np.isinf(estimate)  # the returns are closer to a repeat after one return


def test_certified_periods_remain_after_settling():
    """Near the border of stick, some transients of rotary lanes end during the observation."""
    sweep = {"scene": "rotary", "parameters": {"beta": 0.3, "gamma": 0.7}, "starts": ["drive"]}
    sweep["points"] = {"v": np.linspace(2.05, 2.2, 151).tolist()}
    early, late = (vj.run_sweep(sweep | {"run": {"settle": settle}}, progress=False) for settle in (40.0, 100.0))
    certified = early.error_estimate <= 1e-4
    assert certified.sum() > 50
    assert (early.cycles == late.cycles).where(certified, True).all()


def test_drift_of_noisy_returns_is_unknown():
    """Differences between returns follow no linear map. The drift is finite only if the step noise explains them."""
    rng = np.random.default_rng(3)
    features, _ = lane(real_map(0.5, 0.1), 0.0)
    for name in ("return_x1", "return_x2", "return_v2"):
        features[name] = features[name] + 3e-4 * rng.standard_normal(features[name].shape)
    assert np.isinf(drift(features, "float64", 1e-7))
    assert np.isfinite(drift(features, "float64", 1e-2))


def test_slowly_growing_amplitude_has_drift():
    """Without impacts, the period does not depend on the amplitude and has no drift itself."""
    growth = 1 + 4e-5
    swing = 1e-2 * growth ** np.arange(25)
    features, _ = lane(spiral_map(0.5, 0.4), 0.0)
    features["return_x1"] = ORBIT[0] - swing[None]
    for name in ("return_interval", "return_impact_velocity"):
        features[name] = np.full((1, 25), features[name][0, 0])
    assert drift(features, "float64", 1e-7)[0] == pytest.approx(swing[-1], rel=1e-3)

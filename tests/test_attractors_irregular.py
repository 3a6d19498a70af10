"""Test irregular attractors: lanes are observed until their statistics converge, then grouped by them."""

import numpy as np
import pytest
from test_attractors import BOX

import vibrojax as vj
from vibrojax.measures.labels import IRREGULAR
from vibrojax.studies.attractor_groups import CONVERGED_STDERR, statistics

SCENE = {"scene": "vibro-impact", "parameters": {"delta": 0.005, "v": 1.5}}


def starts(count, seed):
    return {"starts": {"sample": "sobol", "count": count, "seed": seed, "box": BOX}}


def irregular_shares(attractors):
    """Return the shares of the irregular attractors at the only point."""
    share, regime = attractors.share.values.ravel(), attractors.regime.values.ravel()
    return share[(share > 0) & (regime == IRREGULAR)].tolist()


@pytest.fixture(scope="module")
def bursting():
    """Return a sweep of one point whose irregular motion often rests without impacts for longer than an observation."""
    grid = {"beta": [0.25], "gamma": [0.74]}
    sweep = SCENE | starts(32, 3) | {"grid": grid, "run": {"settle": 200.0, "observe": 8.0, "orbits": True}}
    return vj.run_sweep(sweep, progress=False)


def test_bursting_motion_is_one_attractor(bursting):
    lanes = np.flatnonzero(bursting.regime.values.ravel() == IRREGULAR)
    assert lanes.tolist() == [26, 28]
    observed = bursting.period.values.ravel()[lanes]
    assert observed[0] > 2 * observed[1] and np.isnan(bursting.impact_velocity.values.ravel()[28])
    attractors = vj.attractors(bursting, progress=False)
    assert irregular_shares(attractors) == [2 / 32] and attractors.unassigned.sum() == 0
    number = int(attractors.lane_attractor.values.ravel()[26])
    assert attractors.period.values.ravel()[number] == pytest.approx(0.270, rel=0.1)  # over 2,048 s of either lane


@pytest.mark.long
def test_two_irregular_motions_at_one_point_are_separated():
    """Their impact velocities are 0.54 and 0.23 m/s over 800 s."""
    grid = {"beta": [1.1], "gamma": [0.5]}
    attractors = vj.attractors(SCENE | starts(16, 0) | {"grid": grid, "run": {"settle": 100.0}}, progress=False)
    share = irregular_shares(attractors)
    assert len(share) == 2 and share[1] == 0.25
    velocity = np.sort(attractors.impact_velocity.values[0, 0, : len(share)])
    np.testing.assert_allclose(velocity, [0.235, 0.54], rtol=0.1)


# Synthetic windows


def windows_of(total, count=None, cycles=0.0):
    """Return windows of one statistic from its totals (windows, lanes) and counts."""
    count = np.ones_like(total) if count is None else count
    return np.stack([total, count, np.full_like(total, cycles), np.ones_like(total)], axis=1)


def test_standard_errors_match_scatter_of_independent_windows():
    rng = np.random.default_rng(0)
    count = rng.integers(20, 60, (16, 4000)).astype(float)
    result = statistics(windows_of(0.2 * count * (1 + 0.1 * rng.standard_normal(count.shape)), count))
    scatter = np.std(result.values[0] / 0.2)
    assert np.sqrt(np.mean(result.errors[0] ** 2)) == pytest.approx(scatter, rel=0.05)
    assert result.converged.mean() > 0.99


def test_drifting_or_rarely_switching_motion_does_not_converge():
    time = np.arange(128.0)[:, None]
    drifting, switching = 1 + time / 128, np.where(time < 64, 1.0, 2.0)
    result = statistics(windows_of(np.hstack([drifting, switching, np.ones_like(time)])))
    assert result.converged.tolist() == [False, False, True]
    assert (result.errors[0, :2] > CONVERGED_STDERR).all()

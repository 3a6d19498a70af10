"""Test basin shares against bSTAB's friction oscillator (Stender and Hoffmann, Nonlinear Dynamics 2021)."""

import numpy as np
import pytest
from known_scenes import BeltOscillator

import vibrojax as vj

# Belt speed: published share of starts that end in steady sliding, and number of these starts. The source is the
# paper's MATLAB program or, for speeds that it lacks, the test file of its successor.
SHARES = {
    1.25: (0.0838, 5000),
    1.4: (0.211, 5000),
    1.475: (0.2824, 5000),
    1.5: (0.3165, 4000),
    1.55: (0.3636, 5000),
    1.625: (0.4336, 5000),
    1.7: (0.4912, 5000),
    1.775: (0.5552, 5000),
}
STARTS = {"sample": "sobol", "count": 2048, "seed": 1, "box": {"x1": [-2.0, 2.0], "v1": [-2.0, 0.0]}}
RUN = {"settle": 400.0, "observe": 60.0}


def sliding(speeds, starts=STARTS, **run):
    """Return the share of starts that end without sticking, by speed.

    The belt moves in the direction opposite to bSTAB's, so the box is mirrored.
    """
    tables = {"scene": BeltOscillator(), "starts": starts, "grid": {"v": speeds}, "run": RUN | run}
    lanes = vj.run_sweep(tables, progress=False)
    return (~(lanes.stick_fraction > 0)).mean("start").values


def test_shares_match_published_values():
    ours = sliding(list(SHARES))
    share, starts = (np.array(column) for column in zip(*SHARES.values(), strict=True))
    error = np.sqrt(share * (1 - share) / starts + ours * (1 - ours) / STARTS["count"])
    deviation = (ours - share) / error
    assert np.abs(deviation).max() < 2 and abs(deviation.mean()) < 1


def test_shares_match_pybasin_over_belt_speed():
    """pybasin's tests list shares of 2,000 starts each from bSTAB's successor, whose switch is tanh(200 u)."""
    of_2000 = {1.1: 0.0, 1.175: 0.018, 1.25: 0.080, 1.325: 0.1535, 1.4: 0.226, 1.475: 0.298, 1.55: 0.382, 1.625: 0.45}
    of_2000 |= {1.7: 0.5085, 1.775: 0.568, 1.85: 1.0}
    ours, share = sliding(list(of_2000)), np.array(list(of_2000.values()))
    error = np.sqrt(share * (1 - share) / 2000 + ours * (1 - ours) / STARTS["count"])
    assert (np.abs(ours - share) <= 2 * error).all()


def test_smoothed_switch_does_not_change_basins():
    """The border between the basins is an unstable cycle that only slides.

    Its velocity relative to the belt is about 0.6, where tanh(u/width) is 1. Neither bSTAB's slope of 200 nor a slope
    of 25 therefore shifts the border.
    """
    few = {"scene": BeltOscillator(), "starts": STARTS | {"count": 256}, "grid": {"v": [1.55]}}
    exact, smooth = (
        vj.run_sweep(few | {"run": {"settle": 100.0, "observe": 30.0} | settings}, progress=False).bit_amplitude < 0.2
        for settings in ({}, {"method": "smoothed", "smoothing": 0.04})
    )
    np.testing.assert_array_equal(exact, smooth)
    assert 0.2 < exact.mean() < 0.5


def test_no_start_slides_on_slow_belt_and_all_slide_on_fast_belt():
    few = STARTS | {"count": 256}
    slow, fast = sliding([1.0, 1.9], few)
    assert slow == 0 and fast == 1


def test_share_does_not_depend_on_sample_or_error():
    starts = STARTS | {"sample": "random", "count": 1024}
    share, other, half = (
        sliding([1.5], starts | {"seed": seed}, error=error)[0] for seed, error in ((1, 1e-4), (2, 1e-4), (2, 5e-5))
    )
    error = np.sqrt(share * (1 - share) / 1024)
    assert abs(share - other) < 3 * np.sqrt(2) * error and abs(half - other) < error


@pytest.mark.parametrize("start", [[0.4, -1.0], [1.5, 0.0]])
def test_steady_sliding_balances_friction_and_spring(start):
    """At rest, the spring carries the friction force at the belt's speed."""
    lane = vj.simulate(BeltOscillator(), v=1.9, start=start, duration=400.0, progress=False)
    assert abs(float(lane.x1[-1]) + 0.5 * (1 + np.exp(-1.9 / 0.5))) < 1e-3

"""Tests of hidden motions: if starts end in different motions with one label, dataset and map mark it."""

import numpy as np
import pytest

import vibrojax as vj
from vibrojax.errors import counted
from vibrojax.measures.labels import COMPARED, SAME_WITHIN, SINGLE_IMPACT, hides_another
from vibrojax.studies.summary import summarise, summary_lines

STARTS = ["drive", "stuck", "touching"]


def test_hidden_motion_agrees_with_comparison_of_all_pairs():
    random = np.random.default_rng(0)
    for _ in range(40):
        points, starts, motions = random.integers(1, 6), random.integers(2, 40), random.integers(1, 4)
        lanes, noise = points * starts, 10.0 ** random.uniform(-6, -1.5)
        spread, which = 10.0 ** random.uniform(-4, -1), random.integers(0, motions, lanes)
        features = {
            name: (1 + spread * random.normal(size=motions))[which] * (1 + noise * random.normal(size=lanes))
            for name in COMPARED
        }
        features["impact_velocity"][random.random(lanes) < 0.1] = np.nan
        features["cycles"] = random.integers(0, 3, lanes).astype(float)
        error = 10.0 ** random.uniform(-6, random.uniform(-5.5, -0.5), lanes)
        error[random.random(lanes) < 0.1] = np.inf
        features["error_estimate"] = error
        regime = random.integers(2, 4, lanes).astype(np.int8)
        assert (hides_another(features, regime, int(starts)) == _compare_all_pairs(features, regime, starts)).all()


def _compare_all_pairs(features, regime, starts):
    hidden = np.zeros(len(regime), int)
    for i in range(len(regime)):
        for j in range(i - i % starts, i - i % starts + starts):
            same = regime[i] == regime[j] and features["cycles"][i] > 0 and features["cycles"][j] > 0
            within = SAME_WITHIN + features["error_estimate"][i] + features["error_estimate"][j]
            pairs = [(features[name][i], features[name][j]) for name in COMPARED]
            hidden[i] |= same and any(abs(a - b) > within * max(abs(a), abs(b)) for a, b in pairs)
    return hidden


@pytest.fixture(scope="module")
def swept():
    grid = {"beta": [0.4, 0.5], "gamma": [0.6, 0.9]}
    return vj.run_sweep(
        {"scene": "vibro-impact", "starts": STARTS, "parameters": {"delta": 0.0}, "grid": grid}, progress=False
    )


def test_three_starts_have_one_label(swept):
    """A plain map would hide this case: 0.67, 3.03 and 0.67 m/s, all of them single impacts."""
    point = swept.sel(beta=0.4, gamma=0.6)
    assert (point.regime == SINGLE_IMPACT).all()
    np.testing.assert_allclose(point.impact_velocity, [0.67, 3.03, 0.67], atol=0.01)
    assert (point.hidden_motion == 1).all()
    points = int(swept.hidden_motion.any("start").sum())
    assert summary_lines(summarise(swept.isel(start=0)))
    assert f"at {counted(points, 'point')} starts end in different motions under one label" in "\n".join(
        summary_lines(summarise(swept))
    )

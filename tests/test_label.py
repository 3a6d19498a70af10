"""Tests of labels on synthetic features, in the order of the rules, and of motions that one label hides."""

import numpy as np
import pytest

import vibrojax as vj
from vibrojax.errors import counted
from vibrojax.measures.labels import COMPARED, REGIMES, SAME_WITHIN, SINGLE_IMPACT, hides_another, label
from vibrojax.studies.summary import summarise, summary_lines

MU, M1, G, K1 = 0.4, 250.0, 9.81, 156250.0
SWING = 1e-3 * MU * M1 * G / K1  # m, below which the bit is at rest

# A lane that repeats after every return, with one impact.
SINGLE = {"finite": True, "finished": True, "bit_amplitude": 0.05, "returns": 30.0}
SINGLE |= {"trend": 0.0, "cycles": 1.0, "impacts": 1.0}


def regime(**changes):
    features = {name: np.array([value]) for name, value in (SINGLE | changes).items() if value is not None}
    flags = label(features, np.array([MU]), np.array([M1]), np.array([G]), np.array([K1]))
    assert flags.dtype == np.int8
    assert flags.shape == (1,)
    return REGIMES[flags[0]]


def test_flags_keep_their_numbers_and_rest_has_a_least_friction():
    names = "undecided equilibrium impact-free single-impact multi-impact subharmonic irregular failed"
    assert tuple(names.split()) == REGIMES
    # A law with mu(0+) = 0 (2.15) is measured by max(mu(0+), 0.01).
    features = {name: np.array([value, value]) for name, value in SINGLE.items()}
    features["bit_amplitude"] = 1e-3 * 0.01 * M1 * G / K1 * np.array([0.99, 1.01])
    flags = label(features, np.zeros(2), np.full(2, M1), np.full(2, G), np.full(2, K1))
    assert [REGIMES[flag] for flag in flags] == ["equilibrium", "single-impact"]


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({}, "single-impact"),
        ({"impacts": 0.0}, "impact-free"),
        ({"impacts": 2.0}, "multi-impact"),
        ({"cycles": 2.0, "impacts": 3.0}, "subharmonic"),
        ({"cycles": 0.0, "impacts": 0.9}, "irregular"),
        ({"returns": 8.0}, "undecided"),
        ({"trend": 1.0}, "undecided"),
        ({"bit_amplitude": 0.99 * SWING}, "equilibrium"),
        ({"finite": False}, "failed"),
        ({"finished": False}, "failed"),
        # Of several rules, the first in the order 7, 1, 0, 2 to 5, 6 applies.
        ({"finite": False, "bit_amplitude": 0.0, "returns": 0.0}, "failed"),
        ({"bit_amplitude": 0.0, "returns": 0.0, "cycles": 0.0}, "equilibrium"),
        ({"returns": 5.0, "impacts": 0.0}, "undecided"),
        ({"trend": 1.0, "cycles": 0.0}, "undecided"),
    ],
)
def test_rules_in_order(changes, expected):
    assert regime(**changes) == expected


# Hidden motions: starts that end in different motions with one label
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
    tables = {"scene": "vibro-impact", "starts": STARTS, "parameters": {"delta": 0.0}, "grid": grid}
    return vj.run_sweep(tables, progress=False)


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

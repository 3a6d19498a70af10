"""Tests of the rules of `vibrojax.measures.labels` on synthetic features, in order: flags 7, 1, 0, 2 to 5, 6."""

import numpy as np
import pytest

from vibrojax.measures.labels import REGIMES, label

MU, M1, G, K1 = 0.4, 250.0, 9.81, 156250.0
SWING = 1e-3 * MU * M1 * G / K1  # m, below which the bit is at rest

# A lane that repeats after every return, with one impact.
SINGLE = {
    "finite": True,
    "finished": True,
    "bit_amplitude": 0.05,
    "returns": 30.0,
    "trend": 0.0,
    "cycles": 1.0,
    "impacts": 1.0,
}


def regime(**changes):
    features = {name: np.array([value]) for name, value in (SINGLE | changes).items() if value is not None}
    flags = label(features, np.array([MU]), np.array([M1]), np.array([G]), np.array([K1]))
    assert flags.dtype == np.int8
    assert flags.shape == (1,)
    return REGIMES[flags[0]]


def test_flags_keep_their_numbers():
    assert REGIMES == (
        "undecided",
        "equilibrium",
        "impact-free",
        "single-impact",
        "multi-impact",
        "subharmonic",
        "irregular",
        "failed",
    )


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


def test_least_friction():
    """A law with mu(0+) = 0 (2.15) is measured by max(mu(0+), 0.01)."""
    features = {name: np.array([value, value]) for name, value in SINGLE.items()}
    features["bit_amplitude"] = 1e-3 * 0.01 * M1 * G / K1 * np.array([0.99, 1.01])
    flags = label(features, np.zeros(2), np.full(2, M1), np.full(2, G), np.full(2, K1))
    assert [REGIMES[flag] for flag in flags] == ["equilibrium", "single-impact"]

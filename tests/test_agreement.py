"""Test the smoothed, located and adaptive steppers against each other, over a transient too short for chaos."""

import pytest

import vibrojax as vj
from vibrojax.studies.trajectory import feature_lines

STATES = ("x1", "v1", "x2", "v2")
STUCK = {"start": "stuck"}  # sticks, slips both ways, impacts; settles on a periodic orbit
IRREGULAR = {"k1": 625000.0, "gamma": 1.2, "start": "drive"}  # settles on a chaotic attractor (Fig. 5.77c)
WIDTHS = (1e-2, 1e-3, 1e-4)


def motion(point, **how):
    return vj.simulate("vibro-impact", **point, **how, duration=0.8, sampling=1e-3, progress=False)


@pytest.fixture(scope="module")
def located():
    return {"stuck": motion(STUCK), "irregular": motion(IRREGULAR)}


def position_error(trajectory, reference):
    """Return the largest difference of the positions, relative to the largest position."""
    return max(float(abs(trajectory[x] - reference[x]).max() / abs(reference[x]).max()) for x in ("x1", "x2"))


def mean_state_error(trajectory, reference):
    """Return the mean difference of all states, relative to their largest values.

    The maximum would be large, since velocities reverse within an impact of 4 ms.
    """
    return max(float(abs(trajectory[y] - reference[y]).mean() / abs(reference[y]).max()) for y in STATES)


def bound(width):
    """Return the order of the smoothing error: w^(4/5) in units of 1 m/s (see stepping/test_smoothed.py)."""
    return width**0.8


@pytest.mark.parametrize("width", WIDTHS)
def test_smoothed_matches_located(located, width):
    """The error stays below the bound of the width, which shrinks with the width."""
    smoothed = motion(STUCK, method="smoothed", smoothing=width, step=0.1 * width)
    assert position_error(smoothed, located["stuck"]) < bound(width)
    assert mean_state_error(smoothed, located["stuck"]) < bound(width)
    irregular = motion(IRREGULAR, method="smoothed", smoothing=width, step=0.1 * width)
    assert position_error(irregular, located["irregular"]) < bound(width)


def test_smoothed_matches_diffrax():
    """Both solve the same equations, so at equal widths only their step errors differ. These are far smaller."""
    smoothed = motion(STUCK, method="smoothed", smoothing=1e-2, step=1e-4)
    adaptive = motion(STUCK, solver="Tsit5", smoothing=1e-2, error=1e-6)
    assert position_error(smoothed, adaptive) < 1e-2 * bound(1e-2)
    assert "regime" not in adaptive and feature_lines(adaptive) == []

"""Test the located and the smoothed stepper: slips that end at once, and agreement."""

import json

import numpy as np
import pytest

import vibrojax as vj
from vibrojax.studies.trajectory import feature_lines


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("touching", [False, True])
def test_slip_that_ends_immediately(precision, touching):
    """A spring force exceeds the stick limit and falls below it at once. This takes few steps for any excess."""
    excess, impact = 10.0 ** np.arange(-17, -1, dtype=float), 1000.0 * touching
    k1, k2, x2 = 156250.0, 0.4 * 156250.0 * 0.75**2, impact / 50e6
    x1 = (0.4 * (250.0 * 9.81 + impact) * (1 + excess) + k2 * x2) / (k1 + k2)
    columns = {"start_x1": x1, "start_v1": 0 * x1 - 1.5, "start_x2": 0 * x1 + x2, "start_v2": 0 * x1}
    sweep = {"scene": "vibro-impact", "parameters": {"delta": 0.0 if touching else 1.0}, "unusual": True}
    run = {"settle": 0.0, "observe": 0.004, "precision": precision}
    ds = vj.run_sweep(sweep | {"points": columns, "run": run}, progress=False)
    assert (ds.status == 0).all() and json.loads(ds.attrs["solver"])["steps"] < 40 * len(x1)


# The steppers against each other, over a transient too short for chaos

STUCK = {"start": "stuck"}  # sticks, slips both ways, impacts; settles on a periodic orbit
IRREGULAR = {"k1": 625000.0, "gamma": 1.2, "start": "drive"}  # settles on a chaotic attractor (Fig. 5.77c)
WIDTHS = (1e-2, 1e-3, 1e-4)


def position_motion(point, **how):
    return vj.simulate("vibro-impact", **point, **how, duration=0.8, sampling=1e-3, progress=False)


@pytest.fixture(scope="module")
def located():
    return {"stuck": position_motion(STUCK), "irregular": position_motion(IRREGULAR)}


def position_error(trajectory, reference):
    """Return the largest difference of the positions, relative to the largest position."""
    return max(float(abs(trajectory[x] - reference[x]).max() / abs(reference[x]).max()) for x in ("x1", "x2"))


def bound_of_width(width):
    """Return the order of the smoothing error: w^(4/5) in units of 1 m/s ."""
    return width**0.8


@pytest.mark.parametrize("width", WIDTHS)
def test_smoothed_matches_located(located, width):
    """The error stays below the bound of the width, which shrinks with the width."""
    smoothed = position_motion(STUCK, method="smoothed", smoothing=width, step=0.1 * width)
    assert position_error(smoothed, located["stuck"]) < bound_of_width(width)
    irregular = position_motion(IRREGULAR, method="smoothed", smoothing=width, step=0.1 * width)
    assert position_error(irregular, located["irregular"]) < bound_of_width(width)


def test_smoothed_matches_diffrax():
    """Both solve the same equations, so at equal widths only their step errors differ. These are far smaller."""
    smoothed = position_motion(STUCK, method="smoothed", smoothing=1e-2, step=1e-4)
    adaptive = position_motion(STUCK, solver="Tsit5", smoothing=1e-2, error=1e-6)
    assert position_error(smoothed, adaptive) < 1e-2 * bound_of_width(1e-2)
    assert "regime" not in adaptive and feature_lines(adaptive) == []

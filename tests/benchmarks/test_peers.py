"""Test the peers of the benchmark against the exact reference, and the race's choice of settings."""

import numpy as np
import pytest
from exact import measure, run
from peers._peer import Points, Returns
from peers.diffrax_events import DiffraxEvents
from peers.diffrax_events import Tolerance as EventTolerance
from peers.diffrax_smoothed import DiffraxAdaptive, Width
from peers.heyoka_batch import Batch, Heyoka
from peers.numba_loop import NumbaDormandPrince, NumbaTaylor, Series, Tolerance
from peers.scipy_events import Solver
from peers.scipy_events import lane as scipy_lane
from peers.simd import Simd, Steps

SETTLE, OBSERVE = 1.2, 1.0  # s
pytestmark = pytest.mark.long
POINTS = Points(*np.array([(0.4, 0.7, 1.2, -0.004), (0.25, 0.6, 0.7, 0.0015)]).T)
"""Both lanes impact, stick and slip. The first one starts in contact, the second one starts to slip in contact."""


@pytest.fixture(scope="module")
def known():
    """Return period and impact velocity (2, lanes) of the exact reference."""
    names = ("beta", "gamma", "v", "delta")
    features = []
    for lane in zip(*POINTS.columns, strict=True):
        point = dict(zip(names, map(float, lane), strict=True))
        measured = measure(run("vibro-impact", **point, start="stuck", settle=SETTLE, observe=OBSERVE))
        assert measured["cycles"] in (0, 1) and measured["stick_fraction"] > 0
        features.append((measured["period"], measured["impact_velocity"]))
    return np.array(features).T


@pytest.mark.parametrize(
    ("peer", "setting", "bound"),
    [
        (NumbaTaylor, Series(8, 0.5), 1e-6),
        (NumbaDormandPrince, Tolerance(1e-9), 1e-6),
        (DiffraxEvents, EventTolerance("Tsit5", 1e-8, 0.5), 1e-6),
        (DiffraxAdaptive, Width("Tsit5", 1e-4, 1e-6), 5e-3),
        (Heyoka, Batch(1e-10, 4), 1e-6),
        (Simd, Steps(1e-5, 2.5, 1e-3, 1e-4), 1e-3),
    ],
)
def test_peers_match_exact_reference(known, peer, setting, bound):
    """Without numba, its loops run as plain Python."""
    racer = peer()
    if peer in (Heyoka, Simd) and racer.missing():
        pytest.skip(racer.missing())
    outcome = racer.run(POINTS, setting, SETTLE, OBSERVE, len(POINTS))
    racer.close()
    assert np.abs(np.stack([outcome.period, outcome.impact_velocity]) / known - 1).max() < bound


@pytest.mark.parametrize("solver", [Solver("RK45", 1e-7, 0.5), Solver("DOP853", 1e-6, 0.5), Solver("LSODA", 1e-9, 0.5)])
def test_scipy_matches_exact_reference(known, solver):
    features = [scipy_lane((*lane, solver, SETTLE, OBSERVE)) for lane in zip(*POINTS.columns, strict=True)]
    assert np.abs(np.array(features).T / known - 1).max() < 1e-5


def test_only_whole_returns_count():
    returns = Returns()
    returns.impact(9.0)
    for t, velocity in ((1.0, 2.0), (1.5, 4.0), (2.1, 8.0)):
        returns.section(t)
        returns.impact(velocity)
    period, velocity = returns.read()
    assert period == pytest.approx(1.1 / 2)
    assert velocity == 3.0

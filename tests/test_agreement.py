"""Test the smoothed, located and adaptive steppers against each other, over a transient too short for chaos."""

import diffrax
import numpy as np
import pytest

import vibrojax as vj
from vibrojax.studies.trajectory import feature_lines

STATES = ("x1", "v1", "x2", "v2")
STUCK = {"start": "stuck"}  # sticks, slips both ways, impacts; settles on a periodic orbit
IRREGULAR = {"k1": 625000.0, "gamma": 1.2, "start": "drive"}  # settles on a chaotic attractor (Fig. 5.77c)
WIDTHS = (1e-2, 1e-3, 1e-4)
SOLVERS = ["Tsit5", "Kvaerno5", diffrax.Dopri8()]


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


def test_reference_has_events_of_all_kinds(located):
    kinds = located["stuck"].event_kind.attrs["flag_meanings"].split()
    happened = {kinds[kind] for kind in located["stuck"].event_kind.values}
    assert happened >= {"stick", "slip", "impact", "release", "section"}
    assert (located["irregular"].event_kind == kinds.index("impact")).sum() >= 2


@pytest.mark.parametrize("width", WIDTHS)
def test_smoothed_matches_located(located, width):
    """The error stays below the bound of the width, which shrinks with the width."""
    smoothed = motion(STUCK, method="smoothed", smoothing=width, step=0.1 * width)
    assert position_error(smoothed, located["stuck"]) < bound(width)
    assert mean_state_error(smoothed, located["stuck"]) < bound(width)
    irregular = motion(IRREGULAR, method="smoothed", smoothing=width, step=0.1 * width)
    assert position_error(irregular, located["irregular"]) < bound(width)


@pytest.mark.parametrize("solver", SOLVERS, ids=str)
@pytest.mark.long
def test_diffrax_solvers_match_located(located, solver):
    """At a width of 1e-4 m/s, the difference stays below the bound of the width: 6e-4 of the largest values."""
    adaptive = motion(STUCK, solver=solver, smoothing=1e-4)
    assert position_error(adaptive, located["stuck"]) < bound(1e-4)
    assert mean_state_error(adaptive, located["stuck"]) < bound(1e-4)


def test_smoothed_matches_diffrax():
    """Both solve the same equations, so at equal widths only their step errors differ. These are far smaller."""
    smoothed = motion(STUCK, method="smoothed", smoothing=1e-2, step=1e-4)
    adaptive = motion(STUCK, solver="Tsit5", smoothing=1e-2, error=1e-6)
    assert position_error(smoothed, adaptive) < 1e-2 * bound(1e-2)
    assert "regime" not in adaptive and feature_lines(adaptive) == []


def test_smoothed_forces_match_located(located):
    """Compare the time averages of friction and contact force."""
    smoothed = motion(STUCK, method="smoothed", smoothing=1e-3, step=1e-4)
    for name in ("friction_force", "impact_force"):
        difference = abs(smoothed[name] - located["stuck"][name]).mean()
        assert difference < 0.01 * abs(located["stuck"][name]).max()


def test_samples_do_not_depend_on_sampling(located):
    """Samples are read off the polynomials of the steps, so the sampling does not change the motion."""
    finer = vj.simulate("vibro-impact", **STUCK, duration=0.8, sampling=2.5e-4, progress=False)
    for name in STATES:
        np.testing.assert_array_equal(finer[name][::4], located["stuck"][name])

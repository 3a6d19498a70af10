"""Test the motion of the bit on rock against closed forms of eqs. 6.1 to 6.3."""

import numpy as np
import pytest

import vibrojax as vj

M1, K3, D = 250.0, 300e6, 150e3


def motion(duration, **parameters):
    settings = {"duration": duration, "sampling": 1e-4, "error": 1e-8, "progress": False}
    return vj.simulate("penetration", k3=K3, threshold=D, **settings, **parameters)


@pytest.mark.parametrize("force", [80e3, 149e3])
def test_undamped_slip_under_step(force):
    """Energy gives A (D/k + s) = D²/(2k) + D s where the bit stops, so s = D (2A - D)/(2k (D - A)) for D/2 < A < D.

    Every later cycle returns to the threshold with x3' = 0 and slips no further.
    """
    run = motion(0.2, force=force, zeta=0.0, frequency=1.0, pulse_width=0.9)
    slip = D * (2 * force - D) / (2 * K3 * (D - force))
    assert float(run.x4[-1]) == pytest.approx(slip, rel=1e-10)
    first = int(np.argmax(run.x4.values > slip * (1 - 1e-9)))
    assert run.time[first] < 0.14 and float(run.x4[-1] - run.x4[first]) <= 1e-9 * slip


@pytest.mark.parametrize("zeta", [0.05, 0.6])
def test_onset_of_slip(zeta):
    """A long step overshoots by e^{-pi zeta/sqrt(1 - zeta²)}. Slip starts exactly where A (1 + overshoot) = D."""
    onset = D / (1 + np.exp(-np.pi * zeta / np.sqrt(1 - zeta**2)))
    step = {"zeta": zeta, "frequency": 2.0, "pulse_width": 0.1}
    assert motion(0.1, force=onset * (1 - 1e-9), **step).x4[-1] == 0
    assert motion(0.1, force=onset * (1 + 1e-6), **step).x4[-1] > 0


def test_steady_response_to_sine_of_constant_frequency():
    """For a swept sine of rate 0 about a bias, x3 = B/k3 + Im(A H e^{i omega t}) after the transient."""
    zeta, bias, force, omega = 0.7, 60e3, 50e3, 2 * np.pi * 45.0
    sine = {"pulse_shape": "sweep", "sweep_start": 45.0, "sweep_rate": 0.0, "bias": bias, "force": force}
    late = motion(0.5, zeta=zeta, **sine).sel(time=slice(0.4, None))
    response = force / (K3 - M1 * omega**2 + 1j * omega * 2 * zeta * np.sqrt(M1 * K3))
    expected = bias / K3 + (response * np.exp(1j * omega * late.time.values)).imag
    np.testing.assert_allclose(late.x3, expected, rtol=1e-9)

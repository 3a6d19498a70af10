"""Test the motion of the bit on rock: closed forms of eqs. 6.1 to 6.3, and invariants of every path."""

import numpy as np
import pytest
from rock_motion import YIELDING, Motion
from scipy.optimize import brentq

import vibrojax as vj


@pytest.mark.parametrize("force", [80e3, 100e3, 120e3, 149e3])
def test_undamped_slip_under_step(force):
    """Energy gives A (D/k + s) = D²/(2k) + D s where the bit stops, so s = D (2A - D)/(2k (D - A)) for D/2 < A < D.

    Every later cycle returns to the threshold with x3' = 0 and slips no further.
    """
    motion = Motion(0.2, force=force, zeta=0.0, frequency=1.0, pulse_width=0.9)
    threshold, k3 = motion.p["threshold"], motion.p["k3"]
    slip = threshold * (2 * force - threshold) / (2 * k3 * (threshold - force))
    first = np.flatnonzero((motion.rock == YIELDING) & motion.steps.hits[:, 0])[0]
    np.testing.assert_allclose(motion.x4[first], slip, rtol=1e-11)
    assert motion.times[-1] > motion.times[first] + 0.06
    assert motion.x4[-1] - motion.x4[first] <= 1e-11 * slip  # ten times the tolerance of the steps


@pytest.mark.parametrize("zeta", [0.05, 0.3, 0.6, 0.9])
def test_onset_of_slip(zeta):
    """A long step overshoots by e^{-pi zeta/sqrt(1 - zeta²)}. Slip starts exactly where A (1 + overshoot) = D."""
    onset = 150e3 / (1 + np.exp(-np.pi * zeta / np.sqrt(1 - zeta**2)))
    step = {"zeta": zeta, "frequency": 2.0, "pulse_width": 0.1}
    assert Motion(0.1, force=onset * (1 - 1e-9), **step).x4[-1] == 0
    assert Motion(0.1, force=onset * (1 + 1e-6), **step).x4[-1] > 0


def test_no_slip_below_threshold():
    """100 random pulse trains have A < D/2. A pulse from (near) rest gives k3 x3 <= 2A < D even undamped, so x4 = 0."""
    rng = np.random.default_rng(1)
    points = {
        "force": rng.uniform(0.0, 0.4999, 100) * 150e3,
        "frequency": rng.uniform(5.0, 25.0, 100),
        "pulse_width": rng.uniform(1e-3, 8e-3, 100),
        "k3": 10 ** rng.uniform(7.5, 9.0, 100),
        "zeta": rng.uniform(0.4, 2.0, 100),
    }
    for shape in ("rectangular", "half-sine"):
        sweep = {"scene": "penetration", "parameters": {"pulse_shape": shape}, "points": points}
        dataset = vj.run_sweep(sweep | {"run": {"settle": 0.5, "observe": 0.5}}, progress=False)
        assert np.all(dataset.rate_of_penetration == 0)
        assert np.all(dataset.slip_per_impact == 0)
        assert np.all(dataset.mean_force > 0)


@pytest.fixture(scope="module", params=["rectangular", "half-sine", "light"])
def train(request):
    """Return ten pulses that slip. Lightly damped ones also jump off the rock, and slip again where they land."""
    more = {"zeta": 0.1, "force": 300e3} if request.param == "light" else {"zeta": 0.6}
    shape = "rectangular" if request.param == "light" else request.param
    return Motion(0.5 - 1e-4, shape, **more)


def test_ratchet_is_running_maximum(train):
    """At the end of every step, x4 = max over the past of (x3 - D/k3), 0 at first (6.3). x4 never falls."""
    past = np.maximum.accumulate(np.maximum(train.x3 - train.p["threshold"] / train.p["k3"], 0))
    assert train.x4[-1] > 1e-3
    np.testing.assert_allclose(train.x4, past, rtol=1e-13, atol=1e-17)
    assert np.all(train.growth >= 0)


def test_mean_resistance(train):
    """Over whole pulses of the steady state x3' repeats, so the momentum balance gives mean N = P - c3 ROP."""
    first, last = train.pulses()[[3, -1]]
    whole = slice(first + 1, last + 1)
    time = train.times[last] - train.times[first]
    rate = train.growth[whole].sum() / time
    mean_force = train.p["force"] * train.p["pulse_width"] * train.p["frequency"]
    mean_force *= 2 / np.pi if train.scene.pulse_shape == "half-sine" else 1
    resistance = train.resistance()[whole].sum() / time
    assert abs(resistance - (mean_force - train.p["c3"] * rate)) < 1e-10 * mean_force
    assert train.p["c3"] * rate > 0.02 * mean_force


@pytest.mark.parametrize("frequency", [20.0, 45.0])
def test_steady_response_to_sine_of_constant_frequency(frequency):
    """For a swept sine of rate 0 about a bias, x3 = B/k3 + Im(A H e^{i omega t}) after the transient."""
    sine = {"sweep_start": frequency, "sweep_rate": 0.0, "bias": 60e3, "force": 50e3, "zeta": 0.7}
    motion = Motion(0.5, "sweep", **sine)
    p, times, omega = motion.p, np.linspace(0.4, 0.5, 501), 2 * np.pi * frequency
    response = 50e3 / (p["k3"] - p["m1"] * omega**2 + 1j * omega * p["c3"])
    expected = 60e3 / p["k3"] + (response * np.exp(1j * omega * times)).imag
    np.testing.assert_allclose(motion.at(times)["compression"], expected, rtol=1e-10)


def test_swept_sine_slips_only_near_resonance():
    """Under A sin(2 pi f t) with B = 80 kN, k3 e reaches B + A |H| k3. A slow sweep slips where this exceeds D, in the
    band of f between the two roots, and nowhere else.
    """
    p = {"force": 10e3, "bias": 80e3, "zeta": 0.05, "sweep_start": 100.0, "sweep_rate": 250.0, "k3": 300e6}
    motion = Motion(1.0, "sweep", threshold=150e3, **p)
    natural = np.sqrt(p["k3"] / 250.0) / (2 * np.pi)

    def excess(f):
        r = f / natural
        return p["bias"] + p["force"] / np.hypot(1 - r**2, 2 * p["zeta"] * r) - 150e3

    low, high = brentq(excess, 100.0, natural), brentq(excess, natural, 350.0)
    when = motion.times[motion.growth > 1e-9]
    slipping = p["sweep_start"] + p["sweep_rate"] * when
    assert motion.x4[-1] > 1e-5
    # The step of the bias at t = 0 overshoots to 2B and slips too. It has died out at 115 Hz.
    slipping = slipping[slipping > 115.0]
    assert low - 3 < slipping.min() < low + 6
    assert slipping.max() < high + 6

"""Test the motion of the bit on rock: closed forms of eqs. 6.1 to 6.3, and invariants of every path."""

import numpy as np
import pytest
from rock_motion import ELASTIC, OFF, YIELDING, Motion
from scipy.optimize import brentq

import vibrojax as vj

ELASTIC_ONLY = 1e7
"""A threshold [N] far above all forces in these tests."""


def driven_oscillator(t, p, amplitude, omega):
    """Return x and x' of m x'' + c x' + k x = A sin(omega t) from rest.

    x = Im(A H e^{i omega t}) + a1 e^{r1 t} + a2 e^{r2 t} with H = 1/(k - m omega² + i omega c).
    r1 and r2 are the roots of m r² + c r + k, and x(0) = x'(0) = 0 gives a1 and a2.
    """
    m, c, k = p["m1"], p["c3"], p["k3"]
    response = amplitude / (k - m * omega**2 + 1j * omega * c)
    roots = np.roots([m, c, k]).astype(complex)
    free = np.linalg.solve([[1, 1], roots], [-response.imag, -(1j * omega * response).imag])
    forced = response * np.exp(1j * omega * t)
    decaying = free * np.exp(np.multiply.outer(t, roots))
    return forced.imag + decaying.sum(-1).real, (1j * omega * forced).imag + (decaying @ roots).real


@pytest.mark.parametrize("zeta", [0.0, 0.3, 0.6, 1.1, 1.5])
def test_half_sine_on_elastic_rock(zeta):
    """While in contact, the bit is a damped oscillator under A sin(pi t/w), without slip."""
    motion = Motion(4e-3, "half-sine", threshold=ELASTIC_ONLY, zeta=zeta, frequency=10.0)
    p, times = motion.p, np.linspace(0, 4e-3, 801)
    x, v = driven_oscillator(times, p, p["force"], np.pi / p["pulse_width"])
    contact = np.cumsum(x < -1e-12 * x.max()) == 0
    assert contact.sum() > 600
    states = motion.at(times)
    np.testing.assert_allclose(states["compression"][contact], x[contact], atol=1e-11 * x.max())
    np.testing.assert_allclose(states["v3"][contact], v[contact], atol=1e-11 * v.max())
    assert not motion.growth.any()


def test_bit_leaves_rock_and_flies():
    """While x3 < x4, N = 0. The bit lifts off at x = 0 with x' = v0 < 0, and then x = v0 m/c (1 - e^{-ct/m})."""
    motion = Motion(0.02, "rectangular", zeta=0.3, frequency=10.0, pulse_width=2e-3, threshold=ELASTIC_ONLY)
    p, flight = motion.p, np.flatnonzero(motion.rock == OFF)
    start = flight[0] - 1
    assert motion.after("compression")[start] == 0
    v0, from_start = motion.after("v3")[start], motion.times[flight] - motion.times[start]
    assert v0 < 0
    expected = v0 * p["m1"] / p["c3"] * (1 - np.exp(-p["c3"] * from_start / p["m1"]))
    np.testing.assert_allclose(motion.after("compression")[flight], expected, rtol=1e-11)
    assert np.all(motion.resistance()[flight] == 0)


def test_undamped_response_to_step():
    """x3 = A/k3 (1 - cos wt), w² = k3/m1, over 35 cycles, each of which returns to the surface with x3' = 0."""
    motion = Motion(0.2, threshold=450e3, zeta=0.0, frequency=1.0, pulse_width=0.9)
    p, times = motion.p, np.linspace(0, 0.2, 2001)
    expected = p["force"] / p["k3"] * (1 - np.cos(np.sqrt(p["k3"] / p["m1"]) * times))
    np.testing.assert_allclose(motion.at(times)["compression"], expected, atol=1e-10 * expected.max())
    assert not motion.growth.any()


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


def test_growth_is_integral_of_velocity_over_slips(train):
    """x4' = x3' while the rock yields, else 0, so the growth in each step is the integral of x3' over slips."""
    slips = np.where(train.rock == YIELDING, train.integral("v3"), 0.0)
    np.testing.assert_allclose(train.growth, slips, atol=1e-13 * train.x4[-1])
    assert np.all(train.growth[train.rock != YIELDING] == 0)


def test_compression_never_exceeds_threshold(train):
    """0 <= k3 (x3 - x4) <= D while elastic, = D while yielding, < 0 off the rock. A slip ends with x3' = 0."""
    compression, yields = train.after("compression"), train.p["threshold"] / train.p["k3"]
    assert np.all(compression <= yields)
    elastic, yielding, off = (train.rock == mode for mode in (ELASTIC, YIELDING, OFF))
    assert np.all(compression[elastic] >= 0)
    assert np.all(compression[yielding] == yields)
    assert np.all(compression[off] <= 0)
    ends = yielding & train.steps.hits[:, 0]
    assert ends.sum() >= 10
    assert np.all(train.after("v3")[ends] == 0)


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

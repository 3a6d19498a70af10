"""The drill on the rock: one way nothing of the drill changes; fed back, the blows do, and the energy still adds up."""

import jax.numpy as jnp
import numpy as np
import pytest
from rock_motion import ELASTIC, YIELDING, Motion

import vibrojax as vj
from vibrojax.models.scenes.drilling import CoupledDrilling, Drilling

SWEEP = {
    "grid": {"gamma": [0.6, 0.7, 0.8], "beta": [0.25, 0.4], "v": [1.0, 2.0]},
    "starts": ["stuck"],
    "run": {"settle": 10.0, "observe": 4.0, "error": 1e-5},
}
SANDSTONE = 61.9e3
DRILL = [
    "period",
    "impact_velocity",
    "impact_velocity_min",
    "impact_velocity_max",
    "bit_velocity_at_impact",
    "impact_phase",
    "impact_energy",
    "peak_impact_force",
    "mean_impact_force",
    "stick_fraction",
    "reverse_fraction",
    "bit_amplitude",
    "striker_amplitude",
    "settling_time",
    "drive_power",
]


@pytest.fixture(scope="module")
def sweeps():
    scenes = ("vibro-impact", "drilling", "coupled-drilling")
    return {scene: vj.run_sweep(SWEEP | {"scene": scene}, progress=False) for scene in scenes}


def test_one_way_nothing_of_the_drill_changes(sweeps):
    """The same equations for x1, x2: labels and counts are equal. The steps are not, as they end on the rock's switches
    too, so the rest agrees to 1e-8, their error."""
    free, drilling = sweeps["vibro-impact"], sweeps["drilling"]
    assert np.all(free.cycles > 0)
    for name in ("regime", "cycles", "impacts", "returns", "striker_turns", "status", "reason"):
        if name in free:
            np.testing.assert_array_equal(drilling[name], free[name])
    for name in DRILL:
        scale = 1.0 if name in ("stick_fraction", "reverse_fraction", "impact_phase") else free[name].values
        difference = (drilling[name].values - free[name].values) / scale
        assert np.nanmax(np.abs(difference)) < 1e-8, name
    np.testing.assert_allclose(drilling.phase_lag, free.phase_lag, atol=1e-4)
    assert set(drilling.data_vars) > set(free.data_vars)


@pytest.mark.parametrize("scene", ["drilling", "coupled-drilling"])
def test_readings_fit_together(sweeps, scene):
    """P = mean J, eta = P/D, ROP = s impacts/(cycles period), the growth per second of whole repeats."""
    d = sweeps[scene]
    periodic = (d.cycles > 0).values
    assert periodic.sum() > 8
    np.testing.assert_array_equal(d.mean_force, d.mean_impact_force)
    np.testing.assert_allclose(d.relief, d.mean_impact_force / SANDSTONE, rtol=1e-13)
    rate = (d.slip_per_impact * d.impacts / (d.cycles * d.period)).values
    np.testing.assert_allclose(d.rate_of_penetration.values[periodic], rate[periodic], rtol=1e-12)
    assert np.all(d.rate_of_penetration >= 0)
    assert np.all(d.rate_of_penetration <= d.mean_force / (2 * 1.5 * np.sqrt(250 * 100.68e6)))  # mean N >= 0


def test_no_hole_where_every_blow_stays_below_the_threshold(sweeps):
    """zeta = 1.5 does not overshoot, so N <= max J: no growth where that is under D, and some is drilled elsewhere."""
    drilling = sweeps["drilling"]
    weak = (drilling.peak_impact_force < SANDSTONE).values
    rate = drilling.rate_of_penetration.values
    assert weak.any()
    assert np.all(rate[weak] == 0)
    assert np.all(drilling.slip_per_impact.values[weak] == 0)
    assert (rate > 0).sum() >= 3


def test_fed_back_it_drills_less(sweeps):
    """The rock gives under the contact: blows are softer, and ROP is lower wherever there was any."""
    one_way, coupled = sweeps["drilling"], sweeps["coupled-drilling"]
    bores = (one_way.rate_of_penetration > 0).values
    assert np.all(coupled.rate_of_penetration.values[bores] < 0.7 * one_way.rate_of_penetration.values[bores])
    assert np.all(coupled.peak_impact_force.values[bores] < one_way.peak_impact_force.values[bores])


HARD_BLOWS = {"gamma": 0.6, "beta": 0.4}
STEADY = 1.2


@pytest.fixture(scope="module", params=[Drilling, CoupledDrilling], ids=["one-way", "coupled"])
def drilled(request):
    """1.2 s from `stuck`, four to five blows that go into the rock."""
    motion = Motion(STEADY, scene=request.param(), start="stuck", **HARD_BLOWS)
    assert motion.x4[-1] > 1e-4
    return motion


def test_the_hole_never_fills(drilled):
    """Growth is never negative, is nothing but the integral of x3' while it yields, and x4 = max (x3 - D/k3)."""
    assert np.all(drilled.growth >= 0)
    slips = np.where(drilled.rock == YIELDING, drilled.integral("v3"), 0.0)
    np.testing.assert_allclose(drilled.growth, slips, atol=1e-13 * drilled.x4[-1])
    past = np.maximum.accumulate(np.maximum(drilled.x3 - drilled.p["threshold"] / drilled.p["k3"], 0))
    np.testing.assert_allclose(drilled.x4, past, rtol=1e-12, atol=1e-16)


def powers(motion, stiffly):
    """(momentum of the blows and of the rock [N s], work W by the ledger [J], J x4' [J], energy E) over the run.

    With e = x3 - x4 and the contact's compression c, c' = x2' - (x3' - x4'):
    E = (m1 x1'² + k1 x1² + k2 (x1 - x2)² + m2 x2'² + k0 c² while they touch + m1 x3'² + k3 e² while elastic)/2 and
    dE/dt = -F x1' - c2 x2'² - c0 c'² - c3 x3'² - N x4' + J x4'  (one way, c' = x2' and J x3' for J x4').
    By Gauss' rule of 12 points, exact for the steps' polynomials; F is what the springs do not give to the bit."""
    steps, p, scene = motion.steps, motion.p, motion.scene
    nodes, weights = np.polynomial.legendre.leggauss(12)
    moving = steps.dt > 0
    tau = (steps.dt / steps.h)[moving]
    mode = tuple(jnp.asarray(m) for m in steps.mode[moving].T)
    rock, touching = steps.mode[moving][:, 2], steps.mode[moving][:, 1]
    total = np.zeros(4)
    for node, weight in zip(nodes, weights, strict=True):
        at = (tau * (1 + node) / 2)[:, None]
        y = sum(steps.polynomials[moving][:, :, k] * at**k for k in range(steps.polynomials.shape[2])).T
        states = tuple(jnp.asarray(one) for one in y)
        x1, v1, x2, v2, e, v3, _ = y
        rates = np.asarray(jnp.stack(scene.field(motion.constants, mode, states)))
        blow = np.asarray(scene.contact_force(motion.constants, mode, states))
        sinking = np.where(rock == YIELDING, v3, 0.0)
        pull = -p["k1"] * x1 - p["k2"] * (x1 - x2)
        friction = pull - p["m1"] * rates[1]
        resists = np.where(rock == ELASTIC, p["k3"] * e, np.where(rock == YIELDING, p["threshold"], 0.0))
        closing = v2 - (v3 - sinking) if stiffly else v2
        fed = blow * (sinking if stiffly else v3)
        lost = friction * v1 + p["c2"] * v2**2 + touching * p["c0"] * closing**2 + p["c3"] * v3**2 + resists * sinking
        share = steps.dt[moving] * weight / 2
        total += [
            share @ blow,
            share @ resists + p["c3"] * (share @ v3),
            share @ (fed - lost),
            share @ (blow * sinking),
        ]
        assert np.all(blow * sinking >= -1e-9 * blow.max())  # each blow only pushes, the hole only deepens
    return total


def energy(motion, stiffly):
    """E [J] at the end of the run less E at its start."""
    p = motion.p

    def of(y, mode):
        x1, v1, x2, v2, e, v3, _ = y
        c = (x2 - p["delta"] - (e if stiffly else 0.0)) * mode[1]
        spring = p["k1"] * x1**2 + p["k2"] * (x1 - x2) ** 2 + p["k0"] * c**2 + p["k3"] * e**2 * (mode[2] == ELASTIC)
        return (spring + p["m1"] * (v1**2 + v3**2) + p["m2"] * v2**2) / 2

    first, last = motion.steps.polynomials[0][:, 0], motion.steps.after[-1]
    return of(last, motion.steps.mode[-1]) - of(first, motion.steps.mode[0])


def test_energy_and_momentum(drilled):
    """The ledger closes; integral of J = integral of N + c3 x3(end) + m1 x3'(end), from rest; the feed gives J x4'."""
    stiffly = isinstance(drilled.scene, CoupledDrilling)
    blows, rock, work, fed = powers(drilled, stiffly)
    assert blows > 500
    assert rock + drilled.p["m1"] * drilled.after("v3")[-1] == pytest.approx(blows, rel=1e-10)
    assert work == pytest.approx(energy(drilled, stiffly), abs=1e-8 * drilled.p["m1"])
    assert fed > 0


def test_a_stiff_rock_gives_the_one_way_drill():
    """Fed back, e adds N/k3 to the contact: x1, x2 differ from one way by O(1/k3), so that k3 -> oo is one way."""
    times = np.linspace(0, 0.35, 351)
    free = Motion(0.35, scene=Drilling(), start="stuck", **HARD_BLOWS).at(times)
    apart = []
    for k3 in (1e10, 1e11, 1e12):
        coupled = Motion(0.35, scene=CoupledDrilling(), start="stuck", k3=k3, **HARD_BLOWS).at(times)
        apart.append(max(np.abs(coupled[x] - free[x]).max() / np.ptp(free[x]) for x in ("x1", "x2")))
    assert apart[2] < 1e-4
    np.testing.assert_allclose(np.divide(apart[:-1], apart[1:]), 10, rtol=0.2)

"""Systems of the literature, written with `vj.System`, against closed forms, published values and SciPy."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.optimize import brentq, fsolve
from systems import BELT_OSCILLATOR

import vibrojax as vj

E = vj.elementary
cos, sin = E.cos, E.sin
PRECISE = {"rtol": 1e-12, "atol": 1e-14, "method": "DOP853"}


def sweep(system, grid, start, **run):
    return vj.run_sweep({"scene": system, "grid": grid, "starts": [start], "run": run}, progress=False)


# The simplest walker: Garcia, Chatterjee, Ruina and Coleman, Journal of Biomechanical Engineering 120 (1998), 281.
# The angles of both legs have the opposite sign here, so that the stance leg rises through zero. At midstance the swing
# foot passes the ground downwards, which the model allows; upwards it strikes.


def walking(t, y, p):
    falls, weight = sin(y["stance"] + p["slope"]), cos(y["stance"] + p["slope"])
    swings = falls + (y["rate"] * y["rate"] - weight) * sin(y["swing"])
    return {"stance": y["rate"], "rate": falls, "swing": y["swing_rate"], "swing_rate": swings}


def heel_strike(t, y, p):
    share = cos(2 * y["stance"])
    rate = share * y["rate"]
    return {"stance": -y["stance"], "rate": rate, "swing": -2 * y["stance"], "swing_rate": (1 - share) * rate}


WALKER = vj.System(
    "walker",
    states={"stance": "rad", "rate": "rad s-1", "swing": "rad", "swing_rate": "rad s-1"},
    parameters={"slope": (0.009, "rad")},
    field=walking,
    section="stance",
    events=[vj.Impact("heel", gap=lambda t, y, p: 2 * y["stance"] - y["swing"], direction=1, reset=heel_strike)],
)


def step_by_scipy(after, slope=0.009):
    """Return the angle and rate of the stance leg after the next heel strike, its speed, and the duration of the step.

    `after`: angle and rate of the stance leg after a heel strike. The swing foot may pass the ground before midstance.
    """

    def rates(t, y):
        lean = y[0] + slope
        return [y[1], np.sin(lean), y[3], np.sin(lean) + (y[1] ** 2 - np.cos(lean)) * np.sin(y[2])]

    angle, rate = after
    midstance, strike = lambda t, y: y[0], lambda t, y: 2 * y[0] - y[2]
    midstance.terminal = strike.terminal = strike.direction = 1
    first = [angle, rate, 2 * angle, (1 - np.cos(2 * angle)) * rate]
    part = solve_ivp(rates, (0.0, 9.0), first, events=midstance, **PRECISE)
    part = solve_ivp(rates, (part.t[-1], 9.0), part.y[:, -1], events=strike, **PRECISE)
    stance, rate, _, swing_rate = part.y[:, -1]
    return np.array([-stance, np.cos(2 * stance) * rate]), 2 * rate - swing_rate, part.t[-1]


def long_gait():
    """Return the state after a heel strike in the long one of both gaits."""
    return fsolve(lambda after: step_by_scipy(after)[0] - after, [-0.2003, 0.1998], xtol=1e-12)


@pytest.mark.long
def test_multipliers_of_the_simplest_walker():
    """Both have the modulus 0.589113. The state after a heel strike depends on two values: a third one is zero."""
    gait = long_gait()

    def slopes(h):
        changes = [step_by_scipy(gait + d)[0] - step_by_scipy(gait - d)[0] for d in np.eye(2) * h]
        return np.transpose(changes) / (2 * h)

    modulus = np.sqrt(np.linalg.det((4 * slopes(1e-5) - slopes(2e-5)) / 3))
    assert modulus == pytest.approx(0.589113, abs=1e-6)
    ds = sweep(WALKER, {"slope": [0.009]}, [-0.2, 0.2, -0.4, 0.016], orbits=True)
    assert int(ds.stable[0, 0]) == 1
    _, speed, duration = step_by_scipy(gait)
    assert float(ds.period[0, 0]) == pytest.approx(duration, rel=1e-9)
    assert float(ds.impact_velocity[0, 0]) == pytest.approx(speed, rel=1e-6)
    assert ds.multiplier_abs.values.ravel() == pytest.approx([modulus, modulus, 0.0], abs=1e-7)


# A buck converter with a ramp: Fossas and Olivar, IEEE Transactions on Circuits and Systems I 43 (1996), 13.
# L = 20 mH, C = 47 µF, R = 22 Ohm, gain 8.4, reference 11.3 V, ramp 3.8 to 8.2 V in 400 µs.

RAMP = 400e-6
CIRCUIT = np.array([[-1 / (22.0 * 47e-6), 1 / 47e-6], [-1 / 20e-3, 0.0]])
BUCK = vj.System(
    "buck-from-input",
    states={"v": "V", "i": "A"},
    parameters={"E": (20.0, "V")},
    field=lambda t, y, p, s: {
        "v": (y["i"] - y["v"] / 22.0) / 47e-6,
        "i": (p["E"] * (1 - s["off"]) / 2 - y["v"]) / 20e-3,
    },
    period=RAMP,
    events=[vj.Switch("off", lambda t, y, p: 8.4 * (y["v"] - 11.3) - (3.8 + 4.4 * E.sawtooth(t / RAMP)))],
)


def buck_orbit(supply):
    """Return the state (v, i) at the beginning of the ramp and the multipliers: off until one instant, then on."""
    gained = np.linalg.solve(CIRCUIT, np.array([0.0, supply / 20e-3]))

    def first(at):
        off, on = expm(CIRCUIT * at), expm(CIRCUIT * (RAMP - at))
        return np.linalg.solve(np.eye(2) - on @ off, (on - np.eye(2)) @ gained)

    def excess(at):
        return 8.4 * ((expm(CIRCUIT * at) @ first(at))[0] - 11.3) - (3.8 + 4.4 * at / RAMP)

    at = brentq(excess, 0.1 * RAMP, 0.95 * RAMP, xtol=1e-18, rtol=1e-14)
    off, on = expm(CIRCUIT * at), expm(CIRCUIT * (RAMP - at))
    falls = 8.4 * (CIRCUIT @ off @ first(at))[0] - 4.4 / RAMP
    jump = np.eye(2) + np.outer([0.0, supply / 20e-3], [8.4, 0.0]) / falls
    return first(at), np.linalg.eigvals(on @ jump @ off)


@pytest.mark.long
def test_buck_converter_doubles_its_period():
    """The first period doubling, where an eigenvalue passes -1, lies between 24.4 V and 24.6 V."""
    doubling = brentq(lambda supply: buck_orbit(supply)[1].real.min() + 1, 24.0, 25.0)
    assert 24.4 < doubling < 24.6
    ds = sweep(BUCK, {"E": [24.4, 24.6]}, [12.0, 0.55], settle=0.4, observe=0.04, orbits=True)
    assert ds.cycles.values.ravel().tolist() == [1, 2] and ds.orbit_cycles.values.ravel().tolist() == [1, 2]
    assert (ds.stable == 1).all() and (ds.orbit_reason == 0).all() and (ds.error_estimate < 1e-8).all()
    state, multipliers = buck_orbit(24.4)
    assert [float(ds.orbit_v[0, 0]), float(ds.orbit_i[0, 0])] == pytest.approx(state, abs=1e-9)
    assert ds.multiplier_abs.values[0, 0] == pytest.approx(sorted(abs(multipliers), reverse=True), abs=1e-7)


# A friction oscillator: Stender and Hoffmann, bSTAB, Nonlinear Dynamics (2021). By belt speed: published share of
# starts that end in steady sliding, and number of these starts. The source is the paper's MATLAB program or, for speeds
# that it lacks, the test file of its successor.
SHARES = {1.25: (0.0838, 5000), 1.5: (0.3165, 4000), 1.775: (0.5552, 5000)}
STARTS = {"sample": "sobol", "count": 512, "seed": 1, "box": {"x": [-2.0, 2.0], "v": [0.0, 2.0]}}
RUN = {"settle": 400.0, "observe": 60.0}


def sliding(speeds, count=512):
    """Return the share of starts that end in steady sliding, by speed."""
    tables = {"scene": BELT_OSCILLATOR, "starts": STARTS | {"count": count}, "grid": {"belt": speeds}, "run": RUN}
    return (vj.run_sweep(tables, progress=False).x_amplitude < 0.2).mean("start").values


def test_shares_match_published_values():
    ours = sliding(list(SHARES))
    share, starts = (np.array(column) for column in zip(*SHARES.values(), strict=True))
    error = np.sqrt(share * (1 - share) / starts + ours * (1 - ours) / STARTS["count"])
    deviation = (ours - share) / error
    assert np.abs(deviation).max() < 2 and abs(deviation.mean()) < 1


def test_no_start_slides_on_slow_belt_and_all_slide_on_fast_belt():
    assert sliding([1.0, 1.9], 64).tolist() == [0, 1]

"""Systems of the literature, written with `vj.System`, against closed forms, published values and SciPy."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import fsolve

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


@pytest.mark.long
def test_long_gait_of_the_simplest_walker():
    """Two multipliers have the modulus 0.589113. States after a heel strike depend on two values: the third is zero."""
    gait = fsolve(lambda after: step_by_scipy(after)[0] - after, [-0.2003, 0.1998], xtol=1e-12)
    _, speed, duration = step_by_scipy(gait)

    def slopes(h):
        changes = [step_by_scipy(gait + d)[0] - step_by_scipy(gait - d)[0] for d in np.eye(2) * h]
        return np.transpose(changes) / (2 * h)

    modulus = np.sqrt(np.linalg.det((4 * slopes(1e-5) - slopes(2e-5)) / 3))
    assert duration == pytest.approx(3.882464, abs=1e-6) and modulus == pytest.approx(0.589113, abs=1e-6)
    ds = sweep(WALKER, {"slope": [0.009]}, [-0.2, 0.2, -0.4, 0.016], orbits=True)
    assert int(ds.cycles[0, 0]) == int(ds.impacts[0, 0]) == int(ds.stable[0, 0]) == 1
    assert float(ds.period[0, 0]) == pytest.approx(duration, rel=1e-9)
    assert float(ds.impact_velocity[0, 0]) == pytest.approx(speed, rel=1e-6)
    assert ds.multiplier_abs.values.ravel() == pytest.approx([modulus, modulus, 0.0], abs=1e-7)


# Van der Pol's oscillator

VAN_DER_POL = vj.System(
    "relaxation",
    states={"x": "1", "v": "s-1"},
    parameters={"mu": 1.0},
    field=lambda t, y, p: {"x": y["v"], "v": p["mu"] * (1 - y["x"] ** 2) * y["v"] - y["x"]},
    section="x",
)
AT_ONE = 6.6632868593231301896996820305  # s: the period at mu = 1


def test_periods_and_multiplier_of_van_der_pol():
    """Periods are published for 1 and 5. At 0.1, the series of the frequency has an error of 1e-11."""
    series = 2 * np.pi / (1 - 0.1**2 / 16 + 17 * 0.1**4 / 3072 + 35 * 0.1**6 / 884736)
    ds = sweep(VAN_DER_POL, {"mu": [0.1, 1.0, 5.0]}, [1.0, 0.0], orbits=True)
    right = np.array([series, AT_ONE, 11.612230667])
    difference = np.abs(ds.period.values.ravel() - right)
    assert (difference <= 3 * ds.error_estimate.values.ravel() * right).all()
    np.testing.assert_allclose(ds.period.values.ravel(), right, rtol=1e-9)
    # The multiplier of a planar orbit is the exponential of the integral of the field's divergence.
    rates = lambda t, y: [y[1], (1 - y[0] ** 2) * y[1] - y[0], 1 - y[0] ** 2]  # noqa: E731
    settled = solve_ivp(rates, (0.0, 10 * AT_ONE), [2.0, 0.0, 0.0], **PRECISE).y[:2, -1]
    exponent = solve_ivp(rates, (0.0, AT_ONE), [*settled, 0.0], **PRECISE).y[2, -1]
    assert exponent == pytest.approx(-7.0589, abs=1e-3)
    assert float(ds.multiplier_abs[1, 0, 0]) == pytest.approx(np.exp(exponent), rel=1e-6)

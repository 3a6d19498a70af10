"""Systems of the literature, written with `vj.System`, against closed forms, published values and SciPy."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.optimize import brentq, fsolve
from systems import BELT_OSCILLATOR, events_of

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
def test_long_gait_of_the_simplest_walker():
    _, speed, duration = step_by_scipy(long_gait())
    assert duration == pytest.approx(3.882464, abs=1e-6)
    ds = sweep(WALKER, {"slope": [0.009]}, [-0.2, 0.2, -0.4, 0.016])
    assert int(ds.cycles[0, 0]) == 1 and int(ds.impacts[0, 0]) == 1
    assert float(ds.period[0, 0]) == pytest.approx(duration, rel=1e-7)
    assert float(ds.impact_velocity[0, 0]) == pytest.approx(speed, rel=1e-6)


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
    assert float(ds.period[0, 0]) == pytest.approx(step_by_scipy(gait)[2], rel=1e-9)
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


@pytest.mark.long
def test_place_of_period_doubling_of_buck_converter():
    doubling = brentq(lambda supply: buck_orbit(supply)[1].real.min() + 1, 24.0, 25.0)
    family = vj.follow(
        BUCK, along="E", at=24.4, span=(24.2, 24.8), start=[12.0, 0.55], cycles=1, settle=0.4, progress=False
    )
    kinds = family.special_kind.attrs["flag_meanings"].split()
    places = family.special_value.values[family.special_kind.values == kinds.index("period-doubling")]
    assert places == pytest.approx([doubling], abs=1e-8)


# Two blocks on a belt, coupled by a spring: Galvanetto, Bishop and Briseghella, International Journal of Bifurcation
# and Chaos 5 (1995), 637. The masses and the springs to the ground are 1, the second block rubs 1.3 times as strongly,
# and the friction 1/(1 + 3 |u|) falls with the sliding speed u.

COUPLING, FALL, STRONGER = 1.2, 3.0, 1.3


def extension(y, p):
    return p["coupling"] * (y["x1"] - y["x2"])


FALLING = vj.FrictionLaw(
    name="hyperbolic",
    reference="",
    parameters=vj.parameters.table(vj.parameters.positive("fall", FALL, "s m-1", "fall with the speed", "fall")),
    mu=lambda u, p: 1 / (1 + p["fall"] * u),
)
BLOCKS = vj.System(
    "two-blocks",
    states={"x1": "m", "v1": "m s-1", "x2": "m", "v2": "m s-1"},
    parameters={"belt": (0.3, "m s-1"), "coupling": COUPLING, "stronger": STRONGER},
    field=lambda t, y, p: {
        "x1": y["v1"],
        "v1": -y["x1"] - extension(y, p),
        "x2": y["v2"],
        "v2": -y["x2"] + extension(y, p),
    },
    section="v1",
    events=[
        vj.Friction("first", lambda t, y, p: y["v1"] - p["belt"], lambda t, y, p: 1.0, law=FALLING, acts_on="v1"),
        vj.Friction(
            "second", lambda t, y, p: y["v2"] - p["belt"], lambda t, y, p: p["stronger"], law=FALLING, acts_on="v2"
        ),
    ],
)


def blocks_by_scipy(belt, duration):
    """Return the state at the end and the changes (time, block, slip), from rest; slip is the sign of the sliding."""
    limits, t, y, slips, changes = (1.0, STRONGER), 0.0, np.zeros(4), [-1, -1], []

    def pulls(y):
        spring = COUPLING * (y[0] - y[2])
        return -y[0] - spring, -y[2] + spring

    def rate(y, block):
        slip, v, pull = slips[block], y[2 * block + 1], pulls(y)[block]
        return pull - slip * limits[block] / (1 + FALL * slip * (v - belt)) if slip else 0.0

    def rates(t, y):
        return [y[1], rate(y, 0), y[3], rate(y, 1)]

    def until(block):
        slides, stays = lambda t, y: y[2 * block + 1] - belt, lambda t, y: limits[block] - abs(pulls(y)[block])
        event = slides if slips[block] else stays
        event.terminal, event.direction = True, -slips[block] or -1
        return event

    while t < duration:
        part = solve_ivp(rates, (t, duration), y, events=[until(0), until(1)], **PRECISE)
        t, y = part.t[-1], part.y[:, -1].copy()
        if part.status != 1:
            break
        block = [len(times) > 0 for times in part.t_events].index(True)
        pull = pulls(y)[block]
        if slips[block]:
            y[2 * block + 1] = belt
            slips[block] = 0 if abs(pull) < limits[block] else -slips[block]
        else:
            slips[block] = int(np.sign(pull))
        changes.append((t, block, slips[block]))
    return y, changes


@pytest.mark.long
def test_trajectory_of_two_blocks_on_a_belt():
    """A motion without a short period, through more than 20 sticks of each kind."""
    y, changes = blocks_by_scipy(0.1, 100.0)
    motion = vj.simulate(BLOCKS, start=[0.0] * 4, duration=100.0, belt=0.1, error=1e-9, progress=False)
    assert [float(motion[name][-1]) for name in BLOCKS.start_states] == pytest.approx(y, abs=1e-7)
    sticks, slips = ([t for t, _, slip in changes if (slip != 0) == slides] for slides in (False, True))
    assert min(len(sticks), len(slips)) > 20
    assert events_of(motion, "stick") == pytest.approx(sticks, abs=1e-7)
    assert events_of(motion, "slip") == pytest.approx(slips, abs=1e-7)


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

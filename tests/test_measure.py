"""What is accumulated in the loop, against the same worked out by numpy from finely sampled trajectories."""

import exact
import jax.numpy as jnp
import numpy as np
import pytest

import vibrojax as vj
from vibrojax.measures.motion import _trend

SETTLE, OBSERVE, SAMPLING = 10.0, 4.0, 4e-5
ERROR = 1e-5  # so small that periods of sweep and simulation agree to 1e-9
USUAL = {"m1": 250.0, "beta": 0.4, "gamma": 0.75, "k1": 156250.0, "c2": 250.0, "v": 1.5, "g": 9.81, "mu": 0.4}
CONTACT = {"delta": -0.005, "k0": 50e6, "c0": 1e3}
# The gap first, from stuck: the starts come up as in the other tests, in whose program these lanes then run.
LANES = {
    "gap": ("vibro-impact", USUAL | CONTACT | {"delta": 0.005}, "stuck"),
    "preload": ("vibro-impact", USUAL | CONTACT, "drive"),
    "light": ("vibro-impact", USUAL | CONTACT | {"beta": 0.3, "gamma": 0.5}, "drive"),
    "free": ("rotary", USUAL | {"gamma": 0.5}, "stuck"),
    "in phase": ("rotary", USUAL | {"beta": 0.3, "gamma": 8.0, "v": 0.5, "c2": 75.0}, "drive"),
}
IMPACTING = ["gap", "preload", "light"]

# Reference case 10, which repeats after returns of 15 and 179 ms.
UNEQUAL = {"beta": 0.856, "gamma": 0.719, "v": 1.497, "delta": -0.0009}


@pytest.fixture(scope="module")
def features():
    """Datasets of one lane each, by name."""
    found = {}
    for scene in ("vibro-impact", "rotary"):
        lanes = {name: lane for name, lane in LANES.items() if lane[0] == scene}
        first = next(iter(lanes.values()))[1]
        points = {key: [values[key] for _, values, _ in lanes.values()] for key in first}
        points["start"] = [start for *_, start in lanes.values()]
        run = {"settle": SETTLE, "observe": OBSERVE, "error": ERROR}
        dataset = vj.run_sweep({"scene": scene, "points": points, "run": run}, progress=False)
        found |= {name: dataset.isel(point=index) for index, name in enumerate(lanes)}
    return found


class Sampled:
    """A lane's trajectory, sampled in the observation; integrals by the trapezoidal rule between two sections."""

    def __init__(self, name):
        scene, self.p, start = LANES[name]
        motion = vj.simulate(
            scene, **self.p, start=start, duration=SETTLE + OBSERVE, sampling=SAMPLING, error=ERROR, progress=False
        )
        self.m2 = self.p["beta"] * self.p["m1"]
        self.k2 = self.m2 * self.p["gamma"] ** 2 * self.p["k1"] / self.p["m1"]
        kinds = motion.event_kind.attrs["flag_meanings"].split()
        self.events = {
            kind: motion.event_time.values[motion.event_kind.values == index] for index, kind in enumerate(kinds)
        }
        late = motion.time.values > SETTLE
        self.t = motion.time.values[late]
        for variable in ("x1", "v1", "x2", "v2", "friction_force", "impact_force", "stuck"):
            if variable in motion:
                setattr(self, variable, motion[variable].values[late])
        sections = self.events["section"]
        self.sections = sections[sections > SETTLE]
        self.all_sections = sections
        self.period = np.diff(self.sections).mean()

    def mean(self, values):
        """Mean over whole returns; the ends of the interval lie between samples."""
        total = np.concatenate([[0.0], np.cumsum((values[1:] + values[:-1]) / 2 * SAMPLING)])
        first, last = np.interp(self.sections[[0, -1]], self.t, total)
        return (last - first) / (self.sections[-1] - self.sections[0])

    def at(self, times, values):
        return np.interp(times, self.t, values)

    def impacts(self):
        times = self.events["impact"]
        return times[(times > self.sections[0]) & (times <= self.sections[-1])]


@pytest.fixture(scope="module")
def sampled():
    return {name: Sampled(name) for name in LANES}


def close(found, expected, rtol=2e-4, atol=0.0):
    np.testing.assert_allclose(float(found), expected, rtol=rtol, atol=atol)


@pytest.mark.parametrize("name", LANES)
def test_returns(features, sampled, name):
    lane, motion = features[name], sampled[name]
    assert lane.cycles == 1
    assert lane.returns == len(motion.sections)
    close(lane.period, motion.period, 1e-9)


@pytest.mark.parametrize("name", LANES)
def test_swings(features, sampled, name):
    """Half of greatest less least, and changes of x2' from plus to minus per return."""
    lane, motion = features[name], sampled[name]
    close(lane.bit_amplitude, np.ptp(motion.x1) / 2, 1e-6)
    close(lane.striker_amplitude, np.ptp(motion.x2) / 2, 1e-5)
    inside = (motion.t > motion.sections[0]) & (motion.t < motion.sections[-1])
    v2 = motion.v2[inside]
    turns = np.sum((v2[:-1] > 0) & (v2[1:] <= 0))
    close(lane.striker_turns, turns / (len(motion.sections) - 1), 1e-12)


@pytest.mark.parametrize("name", LANES)
def test_shares(features, sampled, name):
    """Time with u = 0, and with u < 0, u = x1' + v."""
    lane, motion = features[name], sampled[name]
    stuck = motion.stuck.astype(float)
    sections = len(motion.sections)
    # Each begin and end of a share lies within a sample.
    slack = 2 * sections * SAMPLING / OBSERVE
    close(lane.stick_fraction, motion.mean(stuck), 0, slack)
    reverse = ((motion.v1 + motion.p["v"] < 0) & (motion.stuck == 0)).astype(float)
    close(lane.reverse_fraction, motion.mean(reverse), 0, slack)


@pytest.mark.parametrize("name", LANES)
def test_drive_power(features, sampled, name):
    """Mean of F v; and the ledger F v = F u + c2 x2'² + J x2', less the change of energy, none of a repeating lane."""
    lane, motion = features[name], sampled[name]
    u = motion.v1 + motion.p["v"]
    force = getattr(motion, "impact_force", 0 * u)
    close(lane.drive_power, motion.mean(motion.friction_force) * motion.p["v"])
    spent = motion.friction_force * u + motion.p["c2"] * motion.v2**2 + force * motion.v2
    close(lane.drive_power, motion.mean(spent), 1e-3)


@pytest.mark.parametrize("name", LANES)
def test_mean_friction_balances_the_springs(features, sampled, name):
    """Over whole repeats the bit's momentum does not change: mean F = -k1 mean x1 - k2 mean (x1 - x2)."""
    lane, motion = features[name], sampled[name]
    pull = motion.mean(-motion.p["k1"] * motion.x1 - motion.k2 * (motion.x1 - motion.x2))
    close(lane.drive_power, pull * motion.p["v"])


@pytest.mark.parametrize("name", LANES)
def test_phase_lag(features, sampled, name):
    """arg X1 - arg X2 of the Fourier integrals X = mean of x exp(-i 2 pi t/period): positive where the striker lags."""
    lane, motion = features[name], sampled[name]
    wave = np.exp(-2j * np.pi * (motion.t - motion.sections[0]) / motion.period)
    first, second = (motion.mean((x * wave).real) + 1j * motion.mean((x * wave).imag) for x in (motion.x1, motion.x2))
    close(lane.phase_lag, np.angle(first / second), 0, 1e-3)
    assert -np.pi < lane.phase_lag <= np.pi


def phase_lag(point, **run):
    sweep = {"scene": "vibro-impact", "points": {key: [value] for key, value in point.items()}, "starts": ["drive"]}
    return vj.run_sweep(sweep | {"run": run}, progress=False).isel(point=0, start=0)


@pytest.mark.parametrize("observe", [7.0, 8.0])
def test_phase_lag_of_unequal_returns(observe):
    """The harmonic of the mean period, wherever in a repeat the observation begins and ends."""
    lane = phase_lag(UNEQUAL, observe=observe)
    assert lane.cycles == 2
    motion = vj.simulate("vibro-impact", **UNEQUAL, start="drive", duration=48.0, sampling=4e-4, progress=False)
    times = motion.event_time.values[motion.event_kind == motion.event_kind.flag_meanings.split().index("section")]
    ends = times[-21], times[-1]
    assert np.ptp(np.diff(times[-5:])) > 0.02
    t = np.linspace(*ends, 40001)
    wave = np.exp(-2j * np.pi * 20 * (t - ends[0]) / (ends[1] - ends[0]))
    first, second = (np.mean((np.interp(t, motion.time, x) * wave)[1:]) for x in (motion.x1, motion.x2))
    close(lane.phase_lag, np.angle(first / second), 0, 1e-3)


def test_impact_phase_of_unequal_returns():
    """Each impact counts by its own return, whose duration differs from the mean."""
    lane = phase_lag(UNEQUAL, error=ERROR)
    assert lane.cycles == 2
    exact_lane = exact.measure(exact.run("vibro-impact", **UNEQUAL, start="drive", settle=40.0, observe=8.0))
    close(lane.impact_phase, exact_lane["impact_phase"], 1e-6)


def test_phase_lag_observed_from_the_start():
    """The first return, before which the period is not known, is left out."""
    settled = phase_lag(USUAL | CONTACT).phase_lag
    close(phase_lag(USUAL | CONTACT, settle=0.0).phase_lag, settled, 0, 0.02)


def test_phase_lag_of_known_cases(features):
    """A striker tuned far below the bit's frequency moves against it (gamma 0.5), one tuned far above with it (8)."""
    assert abs(features["free"].phase_lag) > 2.9
    assert abs(features["in phase"].phase_lag) < 0.01


@pytest.mark.parametrize("name", IMPACTING)
def test_impacts(features, sampled, name):
    lane, motion = features[name], sampled[name]
    times = motion.impacts()
    sections = motion.sections
    assert lane.impacts == round(len(times) / (len(sections) - 1))
    velocity = motion.at(times, motion.v2)
    close(lane.impact_velocity, velocity.mean(), 1e-3)
    close(lane.impact_velocity_min, velocity.min(), 1e-3)
    close(lane.impact_velocity_max, velocity.max(), 1e-3)
    close(lane.impact_energy, motion.m2 / 2 * np.mean(velocity**2), 2e-3)
    close(lane.bit_velocity_at_impact, np.mean(motion.at(times, motion.v1)) + motion.p["v"], 1e-3)
    since = times - sections[np.searchsorted(sections, times) - 1]
    close(lane.impact_phase, 2 * np.pi * since.mean() / motion.period, 1e-6)


@pytest.mark.parametrize("name", IMPACTING)
def test_impact_force(features, sampled, name):
    """Greatest J in the observation, and mean J, which balances the spring on the striker: k2 mean (x1 - x2)."""
    lane, motion = features[name], sampled[name]
    close(lane.peak_impact_force, motion.impact_force.max(), 1e-4)
    close(lane.mean_impact_force, motion.mean(motion.impact_force))
    close(lane.mean_impact_force, motion.k2 * motion.mean(motion.x1 - motion.x2))


@pytest.mark.parametrize("name", ["gap", "free"])
def test_settling_time(features, sampled, name):
    """The last return whose s differs by over 0.01 from the next one's, s scaled by the swings between the two."""
    lane = features[name]
    scene, values, start = LANES[name]
    motion = vj.simulate(
        scene, **values, start=start, duration=SETTLE + OBSERVE, sampling=1e-4, error=ERROR, progress=False
    )
    sections = sampled[name].all_sections
    t = motion.time.values
    x1, x2, v2 = (np.interp(sections, t, motion[y].values) for y in ("x1", "x2", "v2"))
    last = 0.0
    for k in range(len(sections) - 1):
        between = (t >= sections[k]) & (t <= sections[k + 1])
        bit, striker = (np.ptp(motion[y].values[between]) / 2 for y in ("x1", "x2"))
        speed = striker * 2 * np.pi / (sections[k + 1] - sections[k])
        change = [(x1[k + 1] - x1[k]) / bit, (x2[k + 1] - x2[k]) / striker, (v2[k + 1] - v2[k]) / speed]
        if np.max(np.abs(change)) > 0.01:
            last = sections[k]
    assert 0 < last < SETTLE
    close(lane.settling_time, last, 1e-9)


def test_whole_repeats():
    """A lane that repeats after four returns (k1 = 625000, gamma 1.1): its means are over a multiple of four."""
    points = {"gamma": [1.1, 1.1], "beta": [0.4, 0.4], "k1": [625000.0, 625000.0], "start": ["stuck", "drive"]}
    lane = vj.run_sweep({"scene": "vibro-impact", "points": points}, progress=False).isel(point=1)
    assert lane.cycles == 4
    assert lane.impacts == 6
    motion = vj.simulate("vibro-impact", beta=0.4, gamma=1.1, k1=625000.0, duration=48.0, sampling=0.1, progress=False)
    kinds = motion.event_kind.attrs["flag_meanings"].split()
    times = {kind: motion.event_time.values[motion.event_kind.values == kinds.index(kind)] for kind in kinds}
    sections = times["section"][times["section"] > 40.0]
    whole = (len(sections) - 1) // 4 * 4
    assert whole < len(sections) - 1  # or there is nothing to see
    close(lane.period, (sections[whole] - sections[0]) / whole, 1e-8)


@pytest.mark.parametrize(
    ("greatest", "trend"),
    [
        ([1, 2, 3, 4, 5, 6, 7, 8], 1),
        ([8, 7, 6, 5, 4, 3, 2, 1], -1),
        ([1, 2, 3, 4, 4, 6, 7, 8], 0),  # not strictly
        ([1, 2, 3, 4, 3, 6, 7, 8], 0),
        ([100, 100.1, 100.2, 100.3, 100.4, 100.5, 100.6, 100.7], 0),  # by less than 1 %
        ([100, 100.1, 100.2, 100.3, 100.4, 100.5, 100.6, 101.1], 1),
        ([1, 2, 3, np.nan, 5, 6, 7, 8], 0),  # an eighth without a return
    ],
)
def test_trend_of_the_eighths(greatest, trend):
    assert _trend(jnp.array(greatest, float)[:, None])[0] == trend

"""Test the classification, shares and numbers of the attractors of a sweep, irregular ones included."""

import numpy as np
import pytest
import xarray as xr
from systems import BELT_OSCILLATOR, IMPACT_OSCILLATOR, WALLS

import vibrojax as vj
from vibrojax.io.variables import NATURES
from vibrojax.measures.labels import FAILED, IRREGULAR, SINGLE_IMPACT, SUBHARMONIC
from vibrojax.studies.analysis import analysis_of
from vibrojax.studies.attractor_groups import CONVERGED_STDERR, classify_motions, statistics

BOX = {"x1": [-0.02, 0.02], "v1": [-2.0, 1.0], "x2": [-0.05, 0.05], "v2": [-3.0, 3.0]}
GAMMA = [0.35, 0.3625, 0.7375, 0.75, 0.7625]
SWEEP = {
    "scene": "vibro-impact",
    "parameters": {"delta": 0.005},
    "starts": {"sample": "sobol", "count": 64, "seed": 1, "box": BOX},
    "grid": {"beta": [0.395, 0.4], "gamma": GAMMA},
    "run": {"orbits": True},
}
SCENE = vj.read_sweep(SWEEP).system
REGIMES_AT = {"beta": 0.4, "gamma": 0.75}


@pytest.fixture(scope="module")
def sweep():
    return vj.run_sweep(SWEEP, progress=False)


@pytest.fixture(scope="module")
def attractors(sweep):
    return vj.attractors(sweep, progress=False)


def present(attractors, **point):
    """Return the attractors present at a point, by decreasing share."""
    local = attractors.sel(point)
    share = local.share.values
    return local.isel(attractor=np.argsort(-share, kind="stable")[: int((share > 0).sum())])


def test_shares_count_every_start(attractors):
    starts = attractors.sizes["start"]
    np.testing.assert_allclose(attractors.share.sum("attractor") + attractors.unassigned / starts, 1.0, atol=1e-12)
    np.testing.assert_array_equal((attractors.lane_attractor == -1).sum("start"), attractors.unassigned)
    share = attractors.share
    for number in attractors.attractor.values:
        np.testing.assert_allclose((attractors.lane_attractor == number).mean("start"), share.sel(attractor=number))
    np.testing.assert_allclose(attractors.share_stderr**2, share * (1 - share) / starts, atol=1e-15)
    assert (np.diff(attractors.share.sum(("beta", "gamma")).values) <= 0).all()
    lines = analysis_of(attractors).summary(attractors)[0].lines
    assert any(f"{int(attractors.unassigned.sum())} of 640 lanes unassigned" in line for line in lines)


def test_strong_single_impact_and_rattle_are_separated(sweep, attractors):
    """The impact velocity separates them: one strikes above 2 m/s, the other below 0.5 m/s."""
    for gamma in GAMMA[2:]:
        here, lanes = present(attractors, beta=0.4, gamma=gamma), sweep.sel(beta=0.4, gamma=gamma)
        assert here.regime.values.tolist() == [SINGLE_IMPACT, IRREGULAR] and here.cycles.values.tolist() == [1, 0]
        strong = lanes.impact_velocity.values > 1.0
        assigned = attractors.lane_attractor.sel(beta=0.4, gamma=gamma) == here.attractor[0]
        np.testing.assert_array_equal(assigned, strong)
        assert here.share.values[0] == strong.mean() and 0.8 < strong.mean() < 1
        velocity = here.impact_velocity.values
        assert velocity[0] > 2.0 and velocity[1] < 0.5
        assert velocity[0] == pytest.approx(float(lanes.impact_velocity.values[strong][0]), rel=1e-9)


def test_numbers_continue_along_axes(attractors):
    places = [{"beta": beta, "gamma": gamma} for beta in attractors.beta.values for gamma in GAMMA[2:]]
    [numbers] = {tuple(present(attractors, **place).attractor.values.tolist()) for place in places}
    # No attractor below the wide gap in the axis continues above it.
    below = set(np.flatnonzero((attractors.share.sel(gamma=GAMMA[:2]) > 0).any(("beta", "gamma"))))
    assert not below & set(numbers)
    before, after = present(attractors, beta=0.4, gamma=0.35), present(attractors, beta=0.4, gamma=0.3625)
    assert (int(before.cycles[0]), int(after.cycles[0])) == (2, 4)
    assert before.regime.values[0] == after.regime.values[0] == SUBHARMONIC
    assert int(before.attractor[0]) == int(after.attractor[0])


def test_orbit_keeps_its_number_where_an_impact_passes_the_section():
    """Between these amplitudes the state at the section jumps, as the orbit's only impact passes it."""
    sweep = {"scene": IMPACT_OSCILLATOR, "starts": [[0.0, 0.0]], "grid": {"a": [0.8, 0.88]}}
    result = vj.attractors(sweep, progress=False)
    assert result.sizes["attractor"] == 1 and (np.diff(np.sign(result.orbit_v.values[:, 0])) == -2).all()


@pytest.mark.parametrize("d", [[0.33, 0.34003], [0.34003, 0.33]])
def test_twins_next_to_a_pitchfork_have_numbers_of_their_own(d):
    """The motion from rest ends on one twin at 0.33, and on the other one at 0.34003, where the two nearly meet. The
    other two starts end on the same twin at both. Up to the pitchfork twins do not meet, so on the section the order of
    their velocities does not change."""
    starts = [[0.0, 0.0], [0.1, 0.3], [-0.1, -0.3]]
    sweeps = [{"scene": WALLS, "starts": starts[:k], "grid": {"d": d}} for k in (1, 3)]
    alone, all_starts = (vj.attractors(sweep, progress=False).sortby("d") for sweep in sweeps)
    assert sorted(alone.lane_attractor.values.ravel()) == [0, 1]
    of_rest, one, other = all_starts.lane_attractor.values.T
    assert np.ptp(one) == np.ptp(other) == 0 and of_rest.tolist() == [other[0], one[0]]
    assert all(all_starts.orbit_v.sel(attractor=one[0]) > all_starts.orbit_v.sel(attractor=other[0]))


def test_named_starts_are_assigned_to_attractors(sweep, attractors):
    """Named starts reach the same regimes as in a sweep of their own. They do not contribute to the shares."""
    own = vj.run_sweep(SWEEP | {"starts": ["drive", "stuck"]}, progress=False)
    assert attractors.named_start.values.tolist() == ["drive", "stuck"]
    np.testing.assert_array_equal(attractors.named_regime, own.regime)
    for gamma in GAMMA[2:]:
        here = present(attractors, beta=0.4, gamma=gamma)
        strong = (own.impact_velocity.sel(beta=0.4, gamma=gamma) > 1.0).values
        assigned = attractors.named_attractor.sel(beta=0.4, gamma=gamma).values
        assert assigned.tolist() == here.attractor.values[np.where(strong, 0, 1)].tolist()
    listed = vj.attractors(own, progress=False)
    assert "named_attractor" not in listed


def test_lane_without_stable_orbit_is_unassigned(sweep, attractors):
    lanes = {"beta": 1, "gamma": 3, "start": np.flatnonzero(sweep.regime.sel(REGIMES_AT) == SINGLE_IMPACT)[:3]}
    changed = sweep.copy(deep=True)
    changed.stable[lanes] = 0
    changed.regime[lanes | {"gamma": 2}] = FAILED
    other = vj.attractors(changed, progress=False)
    assert other.unassigned.sel(REGIMES_AT) == attractors.unassigned.sel(REGIMES_AT) + 3
    assert (other.lane_attractor[lanes] == -1).all() and (other.lane_attractor[lanes | {"gamma": 2}] == -1).all()
    assert (other.lane_attractor.values != attractors.lane_attractor.values).sum() == 6


def irregular(**lanes):
    """Return a dataset of irregular lanes at one point."""
    count = len(next(iter(lanes.values())))
    fixed = {"regime": np.full(count, IRREGULAR), "stable": np.full(count, -1), "orbit_cycles": np.zeros(count)}
    orbits = {f"orbit_{name}": np.full(count, np.nan) for name in ("x1", "x2", "v2")}
    base = {"period": np.full(count, 0.2), "bit_amplitude": np.ones(count), "striker_amplitude": np.ones(count)}
    return xr.Dataset({name: ("start", np.array(x)) for name, x in (fixed | orbits | base | lanes).items()})


def groups(dataset, starts=None):
    """Return the motion of each lane, numbered in the order of the lanes."""
    motions = classify_motions(SCENE, dataset, {}, starts or dataset.sizes["start"])
    lanes = sorted(motion.lanes.tolist() for motion in motions)
    of_lane = {lane: number for number, own in enumerate(lanes) for lane in own}
    return [of_lane.get(lane, -1) for lane in range(dataset.sizes["start"])]


def test_irregular_lanes_are_grouped():
    """A chain of lanes, each within a quarter of the next, is one motion. Lanes without impacts are another one. Few
    lanes near many are unassigned: they may be the tail of the larger group's scatter."""
    assert groups(irregular(impact_velocity=[1.0, 1.4, 1.2, 2.0, np.nan, 2.2, 2.1])) == [0, 0, 0, 1, 2, 1, 1]
    assert groups(irregular(impact_velocity=[1.0, 1.1, 1.2, 2.0, 5.0])) == [0, 0, 0, -1, 1]
    # Known exponents replace the statistics, which may include a transient.
    names = ["chaotic", "chaotic", "chaotic", "quasi-periodic", "not-settled", "chaotic"]
    lanes = {"nature": [NATURES.index(name) for name in names], "lyapunov": [1.0, 1.02, 2.0, 0.0, -0.1, 1.01]}
    lanes |= {"lyapunov_stderr": [0.01] * 6, "impact_velocity": [1.0, 3.0, 1.0, 1.0, 1.0, 9.0]}
    assert groups(irregular(**lanes)) == [0, 0, 1, 2, -1, 0]


def test_unsuitable_sweep_is_refused():
    for change, message in (
        ({"scene": "penetration", "starts": None, "parameters": {}, "grid": {"k3": [5e7, 6e7]}}, "with a drill"),
        ({"starts": ["drive"], "grid": {"gamma": [0.7, 0.75]}, "run": {"carry": "gamma"}}, "leave carry out"),
    ):
        tables = {name: x for name, x in (SWEEP | change).items() if x is not None}
        with pytest.raises(vj.InputError, match=message):
            vj.attractors(tables, progress=False)


# Irregular attractors: lanes are observed until their statistics converge, then grouped by them
def test_bursting_motion_is_one_attractor():
    """The irregular motion at this point often rests without impacts for longer than an observation."""
    starts = {"sample": "sobol", "count": 32, "seed": 3, "box": BOX}
    run = {"settle": 200.0, "observe": 8.0, "orbits": True}
    sweep = SWEEP | {"starts": starts, "grid": {"beta": [0.25], "gamma": [0.74]}, "run": run}
    bursting = vj.run_sweep(sweep, progress=False)
    lanes = np.flatnonzero(bursting.regime.values.ravel() == IRREGULAR)
    assert lanes.tolist() == [26, 28]
    observed = bursting.period.values.ravel()[lanes]
    assert observed[0] > 2 * observed[1] and np.isnan(bursting.impact_velocity.values.ravel()[28])
    attractors = vj.attractors(bursting, progress=False)
    share, regime = attractors.share.values.ravel(), attractors.regime.values.ravel()
    assert share[(share > 0) & (regime == IRREGULAR)].tolist() == [2 / 32] and attractors.unassigned.sum() == 0
    number = int(attractors.lane_attractor.values.ravel()[26])
    assert attractors.period.values.ravel()[number] == pytest.approx(0.270, rel=0.1)  # over 2,048 s of either lane


# Synthetic windows
def windows_of(total, count=None, cycles=0.0):
    """Return windows of one statistic from its totals (windows, lanes) and counts."""
    count = np.ones_like(total) if count is None else count
    return np.stack([total, count, np.full_like(total, cycles), np.ones_like(total)], axis=1)


def test_standard_errors_of_windows():
    rng = np.random.default_rng(0)
    count = rng.integers(20, 60, (16, 4000)).astype(float)
    result = statistics(windows_of(0.2 * count * (1 + 0.1 * rng.standard_normal(count.shape)), count))
    scatter = np.std(result.values[0] / 0.2)
    assert np.sqrt(np.mean(result.errors[0] ** 2)) == pytest.approx(scatter, rel=0.05)
    assert result.converged.mean() > 0.99
    time = np.arange(128.0)[:, None]
    drifting, switching = 1 + time / 128, np.where(time < 64, 1.0, 2.0)
    result = statistics(windows_of(np.hstack([drifting, switching, np.ones_like(time)])))
    assert result.converged.tolist() == [False, False, True]
    assert (result.errors[0, :2] > CONVERGED_STDERR).all()


# A friction oscillator: Stender and Hoffmann, bSTAB, Nonlinear Dynamics (2021). By belt speed: published share of
# starts that end in steady sliding, and number of these starts. The source is the paper's MATLAB program or, for speeds
# that it lacks, the test file of its successor.
SHARES = {1.25: (0.0838, 5000), 1.5: (0.3165, 4000), 1.775: (0.5552, 5000)}
BELT_STARTS = {"sample": "sobol", "count": 512, "seed": 1, "box": {"x": [-2.0, 2.0], "v": [0.0, 2.0]}}


def sliding(speeds, count=512):
    """Return the share of starts that end in steady sliding, by speed."""
    tables = {"scene": BELT_OSCILLATOR, "starts": BELT_STARTS | {"count": count}, "grid": {"belt": speeds}}
    tables |= {"run": {"settle": 400.0, "observe": 60.0}}
    return (vj.run_sweep(tables, progress=False).x_amplitude < 0.2).mean("start").values


def test_shares_match_published_values():
    ours = sliding(list(SHARES))
    share, starts = (np.array(column) for column in zip(*SHARES.values(), strict=True))
    error = np.sqrt(share * (1 - share) / starts + ours * (1 - ours) / BELT_STARTS["count"])
    deviation = (ours - share) / error
    assert np.abs(deviation).max() < 2 and abs(deviation.mean()) < 1
    assert sliding([1.0, 1.9], 64).tolist() == [0, 1]

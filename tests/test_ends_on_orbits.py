"""Lanes within the linear reach of a stable orbit end there: labels as if run in full, values those of the orbit."""

import numpy as np
import pytest

import vibrojax as vj
from vibrojax.periodic import early_stopping as ends
from vibrojax.periodic.approach import Approach, extrapolate, will_reach
from vibrojax.periodic.newton import PeriodicOrbits
from vibrojax.sweep.input.read import read_sweep

LANES = 384
WIDE = {"beta": (0.1, 1.2), "gamma": (0.3, 1.2), "v": (0.3, 3.0), "delta": (-0.006, 0.012)}
"""The vibro-impact scene's wide box. On 4,096 lanes of it, and of two boxes within, of 6,749 lanes that repeat all have
the label of the full run, 5,829 of which end on orbits; in float32 of 6,758 lanes all, 5,789 of which do."""


@pytest.fixture(autouse=True)
def however_few(monkeypatch):
    """Also where to compile the return map takes longer than it spares."""
    monkeypatch.setattr(ends, "EARLY_END_MIN_SECONDS", 0.0)


def sweep(scene="vibro-impact", lanes=LANES, **run):
    rng = np.random.default_rng(7)
    points = {name: rng.uniform(*ends, lanes).tolist() for name, ends in WIDE.items()}
    if scene == "rotary":
        del points["delta"]
    points["start"] = [("stuck", "drive")[lane % 2] for lane in range(lanes)]
    return {"scene": scene, "points": points, "run": {"settle": 32.0} | run}


@pytest.fixture
def ended(monkeypatch):
    """Counts the lanes that end on orbits."""
    counts, look = [], ends.EarlyEnds.__call__

    def counted(self, batch):
        found = look(self, batch)
        counts.extend(len(one.lanes) for one in found)
        return found

    monkeypatch.setattr(ends.EarlyEnds, "__call__", counted)
    return counts


@pytest.mark.parametrize(
    "scene, precision, lanes, share",
    [
        ("vibro-impact", "float64", LANES, 0.6),
        ("vibro-impact", "float32", LANES, 0.6),
        ("rotary", "float64", 128, 0.7),
        ("coupled-drilling", "float64", 128, 0.5),
    ],
)
def test_labels_and_values_of_the_full_run(ended, scene, precision, lanes, share):
    """Every label, count and settling time; values within the accepted error. Most lanes that repeat end on orbits."""
    asked = sweep(scene, lanes, precision=precision)
    early_, full = (
        vj.run_sweep(asked | {"run": asked["run"] | {"end_early": one}}, progress=False) for one in (True, False)
    )
    repeats = (full.cycles > 0).values
    assert share * repeats.sum() < sum(ended) <= repeats.sum()
    assert early_.dtypes == full.dtypes
    np.testing.assert_array_equal(early_.regime, full.regime)
    for name in {"cycles", "impacts", "check_regime"} & set(full):
        np.testing.assert_array_equal(early_[name].values[repeats], full[name].values[repeats], err_msg=name)
    for name in {"period", "impact_velocity", "bit_amplitude", "settling_time"} & set(full):
        np.testing.assert_allclose(early_[name].values[repeats], full[name].values[repeats], rtol=1e-4, err_msg=name)


def test_the_same_bits_by_any_chunks():
    """A lane's orbit does not depend on the lanes beside it."""
    whole, parts = (vj.run_sweep(sweep(lanes=96, chunk=chunk), progress=False) for chunk in (96, 40))
    for name in whole.data_vars:
        np.testing.assert_array_equal(whole[name], parts[name], err_msg=name)


def test_not_where_it_is_not_worth_its_while(monkeypatch):
    monkeypatch.undo()
    assert ends.EARLY_END_MIN_SECONDS == 5e6
    few, many = read_sweep(sweep(lanes=8)), sweep(lanes=8, settle=1e6)
    assert ends.early_stopping_of(few) is None
    assert ends.early_stopping_of(read_sweep(many)) is not None
    pulses = {"scene": "penetration", "grid": {"frequency": [40.0, 50.0]}, "run": {"settle": 1e7}}
    assert ends.early_stopping_of(read_sweep(pulses)) is None


BASIS = np.array([[1.0, 0.2, -0.4], [0.3, 1.0, 0.5], [-0.2, 0.1, 1.0]])


def lane(multipliers, away, repeats=100, bend=0.0, error=1e-4):
    """Whether a lane is taken to end on the orbit at zero, its last returns by a map with such `multipliers`, which
    `bend` of a distance's square is no linear one."""
    derivative = BASIS @ np.diag(multipliers) @ np.linalg.inv(BASIS)
    returns = [away * np.array([0.4, -1.0, 0.7])]
    for _ in range(7):
        returns.append(derivative @ returns[-1] + bend * returns[-1] ** 2)
    near = Approach(np.arange(1), np.ones((1, 3)), np.stack(returns[::-1])[..., None], np.zeros((1, 1, 3)))
    one = np.ones(1)
    orbit = PeriodicOrbits(
        scales=np.ones((1, 3)),
        states=np.zeros((1, 1, 3)),
        times=np.ones((1, 1)),
        residual=0 * one,
        product=derivative[None],
        step=np.zeros((1, 1, 3)),
        moved=0 * one,
        impacts=one,
        margin=one,
        reach=one,
        steps=one,
    )
    return will_reach(near, orbit, np.array([float(repeats)]), 1e-7, error)[0]


@pytest.mark.parametrize(
    "multipliers, away, more, ends",
    [
        ((0.8, 0.3, 0.05), 1e-2, {}, True),
        ((-0.8, 0.3, 0.05), 2.2e-2, {}, False),  # turns over: its returns still differ by over 1 %
        ((-0.8, 0.3, 0.05), 3e-3, {}, True),
        ((0.8, 0.3, 0.05), 1e-1, {}, False),  # too far away
        ((0.8, 0.3, 0.05), 1e-2, {"repeats": 8}, False),  # observed before it is there
        ((0.99, 0.3, 0.05), 1e-3, {}, False),  # slow
        ((1.0, 0.3, 0.05), 1e-6, {}, False),  # neutral
        ((1.01, 0.3, 0.05), 1e-9, {}, False),  # leaves, if by next to nothing yet
        ((0.8, 0.3, 0.05), 5e-3, {"bend": 200.0}, False),  # does not follow the derivative
    ],
)
def test_which_lanes_are_where_they_will_be(multipliers, away, more, ends):
    assert lane(multipliers, away, **more) == ends


def test_extrapolation_of_a_linear_map():
    """Three multipliers and four differences: the fixed point itself."""
    derivative = BASIS @ np.diag([0.9, -0.5, 0.2]) @ np.linalg.inv(BASIS)
    fixed, state = np.array([0.5, -0.3, 0.8]), np.array([0.501, -0.299, 0.8])
    series = [state]
    for _ in range(7):
        series.append(fixed + derivative @ (series[-1] - fixed))
    found = extrapolate(np.stack(series[::-1])[..., None], np.ones((3, 1)), 1e-12)[:, 0]
    np.testing.assert_allclose(found, fixed, atol=1e-9)


def test_where_a_long_transient_leads():
    """Lanes that do not repeat after 40 s, and the stable orbits near them: on those they are after 300 s."""
    rng = np.random.default_rng(14)
    box = {"beta": rng.uniform(0.1, 1.2, 256).tolist(), "gamma": rng.uniform(0.3, 1.2, 256).tolist()}
    soon, late = (
        vj.run_sweep({"scene": "vibro-impact", "points": box | {"start": ["stuck"] * 256}, "run": run}, progress=False)
        for run in ({"orbits": True}, {"settle": 300.0})
    )
    near = (soon.nearby_cycles > 0).values
    assert near.sum() >= 5
    assert not near[(soon.regime.isin([2, 3, 4, 5])).values].any()
    there = (soon.nearby_cycles == late.cycles).values & (soon.nearby_impacts == late.impacts).values
    assert there[near].mean() >= 0.9
    assert (soon.nearby_distance.values[near] < 0.5).all()
    assert np.isnan(soon.nearby_distance.values[~near]).all()

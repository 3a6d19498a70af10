"""Many starts of a point share its orbits: one is found of a lane, others are decided within its reach."""

import numpy as np
import pytest

import vibrojax as vj
from vibrojax.analyses.sweep.workers.work import Work
from vibrojax.periodic import early_stopping as ends
from vibrojax.periodic.early_stopping import candidates, rank_in_point
from vibrojax.sweep.input.read import read_sweep

BOX = {"x1": [-0.05, 0.05], "v1": [-2.0, 2.0], "x2": [-0.05, 0.05], "v2": [-3.0, 3.0]}
GRID = {"beta": [0.3, 0.4], "gamma": [0.35, 0.75]}
"""Single impacts, orbits of two returns, rattles and irregular motion. Over 35 points of beta 0.2 to 0.9 and gamma 0.35
to 1.0, 128 starts each, all of 3,495 lanes that repeat have the label of the full run, and its values to 5e-12."""


def sweep(starts=96, **run):
    drawn = {"sample": "sobol", "count": starts, "seed": 5, "box": BOX}
    return {"scene": "vibro-impact", "parameters": {"delta": 0.005}, "starts": drawn, "grid": GRID, "run": run}


@pytest.fixture
def alone(monkeypatch):
    """How many lanes Newton's method is taken for, each time; and the returns of a repeat of all that end on orbits."""
    tried, ended = [], []
    on_orbits, end = ends.EarlyEnds.on_orbits, ends.EarlyEnds._ended

    def counted(self, near, batch):
        tried.append(len(near.lanes))
        return on_orbits(self, near, batch)

    def counted_ends(self, features, batch):
        ended.extend(features["cycles"].astype(int).tolist())
        return end(self, features, batch)

    monkeypatch.setattr(ends.EarlyEnds, "on_orbits", counted)
    monkeypatch.setattr(ends.EarlyEnds, "_ended", counted_ends)
    return tried, ended


def test_labels_and_values_of_the_full_run(alone):
    """Nearly every label (all here), and values within the accepted error, which the estimate does not understate."""
    tried, ended = alone
    found, full = (vj.run_sweep(sweep(orbits=True, end_early=one), progress=False) for one in (True, False))
    repeats = (full.cycles > 0).values
    assert sum(tried) < 0.15 * len(ended) and len(ended) > 0.8 * repeats.sum()
    same = (found.regime == full.regime).values & (found.cycles == full.cycles).values
    assert same[repeats].mean() >= 0.999
    apart = {name: np.abs(found[name] / full[name] - 1).values for name in ("period", "impact_velocity")}
    np.testing.assert_array_equal(found.impacts.values[repeats & same], full.impacts.values[repeats & same])
    for one in apart.values():
        assert (one[repeats & same] <= (found.error_estimate + full.error_estimate).values[repeats & same]).all()
    np.testing.assert_allclose(found.settling_time, full.settling_time, rtol=1e-6)
    assert found.error_estimate.values[repeats].max() < 1e-2
    assert (found.stable.values == full.stable.values)[repeats].all()


def test_also_without_orbits_and_in_single_precision(alone, monkeypatch):
    monkeypatch.setattr(ends, "SHARING_MIN_SECONDS", 0.0)
    for precision in ("float64", "float32"):
        alone[1].clear()
        both = (vj.run_sweep(sweep(48, precision=precision, end_early=one), progress=False) for one in (True, False))
        found, full = both
        repeats = (full.cycles > 0).values
        assert len(alone[1]) > 0.8 * repeats.sum() and found.dtypes == full.dtypes
        np.testing.assert_array_equal(found.regime.values[repeats], full.regime.values[repeats])
        for name in ("period", "impact_velocity"):
            np.testing.assert_allclose(found[name].values[repeats], full[name].values[repeats], rtol=1e-4)


def test_a_repeat_of_two_is_known_whichever_return_a_lane_stands_at(monkeypatch, alone):
    """Newton's method finds one lane's orbit and no other: all others end on that, at either of its returns."""
    once, left = ends.EarlyEnds.on_orbits, [1]

    def found_once(self, near, batch):
        found = once(self, near, batch)
        left[0], some = left[0] - len(found.lanes), np.arange(min(left[0], len(found.lanes)))
        return found.of(some)

    monkeypatch.setattr(ends.EarlyEnds, "on_orbits", found_once)
    asked = sweep(64, orbits=True) | {"grid": {"beta": [0.4], "gamma": [0.35]}}
    found = vj.run_sweep(asked, progress=False)
    there = int((found.cycles == 2).sum())
    assert there > 40 and alone[1].count(2) > 0.9 * there


def test_the_same_bits_in_any_order_of_chunks():
    """What a chunk knows is its own: it is the same after others and alone."""
    asked = read_sweep(sweep(64, orbits=True, chunk=96))
    forth, back = Work(asked), Work(asked)
    assert forth.chunks.count == 3
    first = [forth.compute(index) for index in range(3)]
    again = [back.compute(index) for index in (2, 0, 1)]
    for one, other in zip(first, [again[1], again[2], again[0]], strict=True):
        for name in one.keys() - {"seconds"}:
            np.testing.assert_array_equal(one[name], other[name], err_msg=name)


def test_shares_stay_when_the_tolerance_is_halved():
    asked = sweep(256) | {"grid": {"gamma": [0.35, 0.55, 0.75]}}
    found, finer = (vj.attractors(asked | {"run": {"error": error}}, progress=False) for error in (1e-4, 5e-5))
    assert found.sizes == finer.sizes
    np.testing.assert_array_equal(found.regime, finer.regime)
    moved = np.abs(found.share - finer.share)
    assert (moved <= np.maximum(found.share_stderr, 1 / 256)).all()
    assert ((found.share > 0.05) & (found.share < 0.95)).any()  # where there is something to move


def test_where_it_is_worth_its_while():
    def kind(count, **run):
        search = ends.early_stopping_of(read_sweep(sweep(count, **run)))
        return search and search.shared

    assert ends.SHARING_MIN_STARTS == 16 and ends.SHARING_MIN_SECONDS == 1.5e6
    assert kind(ends.SHARING_MIN_STARTS, orbits=True) is True and kind(ends.SHARING_MIN_STARTS) is None
    assert kind(ends.SHARING_MIN_STARTS - 1, orbits=True) is None
    assert kind(4096, settle=100.0) is True
    assert kind(4096, settle=100.0, method="smoothed") is None


def test_candidates_are_of_the_own_point():
    known = np.array([4, 1, 4, 2])
    points = np.array([1, 4, 7, 2])
    assert [one.tolist() for one in candidates(known, points, 0)] == [[1, 0, -1, 3], [-1, 2, -1, -1]]
    assert [one.tolist() for one in candidates(known, points, 2)] == [[-1, 2, -1, 3]]
    assert list(candidates(known, points, 4)) == []
    assert rank_in_point(np.array([3, 1, 3, 3, 1])).tolist() == [0, 0, 1, 2, 1]

"""Test machines over the box of their tolerances: samples, extremes, command and refusals."""

import re

import numpy as np
import pytest
import xarray as xr
from refusals import command_refusal

import vibrojax as vj
from vibrojax.measures.labels import REGIMES
from vibrojax.studies.analysis import analysis_of
from vibrojax.studies.tolerance import INTERIOR_SAMPLES, PLACES, QUANTITIES, REFINED, refine, sample_box

RUN = {"settle": 10.0, "observe": 5.0}
MACHINE = {"beta": 0.4, "gamma": (0.75, 0.01), "delta": (0.005, 0.001), "start": "stuck"}


@pytest.fixture(scope="module")
def box():
    return vj.tolerance("vibro-impact", **MACHINE, run=RUN, progress=False)


@pytest.mark.parametrize("dimensions", [1, 3])
def test_samples_of_box(dimensions):
    samples, places = sample_box(dimensions)
    edges = 0 if dimensions == 1 else dimensions * 2 ** (dimensions - 1)
    assert np.bincount(places).tolist() == [1, 2**dimensions, edges, INTERIOR_SAMPLES]
    at_bounds = (np.abs(samples) == 1).sum(axis=1)
    for place, expected in (("nominal", 0), ("corner", dimensions), ("edge", dimensions - 1), ("interior", 0)):
        assert set(at_bounds[places == PLACES.index(place)].tolist()) <= {expected}, place
    assert len(np.unique(samples, axis=0)) == len(samples)
    # A balanced sequence has INTERIOR_SAMPLES / 2 points on either side of the centre.
    assert ((samples[places == 3] > 0).sum(axis=0) == INTERIOR_SAMPLES // 2).all()


def test_lanes_agree_with_single_machines(box):
    assert (box.place != REFINED).sum() == 1 + 4 + 4 + INTERIOR_SAMPLES and box.attrs["kind"] == "tolerance"
    assert {name: box.attrs[f"tolerance_{name}"] for name in ("gamma", "delta")} == {"gamma": 0.01, "delta": 0.001}
    corner = int(np.flatnonzero((box.gamma == 0.76) & (box.delta == 0.004))[0])
    for sample, gamma, delta in ((0, 0.75, 0.005), (corner, 0.76, 0.004)):
        about = {"parameters": {"beta": 0.4, "gamma": gamma}, "grid": {"delta": [delta]}, "run": RUN}
        alone = vj.run_sweep({"scene": "vibro-impact", "starts": ["stuck"]} | about, progress=False)
        for name in ("period", "impact_velocity"):
            lane = float(box[name].isel(sample=sample, start=0))
            assert lane == pytest.approx(float(alone[name].item()), rel=1e-9), name
    for name in (name for name in QUANTITIES if name in box):
        lane = box[name].isel(start=0)
        for word, extreme in (("least", lane.min()), ("most", lane.max())):
            assert float(box[f"{name}_{word}"][0]) == float(extreme)
            assert float(lane[int(box[f"{name}_{word}_sample"][0])]) == float(extreme)
    np.testing.assert_allclose(box.regime_share.sum("label"), 1.0)
    assert float(box.regime_share.sel(label="single-impact")[0]) == float(box.regime_kept[0]) == 1.0
    assert float(box.irregular_share[0]) == 0.0 and "not bounds of the box" in box.attrs["extremes"]


def test_tolerances_are_pairs_of_any_library(box):
    """Pairs that state a unit are converted to SI."""
    stated = xr.DataArray([5.0, 1.0], dims="end", attrs={"units": "mm"})
    for pairs in ({"delta": stated}, {"gamma": np.array([0.75, 0.01]), "delta": (np.float64(0.005), 0.001)}):
        xr.testing.assert_allclose(vj.tolerance("vibro-impact", **MACHINE | pairs, run=RUN, progress=False), box)
    with pytest.raises(vj.InputError, match='delta: is in "s"; a unit of m is needed'):
        vj.tolerance("vibro-impact", **MACHINE | {"delta": stated.assign_attrs(units="s")}, run=RUN, progress=False)


def closed_form(units):
    """Return lanes whose impact velocity is least inside the box and greatest at a corner, and whose period is odd."""
    x, y = units[:, :1] - 0.37, units[:, 1:] + 0.21
    lanes = {"impact_velocity": np.abs(x) + y**2, "period": x + y, "cycles": np.ones_like(x)}
    return xr.Dataset({name: (("point", "start"), values) for name, values in lanes.items()})


def test_search_from_extreme_samples_finds_extremes_of_box():
    units, _ = sample_box(2)
    sampled = closed_form(units)
    ds, places, tried = refine(units, sampled, closed_form)
    added = len(places) - len(units)
    assert float(sampled.impact_velocity.min()) > 0.02 and float(ds.impact_velocity.min()) < 0.01
    assert 0 < added <= tried < 200 and ds.sizes["point"] == len(units) + added
    for name in ("impact_velocity", "period"):  # the corners are the greatest, and nothing leaves the box
        assert float(ds[name].max()) == float(sampled[name].max())
    forced = sampled[["cycles"]].assign(period=1 + 1e-15 * sampled.period)  # constant but for rounding
    assert refine(units, forced, closed_form)[2] == 0


def test_refined_samples_are_consistent_and_irregular_boxes_say_so_first():
    machine = {"beta": 0.4, "gamma": (0.64, 0.0064), "delta": (-0.002, 0.001), "start": "drive"}
    box = vj.tolerance("vibro-impact", **machine, progress=False)
    sampled, refined = box.isel(sample=box.place != REFINED), box.isel(sample=box.place == REFINED)
    assert refined.sizes["sample"] and box.attrs["lanes"] == box.sizes["sample"]
    assert box["sample"].values.tolist() == list(range(box.sizes["sample"]))
    assert float(box.impact_velocity_most[0]) > float(sampled.impact_velocity.max())
    assert (np.abs(refined.gamma - 0.64) <= 0.0064 * (1 + 1e-9)).all()
    points = {name: refined[name].values for name in ("gamma", "delta")} | {"beta": [0.4] * refined.sizes["sample"]}
    alone = vj.run_sweep({"scene": "vibro-impact", "starts": ["drive"], "points": points}, progress=False)
    np.testing.assert_allclose(alone.impact_velocity, refined.impact_velocity, rtol=1e-9)
    irregular = float((sampled.regime == REGIMES.index("irregular")).mean())
    assert float(box.irregular_share[0]) >= irregular > 0
    lines = analysis_of(box).summary(box)[0].lines
    assert sum(re.search(r"at γ = 0\.6\d+, Δ = −[\d.]+ mm$", line) is not None for line in lines) >= 3
    assert lines[0].startswith("irregular motions in the box") and lines[-1] == box.attrs["extremes"]
    unknown = box.assign(impact_power=box.impact_power.where(box["sample"] > 0))
    assert any("nominal none" in line for line in analysis_of(box).summary(unknown)[0].lines)


def test_scene_without_regimes_and_settings_of_runs_are_refused():
    with pytest.raises(vj.InputError, match=r"settle: is a setting of sweeps; it belongs in \[run\]"):
        vj.tolerance("vibro-impact", delta=(0.005, 0.001), settle=20.0, progress=False)
    with pytest.raises(vj.InputError, match=r'scene: "penetration" has no section, so its motions have no regimes'):
        vj.tolerance("penetration", force=(30e3, 1e3), progress=False)


def test_invalid_input_gives_one_line(here, capsys):
    for words, line in (
        ("gamma=0.7", "no parameter has a tolerance"),
        ("gamma=0.7+-x", "is not a tolerance; write NAME=VALUE+-HALF_WIDTH"),
        ("beta=0.4+-0.5", "beta: is -0.1; it must be above 0"),
        ("gamma=0.7+-0.01 gamma=0.7+-0.02", "is a second value"),
        ("beta=1+-.1 gamma=1+-.1 v=1+-.1 g=9+-.1 c2=9+-.1 mu=1+-.1 m1=99+-.1", "7 parameters have a tolerance"),
    ):
        assert line in command_refusal(capsys, "tolerance", "vibro-impact", *words.split())
    assert not list(here.iterdir())

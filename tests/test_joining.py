"""Tests of joining chunks region by region: regions do not change the values, and they bound the memory."""

from math import prod

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st

from vibrojax.io.writers import Regions
from vibrojax.maps import dataset as joining
from vibrojax.maps.read import read_sweep
from vibrojax.maps.run import run_sweep, run_to_file

SWEEP = {
    "scene": "vibro-impact",
    "parameters": {"delta": 0.0},
    "grid": {"beta": [0.4, 0.5], "gamma": [0.6, 0.7, 0.9]},
    "starts": ["drive", "stuck", "touching"],
    "run": {"settle": 40.0, "observe": 8.0, "chunk": 4},
}


@settings(deadline=None)
@given(st.lists(st.integers(1, 6), min_size=1, max_size=4), st.integers(1, 90))
def test_regions_are_consecutive_whole_chunks(shape, limit):
    regions = Regions(tuple(shape), limit)
    values, position = np.full(shape, -1), 0
    for region in regions:
        assert region.first == position and 0 < region.end - region.first <= limit
        position = region.end
        assert all(part.start % size == 0 for part, size in zip(region.box, regions.chunk, strict=True))
        assert all(part.stop - part.start <= size for part, size in zip(region.box, regions.chunk, strict=True))
        values[region.box] = np.arange(region.first, region.end).reshape(region.shape)
    np.testing.assert_array_equal(values.ravel(), np.arange(prod(shape)))


@pytest.mark.parametrize(
    "starts, changes", [(SWEEP["starts"], ["run.keep_returns=3"]), (["stuck"], ["run.carry=beta", "run.settle=2.0"])]
)
def test_regions_do_not_change_result(starts, changes, tmp_path, monkeypatch):
    """Chunks and regions split points and paths of carried lanes. Real regions hold a million lanes."""
    sweep = read_sweep(SWEEP | {"starts": starts}, changes)
    expected = run_sweep(sweep, progress=False)
    monkeypatch.setattr(joining, "REGION", 2)
    for joined in (run_sweep(sweep, progress=False), run_to_file(sweep, tmp_path / "out.nc", progress=False)):
        xr.testing.assert_identical(joined.drop_attrs(), expected.drop_attrs())
        assert joined.attrs["certified"] == expected.attrs["certified"]


def test_points_keep_their_parameters_as_coordinates(tmp_path):
    points = {"beta": [0.3, 0.4], "gamma": [0.7, 0.8], "start": ["stuck", "drive"]}
    sweep = read_sweep({"scene": "vibro-impact", "points": points, "run": {"settle": 3.0, "observe": 2.0}})
    ds = run_to_file(sweep, tmp_path / "out.nc", progress=False)
    assert set(ds.coords) == {"point", "beta", "gamma", "start"}
    xr.testing.assert_identical(ds.drop_attrs(), run_sweep(sweep, progress=False).drop_attrs())

"""Tests of joining chunks region by region: regions do not change the values, and they bound the memory."""

import os
import subprocess
import sys
from math import prod
from pathlib import Path

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


JOIN_SCRIPT = """
import resource, sys, time
from pathlib import Path
import numpy as np
from vibrojax.maps.read import read_sweep
from vibrojax.maps.dataset import join
from vibrojax.maps.executor import compute
from vibrojax.io.writers import file_target
from vibrojax.periodic.lane_stages import lane_run
sweep = read_sweep({"scene": "rotary", "starts": ["stuck"], "run": {"settle": 0.1, "observe": 0.1},
                    "grid": {"v": {"start": 0.5, "stop": 2.0, "num": int(sys.argv[2])}, "k1": {"start": 1e5, "stop": 2e5, "num": 1000}}})
run = lane_run(sweep.inputs(0, 1), sweep.plan)
_, one = next(compute(sweep, run, [0]))
noise = np.random.default_rng(0).random(len(one["period"]))
one = {name: x + noise if x.dtype == float and x.ndim == 1 and name in ("bit_amplitude", "drive_power") else x for name, x in one.items()}
def read(index):
    first, end = sweep.chunk(index)
    return {name: x[:end - first] if x.ndim else x for name, x in one.items()}
with file_target(Path(sys.argv[1])) as target:
    join(sweep, run, read, target, time.monotonic())
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""  # noqa: E501


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


@pytest.mark.long
def test_memory_is_bounded_by_region(tmp_path):
    """Three times as many lanes take no more memory; 75 MB of additional values would show."""
    root = Path(__file__).parents[1]
    peaks = []
    for rows in ("250", "750"):
        command = [sys.executable, "-c", JOIN_SCRIPT, str(tmp_path / "out.nc"), rows]
        process = subprocess.run(
            command, capture_output=True, text=True, check=True, env=os.environ | {"PYTHONPATH": str(root)}
        )
        peaks.append(int(process.stdout) / 1e3)
    assert peaks[1] - peaks[0] < 40.0, peaks

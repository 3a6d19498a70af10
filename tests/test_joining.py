"""Tests of joining chunks region by region: regions do not change the values, and they bound the memory."""

import os
import subprocess
import sys
from math import prod
from pathlib import Path

import netCDF4
import numpy as np
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st

from vibrojax.io import dataset as on_disk
from vibrojax.io.dataset import open_dataset
from vibrojax.io.targets import Regions
from vibrojax.lanes.run import LaneRun
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


@pytest.fixture(scope="module", params=[0, 3])
def swept(request):
    """Return a sweep with this many last returns, its dataset, and a `LaneRun.chunk` that computes each chunk once."""
    sweep, chunks, compute = read_sweep(SWEEP, [f"run.keep_returns={request.param}"]), {}, LaneRun.chunk

    def compute_once(self, lanes, report=None):
        inputs = lanes() if callable(lanes) else lanes
        key = (inputs.parameters["beta"].tobytes(), inputs.parameters["gamma"].tobytes(), inputs.start.tobytes())
        if key not in chunks:
            chunks[key] = compute(self, inputs)
        return chunks[key]

    return sweep, run_sweep(sweep, progress=False), compute_once


@pytest.mark.parametrize("region", [1, 2, 7, 20])
def test_regions_do_not_change_result(region, swept, tmp_path, monkeypatch):
    """Chunks and regions split points, but `hidden_motion` still compares all starts of a point."""
    sweep, expected, compute_once = swept
    monkeypatch.setattr(LaneRun, "chunk", compute_once)
    assert expected.hidden_motion.values.any()
    monkeypatch.setattr(joining, "REGION", region)
    monkeypatch.setattr("vibrojax.io.targets.COMPRESSED", 4)
    for joined in (run_sweep(sweep, progress=False), run_to_file(sweep, tmp_path / "out.nc", progress=False)):
        xr.testing.assert_identical(joined.drop_attrs(), expected.drop_attrs())
        assert joined.attrs["certified"] == expected.attrs["certified"]
        assert {name: variable.attrs.keys() for name, variable in joined.variables.items()} == {
            name: variable.attrs.keys() for name, variable in expected.variables.items()
        }
    with netCDF4.Dataset(tmp_path / "out.nc") as file:
        assert file["period"].chunking() == list(Regions(sweep.shape, region).chunk)
        assert file["period"].filters()["zlib"] and file["period"].filters()["shuffle"]


def test_large_datasets_pack_only_what_becomes_half_as_large(tmp_path, monkeypatch):
    """Flags and repeated values are packed. Measured numbers are written as they are, at the speed of the disk."""
    many = {"starts": {"sample": "sobol", "count": 64, "box": {"x2": [-0.05, 0.05]}}}
    sweep = read_sweep(SWEEP | many | {"run": {"settle": 3.0, "observe": 2.0, "chunk": 100}})
    expected = run_sweep(sweep, progress=False)
    monkeypatch.setattr("vibrojax.io.targets.COMPRESSED", 4)
    monkeypatch.setattr(joining, "COMPRESSED_BYTES", 0.0)
    joined = run_to_file(sweep, tmp_path / "out.nc", progress=False)
    xr.testing.assert_identical(joined.drop_attrs(), expected.drop_attrs())
    with netCDF4.Dataset(tmp_path / "out.nc") as file:
        packed = {name for name in expected.data_vars if file[name].filters()["zlib"]}
        assert file["bit_amplitude"].chunking() == list(sweep.shape)
    assert {"regime", "cycles", "status", "reason", "hidden_motion"} <= packed
    assert not packed & {"bit_amplitude", "striker_amplitude", "drive_power"}


def test_carried_lanes_reach_their_places(tmp_path, monkeypatch):
    """The order of these lanes differs from that of the dataset's dimensions."""
    sweep = read_sweep(
        SWEEP | {"starts": ["stuck"]}, ["run.carry=beta", "run.settle=2.0", "run.observe=1.0", "run.chunk=4"]
    )
    expected = run_sweep(sweep, progress=False)
    assert expected.period.dims == ("beta", "gamma", "direction")
    monkeypatch.setattr(joining, "REGION", 3)
    monkeypatch.setattr("vibrojax.io.targets.COMPRESSED", 4)
    joined = run_to_file(sweep, tmp_path / "out.nc", progress=False)
    xr.testing.assert_identical(joined.drop_attrs(), expected.drop_attrs())


def test_points_keep_their_parameters_as_coordinates(tmp_path):
    points = {"beta": [0.3, 0.4], "gamma": [0.7, 0.8], "start": ["stuck", "drive"]}
    sweep = read_sweep({"scene": "vibro-impact", "points": points, "run": {"settle": 3.0, "observe": 2.0}})
    ds = run_to_file(sweep, tmp_path / "out.nc", progress=False)
    assert set(ds.coords) == {"point", "beta", "gamma", "start"}
    xr.testing.assert_identical(ds.drop_attrs(), run_sweep(sweep, progress=False).drop_attrs())


@pytest.mark.parametrize("dask", [True, False])
def test_large_files_are_read_lazily(dask, tmp_path, monkeypatch):
    expected = run_to_file(read_sweep(SWEEP), tmp_path / "out.nc", progress=False)
    monkeypatch.setattr(on_disk, "LAZY_FROM", 0)
    if dask:
        pytest.importorskip("dask")
    else:
        monkeypatch.setattr(on_disk, "find_spec", lambda _: None)
    with open_dataset(tmp_path / "out.nc") as opened:
        assert all(
            variable._in_memory is False for name, variable in opened.variables.items() if name in opened.data_vars
        )
        assert (opened.chunks != {}) == dask
        xr.testing.assert_identical(opened.load(), expected)


JOIN_SCRIPT = """
import resource, sys, time
from pathlib import Path
import numpy as np
from vibrojax.maps.read import read_sweep
from vibrojax.maps.dataset import join
from vibrojax.maps.executor import compute
from vibrojax.io.targets import file_target
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

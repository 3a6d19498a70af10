"""An interrupted sweep loses nothing: it goes on where it was, and ends as if it had not been interrupted."""

import time

import numpy as np
import pytest
import xarray as xr

from vibrojax.analyses.sweep.run import run_to_file
from vibrojax.sweep.engine.chunks import Chunks
from vibrojax.sweep.input.read import read_sweep

SWEEP = {
    "scene": "vibro-impact",
    "grid": {"beta": [0.3, 0.4, 0.5], "gamma": [0.6, 0.7, 0.75, 0.8]},
    "run": {"settle": 3.0, "observe": 2.0, "chunk": 7},
}


def test_goes_on_where_it_was(tmp_path, monkeypatch):
    sweep, whole, out = read_sweep(SWEEP), tmp_path / "whole.nc", tmp_path / "parts.nc"
    run_to_file(sweep, whole, progress=False)
    compute, computed = Chunks.compute, []

    def interrupted(self, index, *told):
        if index == 2:
            raise KeyboardInterrupt
        time.sleep(0.3)
        return compute(self, index, *told)

    monkeypatch.setattr(Chunks, "compute", interrupted)
    with pytest.raises(KeyboardInterrupt):
        run_to_file(sweep, out, progress=False)
    assert not out.exists()

    def counted(self, index, *told):
        computed.append(index)
        return compute(self, index, *told)

    monkeypatch.setattr(Chunks, "compute", counted)
    run_to_file(sweep, out, progress=False)
    assert computed == [2, 3]
    assert not out.with_name("parts.nc.chunks").exists()
    with xr.open_dataset(whole) as expected, xr.open_dataset(out) as found:
        xr.testing.assert_identical(found.drop_attrs(), expected.drop_attrs())
        assert found.wall_time_s > 0.6  # what the interrupted run took counts
        assert np.all(found.status == 0)

"""Test the programs for accelerators against kernels, on two devices that share the processor."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import vibrojax

SCRIPT = """
import sys

import jax
import numpy as np
from lane_steps import as_on_accelerator

from vibrojax.compile.xla import BoundProgram
from vibrojax.lanes import compiler
from vibrojax.lanes.run import LaneRun
from vibrojax.maps.read import read_sweep

compiler.XLA_BLOCK_ON_ACCELERATOR = 64  # instead of 16384: a step of lanes that only fill a block takes as long
precision, within = sys.argv[1], float(sys.argv[2])
grid = {"gamma": {"start": 0.4, "stop": 1.2, "num": 8}, "beta": [0.2, 0.5, 0.8]}
run = {"settle": 12.0, "observe": 6.0, "end_early": False, "precision": precision, "error": 1e-2}
sweep = read_sweep({"scene": "rotary", "grid": grid, "starts": [[0.0, -1.5, 0.0, 0.0]], "run": run})
used, call = set(), BoundProgram.__call__


def recorded(self, lanes):
    call(self, lanes)
    used.add(jax.config.jax_default_device)
    assert (self._block, self._blocks) == (64, 1)  # all lanes of a call step together
    assert {x.dtype for x in jax.tree.leaves(self.results) if x.dtype.kind == "f"} == {np.dtype(precision)}


BoundProgram.__call__ = recorded
assert len(jax.local_devices()) == 2
inputs = sweep.inputs()
chunks = as_on_accelerator(LaneRun(inputs, sweep.plan))
assert not chunks.ends_early
kernels = LaneRun(inputs, sweep.plan)
found, expected = chunks.chunk(inputs).features, kernels.chunk(inputs).features
assert used == set(jax.local_devices()), used
assert chunks.engine.programs.compiler == "xla" and kernels.engine.programs.compiler == "llvm"
assert expected.keys() == found.keys()
repeats = expected["cycles"] > 0
assert repeats.mean() > 0.4, expected["cycles"]
for name in ("cycles", "period", "bit_amplitude", "drive_power"):
    np.testing.assert_allclose(found[name][repeats], expected[name][repeats], rtol=within, err_msg=name)
"""


@pytest.mark.long
@pytest.mark.parametrize(("precision", "within"), [("float64", "1e-8"), ("float32", "2e-3")])
def test_features_match_those_of_kernels(precision, within):
    folder = Path(__file__).parent
    paths = (str(folder / "benchmarks"), str(Path(vibrojax.__file__).parents[1]))
    environment = os.environ | {
        "XLA_FLAGS": "--xla_force_host_platform_device_count=2",
        "JAX_PLATFORMS": "cpu",
        "PYTHONPATH": os.pathsep.join(paths),
    }
    command = [sys.executable, "-c", SCRIPT, precision, within]
    completed = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert completed.returncode == 0, completed.stderr[-2000:]

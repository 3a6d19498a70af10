"""Test compiled functions against NumPy, and lanes compiled by XLA, on accelerators too, against lanes of kernels."""

import json
import os
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import vibrojax as vj
from vibrojax.cli import main
from vibrojax.compile import agreement, native, xla
from vibrojax.compile.agreement import check
from vibrojax.lanes import compiler
from vibrojax.lanes.compiler import EQUATION_FUNCTIONS
from vibrojax.lanes.programs import LaneArguments, ProgramKey, settle_lanes, start_lanes
from vibrojax.measures import recorder_for
from vibrojax.measures.recorder import Effort, LaneState
from vibrojax.scenes.penetration import PULSE_SHAPES
from vibrojax.stepping import Accuracy, AccuracyRequest

TOML = 'scene = "rotary"\n[grid]\nbeta = [0.4]\n[run]\nsettle = 1.0\nobserve = 1.0\n'


def wrong_functions(evaluate, dtype, lanes):
    return agreement.wrong_functions(evaluate, EQUATION_FUNCTIONS, np.dtype(dtype), lanes)


@pytest.mark.parametrize("dtype", ["float64", "float32"])
@pytest.mark.parametrize("lanes", [4, 17, 1024])
def test_functions_against_numpy(lanes, dtype):
    """Kernels agree to four rounding errors, and so does XLA, with the same options as for sweeps."""
    assert wrong_functions(compiler._evaluate_by_kernel, dtype, lanes) == []
    by_xla = xla.evaluation("cpu")
    assert wrong_functions(by_xla, dtype, lanes) == []


def shuffled(function, *x, right=compiler._evaluate_by_kernel):
    """Permute the values of arctan among lanes, as jaxlib 0.10.2 does with AVX-512, in blocks of four lanes or more."""
    values = right(function, *x)
    return values | {"arctan": np.roll(values["arctan"], 1)} if len(x[0]) >= 4 else values


def test_wrong_function_is_named():
    assert wrong_functions(shuffled, "float64", 3) == [] and wrong_functions(shuffled, "float64", 64) == ["arctan"]


def test_sweep_is_refused_in_one_line(monkeypatch, tmp_path, capsys):
    """The check precedes any computation. Only a patch stands for a compiler that is wrong."""
    monkeypatch.setattr(compiler, "_evaluate_by_kernel", shuffled)
    check.cache_clear()
    (tmp_path / "sweep.toml").write_text(TOML)
    try:
        assert main(["sweep", str(tmp_path / "sweep.toml"), "-o", str(tmp_path / "out.nc"), "--quiet"]) == 2
    finally:
        check.cache_clear()
    printed = capsys.readouterr().err
    assert printed.count("\n") == 1 and "computes arctan wrongly" in printed
    assert "install another version of llvmlite" in printed and not (tmp_path / "out.nc").exists()


SCENES = [
    *(vj.SCENES[name]() for name in vj.SCENES),
    *(vj.SCENES["vibro-impact"](friction=law) for law in vj.FRICTION_LAWS.values()),
    *(vj.SCENES["penetration"](pulse_shape=shape) for shape in PULSE_SHAPES[1:]),
]


LATER = [pytest.param(scene, marks=pytest.mark.long) for scene in SCENES[1:]]


@pytest.mark.parametrize("scene", [SCENES[0], *LATER], ids=lambda x: x.name)
def test_steps_of_scenes_and_laws_agree_with_xla(scene):
    """Four steps of eight lanes, whose instructions XLA compiles one by one. The law popp-arctan amplifies a change by
    4e-16 of the parameters to 2.5e-9 of the velocity."""
    kind, lanes = ProgramKey(scene, vj.Located(), recorder_for(scene)), np.arange(8)
    parameters = {name: x.default * (1 + 0.02 * lanes) for name, x in scene.parameters().items()}
    given = LaneArguments(parameters, (lanes % max(len(scene.starts), 1)).astype(np.int32))
    accuracy = map(np.float64, kind.stepper.accuracy(AccuracyRequest(precision="float64"), scene))
    lane, carry = native.kernel_for(start_lanes, (kind,), given)(given)
    underway, effort = LaneState(lane, carry, np.zeros(8, np.int32)), Effort(Accuracy(*accuracy), np.int32(4))
    arguments = given, underway, np.full(8, 100.0), effort
    results = native.kernel_for(settle_lanes, (kind,), *arguments)(*arguments)
    with jax.disable_jit(), jax.debug_nans(False):
        expected = settle_lanes(kind, *jax.tree.map(jnp.asarray, arguments))
    assert (results.steps == 4).all()
    for result, correct in zip(jax.tree.leaves(results), jax.tree.leaves(expected), strict=True):
        size = np.max(np.abs(correct), initial=0, where=np.isfinite(correct))
        np.testing.assert_allclose(result, correct, rtol=1e-8, atol=1e-12 + 1e-8 * size)


class WithoutKernel(vj.SCENES["penetration"]):
    """A scene with a function for which kernels have no rule."""

    def constants(self, p):
        m1 = p["m1"]
        return super().constants(p | {"m1": m1 + 0.0 * jnp.argmax(jnp.stack([m1, m1]), axis=0).astype(m1.dtype)})


@pytest.mark.long
def test_lanes_without_a_kernel_run_on_xla():
    sweep = {"grid": {"force": [200e3, 300e3], "frequency": [20.0, 40.0]}}
    kernel, xla = (vj.run_sweep(sweep | {"scene": scene}, progress=False) for scene in ("penetration", WithoutKernel()))
    assert [json.loads(ds.attrs["solver"])["compiler"] for ds in (kernel, xla)] == ["llvm", "xla"]
    for name in ("rate_of_penetration", "slip_per_impact"):
        np.testing.assert_allclose(xla[name], kernel[name], rtol=1e-9)


# The programs for accelerators, on two devices that share the processor
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
    paths = (str(Path(__file__).parent / "benchmarks"), str(Path(vj.__file__).parents[1]))
    environment = os.environ | {"JAX_PLATFORMS": "cpu", "PYTHONPATH": os.pathsep.join(paths)}
    environment |= {"XLA_FLAGS": "--xla_force_host_platform_device_count=2"}
    command = [sys.executable, "-c", SCRIPT, precision, within]
    completed = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert completed.returncode == 0, completed.stderr[-2000:]

"""Test the compiled functions of the equations against NumPy, for each number of lanes in a block."""

import numpy as np
import pytest

from vibrojax.cli import main
from vibrojax.compile import agreement, xla
from vibrojax.compile.agreement import check
from vibrojax.lanes import compiler
from vibrojax.lanes.compiler import EQUATION_FUNCTIONS

TOML = 'scene = "rotary"\n[grid]\nbeta = [0.4]\n[run]\nsettle = 1.0\nobserve = 1.0\n'


def wrong_functions(evaluate, dtype, lanes):
    return agreement.wrong_functions(evaluate, EQUATION_FUNCTIONS, np.dtype(dtype), lanes)


@pytest.mark.parametrize("dtype", ["float64", "float32"])
@pytest.mark.parametrize("lanes", [4, 17, 1024])
def test_functions_against_numpy(lanes, dtype):
    """Kernels agree to four rounding errors, and so does XLA, with the same options as for sweeps."""
    assert wrong_functions(compiler._evaluate_by_kernel, dtype, lanes) == []
    by_xla = xla.evaluation(tuple(xla.compiler_options("cpu").items()))
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

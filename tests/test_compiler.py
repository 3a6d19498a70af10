"""Test the compiled functions of the equations against NumPy, for each number of lanes in a block."""

import threading

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from vibrojax.cli import main
from vibrojax.compile import agreement, xla
from vibrojax.compile.agreement import check
from vibrojax.compile.xla import compiler_options
from vibrojax.errors import InputError
from vibrojax.lanes import compiler
from vibrojax.lanes.compiler import EQUATION_FUNCTIONS

TOML = 'scene = "rotary"\n[grid]\nbeta = [0.4]\n[run]\nsettle = 1.0\nobserve = 1.0\n'


def wrong_functions(evaluate, dtype, lanes):
    return agreement.wrong_functions(evaluate, EQUATION_FUNCTIONS, dtype, lanes)


def xla_evaluation(options):
    return xla.evaluation(tuple(options.items()))


LANES = (4, 16, 17, 64, 1024)


@pytest.mark.parametrize("dtype", ["float64", "float32"])
@pytest.mark.parametrize("lanes", LANES)
def test_functions_against_numpy(width, lanes, dtype):
    """Kernels agree to four rounding errors."""
    assert wrong_functions(compiler._evaluate_by_kernel, np.dtype(dtype), lanes) == []


@pytest.mark.parametrize("dtype", ["float64", "float32"])
@pytest.mark.parametrize("lanes", LANES)
def test_functions_by_xla_against_numpy(lanes, dtype):
    """XLA agrees to four rounding errors, with the same options as for sweeps."""
    assert wrong_functions(xla_evaluation(compiler_options("cpu")), np.dtype(dtype), lanes) == []


def test_wide_vectors_only_for_checked_versions(monkeypatch):
    for version in ("0.10.2", "0.11.0", "0.11.2", "0.13.0"):
        monkeypatch.setattr(xla.jaxlib, "__version__", version)
        assert "xla_cpu_prefer_vector_width" not in compiler_options("cpu")
    monkeypatch.setattr(xla.jaxlib, "__version__", "0.12.0.1")
    assert compiler_options("cpu")["xla_cpu_prefer_vector_width"] == 512
    assert compiler_options("gpu").keys() <= {"xla_disable_hlo_passes"}


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_fault_of_wide_vectors_is_detected(dtype):
    """On machines with the fault (AVX-512, jaxlib 0.10.2), arctan of a block is returned in wrong places."""
    wide = compiler_options("cpu") | {"xla_cpu_prefer_vector_width": 512}
    x = np.linspace(0.01, 3.0, 64, dtype=dtype)
    is_wrong = not np.allclose(jax.jit(jnp.arctan, compiler_options=wide)(x), np.arctan(x), rtol=1e-5)
    assert wrong_functions(xla_evaluation(wide), np.dtype(dtype), 64) == ["arctan"] * is_wrong


FAULTY_FROM = 4
"""Lanes of the shortest block: two vectors of 16 bytes."""


@pytest.fixture
def shuffled(monkeypatch):
    """Permute the values of arctan among lanes, as jaxlib 0.10.2 does with AVX-512."""
    right = compiler._evaluate_by_kernel

    def wrong(function, *x):
        values = right(function, *x)
        return values | {"arctan": np.roll(values["arctan"], 1)} if len(x[0]) >= FAULTY_FROM else values

    assert "arctan" in [function.__name__ for function in EQUATION_FUNCTIONS]
    monkeypatch.setattr(compiler, "_evaluate_by_kernel", wrong)
    check.cache_clear()
    yield
    check.cache_clear()


def test_wrong_function_is_named(shuffled):
    """The check reports arctan only for lengths at which it is wrong."""
    assert wrong_functions(compiler._evaluate_by_kernel, np.dtype("float64"), FAULTY_FROM - 1) == []
    assert wrong_functions(compiler._evaluate_by_kernel, np.dtype("float64"), 64) == ["arctan"]
    message = r"llvmlite 0\.1 computes arctan wrongly on this machine, 64 values of float64 at a time: .* of llvmlite"
    with pytest.raises(InputError, match=message):
        check(compiler._evaluate_by_kernel, EQUATION_FUNCTIONS, "llvmlite 0.1", np.dtype("float64"), 64)


def test_sweep_is_refused_in_one_line(width, shuffled, tmp_path, capsys):
    """The check precedes any computation, for each width of vectors."""
    before = set(threading.enumerate())
    (tmp_path / "sweep.toml").write_text(TOML)
    assert main(["sweep", str(tmp_path / "sweep.toml"), "-o", str(tmp_path / "out.nc"), "--quiet"]) == 2
    printed = capsys.readouterr().err
    assert (
        printed.count("\n") == 1
        and "computes arctan wrongly" in printed
        and "install another version of llvmlite" in printed
    )
    assert not (tmp_path / "out.nc").exists()
    for thread in set(threading.enumerate()) - before:  # threads still compile; Python would abort there on exit
        if thread.ident is not None:  # is running
            thread.join(120)

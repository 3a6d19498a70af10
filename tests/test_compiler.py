"""What lanes are compiled with computes rightly: every function of the equations, so many values at a time."""

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
from vibrojax.sweep.engine import compiler
from vibrojax.sweep.engine.compiler import EQUATION_FUNCTIONS

TOML = 'scene = "rotary"\n[grid]\nbeta = [0.4]\n[run]\nsettle = 1.0\nobserve = 1.0\n'


def wrong_functions(evaluate, dtype, lanes):
    return agreement.wrong_functions(evaluate, EQUATION_FUNCTIONS, dtype, lanes)


def by_xla_with(options):
    return xla.evaluation(tuple(options.items()))


LANES = (4, 16, 17, 64, 1024)


@pytest.mark.parametrize("dtype", ["float64", "float32"])
@pytest.mark.parametrize("lanes", LANES)
def test_functions_against_numpy(width, lanes, dtype):
    """Kernels: to four roundings."""
    assert wrong_functions(compiler._evaluate_by_kernel, np.dtype(dtype), lanes) == []


@pytest.mark.parametrize("dtype", ["float64", "float32"])
@pytest.mark.parametrize("lanes", LANES)
def test_functions_by_xla_against_numpy(lanes, dtype):
    """To four roundings, under the very options that sweeps are compiled with."""
    assert wrong_functions(by_xla_with(compiler_options("cpu")), np.dtype(dtype), lanes) == []


def test_wide_vectors_only_where_they_were_checked(monkeypatch):
    for version in ("0.10.2", "0.11.0", "0.11.2", "0.13.0"):
        monkeypatch.setattr(xla.jaxlib, "__version__", version)
        assert "xla_cpu_prefer_vector_width" not in compiler_options("cpu")
    monkeypatch.setattr(xla.jaxlib, "__version__", "0.12.0.1")
    assert compiler_options("cpu")["xla_cpu_prefer_vector_width"] == 512
    assert compiler_options("gpu").keys() <= {"xla_disable_hlo_passes"}


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_the_fault_of_wide_vectors_is_found(dtype):
    """The fault itself, where machine and jaxlib have it (AVX-512, 0.10.2): arctan of a block in wrong places."""
    wide = compiler_options("cpu") | {"xla_cpu_prefer_vector_width": 512}
    x = np.linspace(0.01, 3.0, 64, dtype=dtype)
    is_wrong = not np.allclose(jax.jit(jnp.arctan, compiler_options=wide)(x), np.arctan(x), rtol=1e-5)
    assert wrong_functions(by_xla_with(wide), np.dtype(dtype), 64) == ["arctan"] * is_wrong


FAULTY_FROM = 4
"""Lanes of the shortest block there is, of two vectors of 16 bytes."""


@pytest.fixture
def shuffled(monkeypatch):
    """An arctan that returns the values of lanes in other places, as jaxlib 0.10.2 does with AVX-512."""
    right = compiler._evaluate_by_kernel

    def wrong(function, *x):
        found = right(function, *x)
        return found | {"arctan": np.roll(found["arctan"], 1)} if len(x[0]) >= FAULTY_FROM else found

    assert "arctan" in [function.__name__ for function in EQUATION_FUNCTIONS]
    monkeypatch.setattr(compiler, "_evaluate_by_kernel", wrong)
    check.cache_clear()
    yield
    check.cache_clear()


def test_a_wrong_function_is_named(shuffled):
    """Where it is wrong only."""
    assert wrong_functions(compiler._evaluate_by_kernel, np.dtype("float64"), FAULTY_FROM - 1) == []
    assert wrong_functions(compiler._evaluate_by_kernel, np.dtype("float64"), 64) == ["arctan"]
    said = r"llvmlite 0\.1 computes arctan wrongly on this machine, 64 values of float64 at a time: .* of llvmlite"
    with pytest.raises(InputError, match=said):
        check(compiler._evaluate_by_kernel, EQUATION_FUNCTIONS, "llvmlite 0.1", np.dtype("float64"), 64)


def test_a_sweep_is_refused_with_one_line(width, shuffled, tmp_path, capsys):
    """Nothing is computed before the check, whatever the width of vectors."""
    before = set(threading.enumerate())
    (tmp_path / "sweep.toml").write_text(TOML)
    assert main(["sweep", str(tmp_path / "sweep.toml"), "-o", str(tmp_path / "out.nc"), "--quiet"]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and "computes arctan wrongly" in said and "install another version of llvmlite" in said
    assert not (tmp_path / "out.nc").exists()
    for thread in set(threading.enumerate()) - before:  # still compiling; Python's end would abort there
        if thread.ident is not None:  # it has begun
            thread.join(120)

"""Tests that a lane's result does not depend on its chunk, its position, the cores, or earlier computations."""

import json
from pathlib import Path

import numpy as np
import pytest

import vibrojax as vj
from vibrojax.compile import xla
from vibrojax.compile.native import kernels

CASES = json.loads((Path(__file__).parent / "data" / "vibro_impact_cases.json").read_text())
PERIODIC = [case for case in CASES if case["expected"].get("cycles", 0) > 0]
COPIES = 5
SHORT = {"settle": 12.0, "observe": 6.0}

# Every sweep begins with a stuck lane: the program depends on the order in which starts first occur.
TILED = [PERIODIC[index % len(PERIODIC)] for index in range(COPIES * len(PERIODIC))]


def sweep(cases, **run):
    points = {key: [case["point"][key] for case in cases] for key in CASES[0]["point"]}
    return {"scene": "vibro-impact", "points": points, "run": run}


def features(dataset):
    """Return the values of all variables, by name."""
    return {name: variable.values for name, variable in dataset.data_vars.items()}


def assert_identical(actual, expected):
    """Check that all values are equal bit for bit, NaN included."""
    assert actual.keys() == expected.keys()
    for name in actual:
        np.testing.assert_array_equal(actual[name], expected[name], err_msg=name)


@pytest.fixture(scope="module")
def tiled():
    """Return lanes that each occur five times, at different positions, in two chunks of whole and short blocks."""
    return features(vj.run_sweep(sweep(TILED, chunk=100, **SHORT), progress=False))


def test_position_in_chunk(tiled):
    assert len(TILED) > 100
    assert np.mean(tiled["cycles"] > 0) > 0.8  # the others have not settled within 12 s
    for name, values in tiled.items():
        copies = values.reshape(COPIES, len(PERIODIC))
        np.testing.assert_array_equal(copies, np.broadcast_to(copies[0], copies.shape), err_msg=name)


@pytest.fixture(scope="module")
def usual_width():
    return run_rotary()


def run_rotary():
    grid = {"beta": [0.3, 0.4, 0.5], "gamma": [0.6, 0.7, 0.8]}
    return features(vj.run_sweep({"scene": "rotary", "grid": grid, "run": SHORT}, progress=False))


def test_vector_width(usual_width, width):
    """Groups of 2, 4 or 8 lanes, and twice as many while lanes settle, give the same bits."""
    assert_identical(run_rotary(), usual_width)


def test_order_of_lanes(tiled):
    """All lanes but the first are in reverse order, so that each block has other neighbours."""
    order = [0, *range(len(TILED) - 1, 0, -1)]
    backwards = vj.run_sweep(sweep([TILED[index] for index in order], chunk=100, **SHORT), progress=False)
    assert_identical(features(backwards), {name: values[order] for name, values in tiled.items()})


def test_chunk_size(tiled):
    assert_identical(features(vj.run_sweep(sweep(TILED, chunk=50, **SHORT), progress=False)), tiled)


def test_number_of_cores(tiled, monkeypatch):
    monkeypatch.setenv("VIBROJAX_THREADS", "3")
    assert len(xla.workers()) == 3
    assert_identical(features(vj.run_sweep(sweep(TILED, chunk=100, **SHORT), progress=False)), tiled)


def test_accelerators_are_not_overlooked(monkeypatch, tmp_path):
    """Without jax, workers are those of the CPU only if jax could find no other devices."""
    may_have = xla._may_have_accelerator.__wrapped__
    for name in xla.DEVICE_VARIABLES:
        monkeypatch.delenv(name, raising=False)
    if may_have():
        pytest.skip("a plugin is installed")
    monkeypatch.setenv("JAX_PLATFORMS", "cuda,cpu")
    assert may_have()
    monkeypatch.delenv("JAX_PLATFORMS")
    (tmp_path / "jax_plugins" / "xla_cuda13").mkdir(parents=True)
    monkeypatch.syspath_prepend(tmp_path)
    assert may_have()
    monkeypatch.setenv("JAX_PLATFORMS", "cpu")
    assert not may_have()


def test_second_sweep_compiles_nothing(tiled):
    """Parameters, times and accuracy are values, so another sweep of the scene runs in the same program."""
    compiled = list(kernels)
    other = [{"point": case["point"] | {"beta": 0.33, "v": 1.1}} for case in PERIODIC]
    for run in ({"error": 1e-3}, {"settle": 3.0, "observe": 2.0}, {"step": 2e-3}):
        vj.run_sweep(sweep(other, **(SHORT | run)), progress=False)
    fixed = sweep(other, **SHORT) | {"parameters": {"m1": 200.0, "k0": 4e7, "c0": 10.0, "mu": 0.3}}
    vj.run_sweep(fixed, progress=False)
    assert list(kernels) == compiled


def section_times(point, duration):
    motion = vj.simulate("vibro-impact", **point, duration=duration, sampling=0.1, progress=False)
    kinds = motion.event_kind.attrs["flag_meanings"].split()
    return motion.event_time.values[motion.event_kind.values == kinds.index("section")]


def test_keep_returns():
    """The newest return is last. Each has the time of a section crossing of `simulate`; missing ones are NaN."""
    cases = [PERIODIC[0], PERIODIC[1], *[case for case in CASES if case["expected"]["regime"] == "equilibrium"]]
    keep = 5
    dataset = vj.run_sweep(sweep(cases, settle=2.0, observe=3.0, keep_returns=keep), progress=False)
    assert dataset.sizes["return_index"] == keep
    for index, case in enumerate(cases):
        times = section_times(case["point"], 5.0)
        times = times[times > 2.0]
        kept = dataset.return_time[index].values
        expected = np.concatenate([np.full(max(keep - len(times), 0), np.nan), times[-keep:]])
        np.testing.assert_allclose(kept, expected, rtol=1e-9)
        assert dataset.returns[index] == len(times)
    known = dataset.isel(point=0)
    assert np.all(known.return_impacts == 1)
    np.testing.assert_allclose(known.return_impact_velocity.mean(), known.impact_velocity, rtol=1e-2)


def test_float32():
    """In single precision and at the full 48 s, periodic cases have the right regime.

    Their period and impact velocity are right to 3e-6. No lane is abandoned, the irregular ones included.
    """
    single = vj.run_sweep(sweep(CASES, precision="float32"), progress=False)
    assert np.all(single.status == 0)
    for index, case in enumerate(CASES):
        expected = case["expected"]
        if expected.get("cycles", 0) == 0:
            continue
        regime = single.regime.attrs["flag_meanings"].split()[int(single.regime[index])]
        assert regime == expected["regime"], (index, case["point"])
        assert single.cycles[index] == expected["cycles"], index
        for name in ("period", "impact_velocity"):
            if expected.get(name):
                np.testing.assert_allclose(single[name][index], expected[name], rtol=3e-6, err_msg=f"{name} {index}")


def test_weakly_driven_lanes_finish():
    """With a drive at rest and almost no friction, the start sets the scale, and the steps do not run out."""
    grid = {"v": [0.0, 1e-6], "mu": [0.0, 1e-6], "c2": [0.0, 250.0], "g": [0.0, 9.81]}
    starts = ["drive", "stuck", [0.01, 0.0, 0.02, 0.0], [0.0, -1.0, 0.0, 2.0]]
    run = {"settle": 6.0, "observe": 4.0}
    sweep = {"scene": "vibro-impact", "grid": grid, "starts": starts, "run": run}
    dataset = vj.run_sweep(sweep, progress=False)
    assert np.all(dataset.status == 0)
    assert json.loads(dataset.solver)["steps"] < 5_000 * dataset.status.size

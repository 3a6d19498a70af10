"""The certificate is honest: on random periodic lanes the error estimate bounds the error, and not by far too much."""

import numpy as np
import pytest

from vibrojax.sweep import Accuracy, Chunks, read_sweep

LANES, SETTLE, OBSERVE = 640, 24.0, 8.0
EXACT = Accuracy(tolerance=1e-13, stride=0.5, step=np.inf, smoothing=0.0)
"""Far finer than what is measured; the exact reference agrees with such runs (test_exact)."""


def sweep(**run):
    rng = np.random.default_rng(4)
    points = {
        "beta": rng.uniform(0.1, 1.2, LANES),
        "gamma": rng.uniform(0.3, 1.2, LANES),
        "v": np.exp(rng.uniform(np.log(0.3), np.log(3), LANES)),
        "delta": rng.uniform(-0.006, 0.012, LANES),
    }
    starts = [("stuck", "drive")[lane % 2] for lane in range(LANES)]
    times = {"settle": SETTLE, "observe": OBSERVE}
    columns = {name: column.tolist() for name, column in points.items()} | {"start": starts}
    return read_sweep({"scene": "vibro-impact", "points": columns, "run": times | run})


@pytest.fixture(scope="module")
def exact():
    return Chunks(sweep()).at(EXACT)


@pytest.mark.parametrize("end_early", [True, False])
@pytest.mark.parametrize("error", [1e-3, 1e-4, 1e-6])
def test_error_estimate(exact, error, end_early):
    """At least 95 % of the true errors are within it, and its median is at most ten times the true one."""
    found = Chunks(sweep(error=error, end_early=end_early)).compute(0)
    # A lane that is still settling where it is observed has no error that a finer step would tell.
    periodic = (exact["cycles"] > 0) & (exact["settling_time"] < 10) & (found["cycles"] == exact["cycles"])
    assert periodic.sum() >= 200
    names = ("period", "impact_velocity")
    true = np.fmax.reduce([np.abs(found[name] / exact[name] - 1) for name in names])[periodic]
    estimate = found["error_estimate"][periodic]
    assert np.mean(true <= estimate) >= 0.95
    assert np.median(estimate) <= 10 * np.median(true)
    assert np.mean(estimate <= error) >= 0.95
    assert np.all(found["cycles"][(exact["cycles"] > 0) & (exact["settling_time"] < 10)] > 0)

"""Test the source's dependence of C on force and stiffness with simulated pulses (R8 of the reproduction)."""

import numpy as np
import pytest

import vibrojax as vj
from vibrojax.studies.rop_results import verdict

SWEEP = {
    "scene": "penetration",
    "parameters": {"zeta": 0.6, "threshold": 150e3, "pulse_width": 4e-3},
    "grid": {"k3": [300e6, 500e6], "force": [200e3, 250e3, 300e3], "frequency": [10.0, 20.0, 30.0, 40.0]},
    "run": {"settle": 1.0, "observe": 1.0},
}


@pytest.fixture(scope="module")
def fit():
    return vj.fit_rop(vj.run_sweep(SWEEP, progress=False), progress=False)


def test_c_matches_listing(fit):
    """The listing's rate is slip times 2 pi f, so its C is larger by a factor of 2 pi."""
    listed = 2 * np.pi * fit.C.sel(form="onset")
    np.testing.assert_allclose(listed, [[0.0605, 0.121, 0.1865], [0.0507, 0.1009, 0.1541]], rtol=2e-3)


def test_law_along_frequency_is_a_line_through_zero(fit):
    """Each impact slips equally far at any frequency, so the rate is proportional to the relief and not logarithmic."""
    assert abs(fit.eta0.sel(form="line")).max() < 1e-9
    np.testing.assert_allclose(fit.exponent.sel(form="power"), 1, rtol=1e-9)
    np.testing.assert_allclose(fit.C.sel(form="power"), fit.C.sel(form="line"), rtol=1e-9)
    assert (fit.r_squared.sel(form="onset") < 0.97).all()
    assert "the log law is not rejected in 0 of 6" in verdict(fit)

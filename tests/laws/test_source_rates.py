"""The source's own question: C over force and stiffness, from pulses that are simulated (the reproduction's R8)."""

import numpy as np
import pytest

import vibrojax as vj
from vibrojax.analyses.rop_law.results import verdict

SWEEP = {
    "scene": "penetration",
    "parameters": {"zeta": 0.6, "threshold": 150e3, "pulse_width": 4e-3},
    "grid": {"k3": [300e6, 500e6], "force": [200e3, 250e3, 300e3], "frequency": [10.0, 20.0, 30.0, 40.0]},
    "run": {"settle": 1.0, "observe": 1.0},
}


@pytest.fixture(scope="module")
def fit():
    return vj.fit_rop(vj.run_sweep(SWEEP, progress=False), progress=False)


def test_c_in_the_listings_rate(fit):
    """The listing's rate is slip times 2 pi f; in true units C is 2 pi times less."""
    listed = 2 * np.pi * fit.C.sel(form="onset")
    np.testing.assert_allclose(listed, [[0.0605, 0.121, 0.1865], [0.0507, 0.1009, 0.1541]], rtol=2e-3)


def test_along_frequency_the_law_is_a_line_through_zero(fit):
    """Each blow slips as far, however often it falls: the rate is in proportion to the relief, and the log a chord."""
    assert abs(fit.eta0.sel(form="line")).max() < 1e-9
    np.testing.assert_allclose(fit.exponent.sel(form="power"), 1, rtol=1e-9)
    np.testing.assert_allclose(fit.C.sel(form="power"), fit.C.sel(form="line"), rtol=1e-9)
    assert (fit.r_squared.sel(form="onset") < 0.97).all()
    assert "the log law holds in 0 of 6" in verdict(fit)

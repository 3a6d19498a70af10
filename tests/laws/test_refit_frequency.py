"""Test the coefficient of eq. 5.17 against known values, a closed form, and a simulated map of the rotary scene."""

import numpy as np
import pytest
import xarray as xr

import vibrojax as vj
from vibrojax.analyses.rop_law.least_squares import REASONS
from vibrojax.analyses.rotary_fits.frequency import refit_frequency
from vibrojax.errors import InputError
from vibrojax.measures.labels import IMPACT_FREE, IRREGULAR
from vibrojax.models.physics.modes import empirical_frequency, natural_frequencies

BETA, GAMMA = np.linspace(0.1, 1.0, 10), np.linspace(0.3, 1.1, 9)
FIXED = '{"m1": 250.0, "k1": 156250.0}'


def parameters():
    beta, gamma = np.meshgrid(BETA, GAMMA, indexing="ij")
    return {"m1": 250.0, "k1": 156250.0, "beta": beta, "gamma": gamma}


def rotary_map(w, **more):
    variables = {"period": (("beta", "gamma"), 2 * np.pi / np.asarray(w)), **more}
    return xr.Dataset(variables, {"beta": BETA, "gamma": GAMMA}, {"parameters": FIXED, "source": "vibrojax 0"})


@pytest.mark.parametrize("share", [0.25, 0.31])
def test_known_coefficient_is_recovered(share):
    fit = refit_frequency(rotary_map(empirical_frequency(parameters(), share)))
    assert fit.share.item() == pytest.approx(share, rel=1e-12) and fit.share_stderr.item() < 1e-12
    np.testing.assert_allclose(fit.share_of_lane, share, rtol=1e-12)
    assert abs(fit.error_refitted).max() < 1e-12 and REASONS[fit.reason.item()] == "identified"
    if share == 0.25:
        assert (fit.holds == 1).all() and fit.attrs["region"].startswith("90 of 90 lanes; beta 0.1: gamma 0.3 to 1.1; ")


def test_upper_natural_mode_gives_closed_form():
    """Compare with the coefficient a that satisfies the upper root of eq. 5.16.

    With g = gamma² and w1 = 1: w² = (T + root(T² − 4 g))/2, T = 1 + g (1 + beta), and a = (w² − 1 − beta g)/g.
    """
    p = parameters()
    g, beta = p["gamma"] ** 2, p["beta"]
    total = 1 + g * (1 + beta)
    share = ((total + np.sqrt(total**2 - 4 * g)) / 2 - 1 - beta * g) / g
    fit = refit_frequency(rotary_map(natural_frequencies(p)[..., 1]))
    np.testing.assert_allclose(fit.share_of_lane, share, rtol=1e-9)
    error = np.sqrt((1 + beta * g + 0.25 * g) / (1 + beta * g + share * g)) - 1
    np.testing.assert_allclose(fit.error, error, atol=1e-12)
    assert ((fit.holds == 1) == (abs(error) <= 0.01)).all() and 0 < (fit.holds == 1).sum() < 90
    # At the least-squares coefficient, any change increases the sum of squares.
    w = np.asarray(natural_frequencies(p)[..., 1])

    def loss(a):
        return ((np.asarray(empirical_frequency(p, a)) ** 2 / w**2 - 1) ** 2).sum()

    assert loss(fit.share.item()) < min(loss(fit.share.item() + step) for step in (-1e-4, 1e-4))


def test_region_has_only_lanes_that_hold():
    """One of two drive speeds deviates at gamma 0.5, and does not count at gamma 0.6."""
    slow = rotary_map(empirical_frequency(parameters()))
    both = xr.concat([slow, slow], xr.Variable("v", [0.5, 1.5]), data_vars=["period"])
    both["period"][1, :, 2] *= 1.02
    both["period"][1, :, 3] = np.nan
    region = refit_frequency(both).attrs["region"]
    assert region.startswith("160 of 170 lanes; beta 0.1: gamma 0.3 to 0.4, 0.6 to 1.1; beta 0.2: ")


def test_unsuitable_lanes_are_omitted():
    """Lanes of other regimes, in the lower mode, or without a period do not count."""
    p = parameters()
    w = np.array(empirical_frequency(p, 0.3))
    regime = np.full(w.shape, IMPACT_FREE, np.int8)
    w[0], regime[0] = 1e3, IRREGULAR
    w[1] = np.asarray(natural_frequencies(p))[1, :, 0]
    w[2, 3] = np.nan
    fit = refit_frequency(rotary_map(w, regime=(("beta", "gamma"), regime)))
    assert fit.share.item() == pytest.approx(0.3, rel=1e-12)
    assert (fit.used.item(), fit.left_out.item()) == (71, 19) and (fit.holds[:2] == -1).all()
    nothing = refit_frequency(rotary_map(np.full(w.shape, np.nan)))
    assert np.isnan(nothing.share.item()) and REASONS[nothing.reason.item()] == "too-few-lanes"


def test_quarter_holds_along_a_band_of_swept_map():
    """The simulated frequency is close to that of the undamped upper mode, so 1/4 fits where it fits that mode.

    At beta 0.4 and gamma 1, the motion without impacts decays.
    """
    grid = {"beta": [0.4, 0.6], "gamma": [0.4, 0.6, 0.7, 1.0], "v": [0.5]}
    swept = vj.run_sweep(
        {"scene": "rotary", "starts": ["drive"], "grid": grid, "run": {"settle": 20.0, "observe": 4.0}}, progress=False
    )
    fit = vj.refit_frequency(swept)
    holds = fit.holds.squeeze(("v", "start"))
    assert holds.sel(beta=0.4).values.tolist() == [0, 0, 1, -1] and holds.sel(beta=0.6).values.tolist() == [0, 1, 1, 0]
    assert fit.error.sel(beta=0.6, gamma=1.0).item() == pytest.approx(-0.066, abs=0.003)
    assert "beta 0.6: gamma 0.6 to 0.7" in fit.attrs["region"]


def test_wrong_maps_are_refused():
    data = rotary_map(empirical_frequency(parameters()))
    with pytest.raises(InputError, match="refit_frequency: period: missing"):
        refit_frequency(data.drop_vars("period"))
    with pytest.raises(InputError, match="refit_frequency: k1: is neither a coordinate"):
        refit_frequency(data.assign_attrs(parameters='{"m1": 250.0}'))
    with pytest.raises(InputError, match=r"map\.csv: does not end in \.nc"):
        refit_frequency("map.csv")

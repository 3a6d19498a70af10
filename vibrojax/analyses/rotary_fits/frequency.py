"""The empirical frequency, eq. 5.17 of the source, with its coefficient refitted to a map of impact-free motions."""

import numpy as np
import xarray as xr

from vibrojax.analyses.rop_law.data import Data, open_data
from vibrojax.analyses.rop_law.dataset import fit_dataset, reason_variable
from vibrojax.analyses.rop_law.least_squares import Reason
from vibrojax.errors import Place
from vibrojax.io.attributes import parameters_of
from vibrojax.io.variables import Variable
from vibrojax.measures.labels import IMPACT_FREE
from vibrojax.models.physics.modes import empirical_frequency, natural_frequencies

SOURCE_SHARE = 0.25
"""The coefficient a in eq. 5.17 of the source."""

_SCHEMA = {
    "share": Variable("1", "coefficient of eq. 5.17 fitted to all lanes"),
    "share_stderr": Variable("1", "standard error of the coefficient"),
    "share_of_lane": Variable("1", "coefficient of eq. 5.17 that meets the lane's frequency"),
    "error": Variable("1", "relative error of eq. 5.17 with its coefficient of 1/4"),
    "error_refitted": Variable("1", "relative error of eq. 5.17 with the coefficient fitted"),
    "holds": Variable("1", "whether eq. 5.17 with 1/4 holds", np.int8, ("not-counted", "no", "yes"), first_flag=-1),
    "used": Variable("1", "lanes that the fit used", np.int32),
    "left_out": Variable("1", "lanes left out: not impact-free, or in the lower mode", np.int32),
    "reason": reason_variable("why the coefficient is not a number"),
}


def refit_frequency(data: Data, within: float = 0.01) -> xr.Dataset:
    """Fit the coefficient a in w² = (k1 + k2)/m1 + a k2/m2 (eq. 5.17 of the source, with a = 1/4) to simulated periods.

    The equation approximates the mode in which bit and striker move against each other. The fit therefore uses only
    impact-free periodic lanes whose frequency is closer to the upper natural frequency (eq. 5.16) than to the lower.
    The fit minimises the squares of w²(a)/w² - 1, which is linear in a and, to first order, twice the relative error
    of w.

    **Arguments:**

    - `data`: dataset of a rotary sweep with `period` [s] (and `regime`), or its path; m1, k1, beta and gamma are
      coordinates of the dataset or fixed parameters.
    - `within`: relative error up to which eq. 5.17 counts as valid.

    **Returns:** a dataset with

    - `share`: the coefficient a fitted to all used lanes; NaN with fewer than two lanes.
    - `share_stderr`: its standard error. The residuals are not noise but the misfit of the equation, so this is the
      standard error of a mean over the map.
    - `share_of_lane`, over the map: the a for which the equation is exact at the lane.
    - `error` and `error_refitted`, over the map: relative errors of w with a = 1/4 and with a = `share`.
    - `holds`, over the map: whether `error` is at most `within`; -1 for a lane that is not used. The attribute `region`
      describes the lanes with `holds` = 1.
    - `used`, `left_out`: numbers of lanes; `reason`: why `share` is NaN.

    **Raises:** `InputError`.

    **Example:**

    >>> axes = {"beta": [0.2, 0.4, 0.6], "gamma": [0.6, 0.8, 1.0]}
    >>> periods = vj.run_sweep({"scene": "rotary", "grid": axes, "starts": ["drive"]}, progress=False)
    >>> refitted = vj.refit_frequency(periods)
    >>> f"{float(refitted.share):.2f}, of {int(refitted.used)} lanes"  # the source has 1/4
    '0.25, of 5 lanes'
    """
    place, data = open_data(data, "refit_frequency")
    if "period" not in data:
        raise place.at("period").error("missing; a sweep of the rotary scene has it")
    names = ("m1", "k1", "beta", "gamma")
    period, *others = xr.broadcast(data["period"], *(_parameter(place, data, name) for name in names))
    p = {name: other.transpose(*period.dims).values for name, other in zip(names, others, strict=True)}
    counts = np.isfinite(period.values) & (period.values > 0)
    if "regime" in data:
        counts &= (xr.broadcast(data["regime"], period)[0].transpose(*period.dims) == IMPACT_FREE).values
    w = 2 * np.pi / np.where(counts, period.values, np.nan)
    lower, upper = np.moveaxis(np.asarray(natural_frequencies(p)), -1, 0)
    counts = w > np.sqrt(lower * upper)
    w = np.where(counts, w, np.nan)
    used = int(counts.sum())
    # w²(a)/w² - 1 = slope a - missing
    missing, slope = 1 - (np.asarray(empirical_frequency(p, 0.0)) / w) ** 2, p["gamma"] ** 2 * p["k1"] / p["m1"] / w**2
    share = share_error = np.nan
    if used >= 2:
        column, target = slope[counts], missing[counts]
        share = float(np.linalg.lstsq(column[:, None], target)[0][0])
        share_error = float(np.linalg.norm(target - share * column) / np.linalg.norm(column) / np.sqrt(used - 1))
    error = np.asarray(empirical_frequency(p, SOURCE_SHARE)) / w - 1
    values = {
        "share": share,
        "share_stderr": share_error,
        "share_of_lane": missing / slope,
        "error": error,
        "error_refitted": np.asarray(empirical_frequency(p, share)) / w - 1,
        "holds": np.where(counts, np.abs(np.where(counts, error, 1.0)) <= within, -1),
        "used": used,
        "left_out": counts.size - used,
        "reason": Reason.IDENTIFIED if used >= 2 else Reason.TOO_FEW_LANES,
    }
    dims = dict.fromkeys(("share_of_lane", "error", "error_refitted", "holds"), period.dims)
    region = _region_of_validity(xr.DataArray(values["holds"], period.coords, period.dims), used)
    step, title = "refit of eq. 5.17", "eq. 5.17 refitted"
    more: dict[str, str | float] = {"within": float(within), "region": region}
    return fit_dataset(place, data, step, title, _SCHEMA, values, dims, period.coords, **more)


def _parameter(place: Place, data: xr.Dataset, name: str) -> xr.DataArray:
    """Return the values of the parameter `name`, which is a coordinate of the data or a fixed parameter."""
    fixed = parameters_of(data)
    if name not in data.coords and name not in fixed:
        raise place.at(name).error("is neither a coordinate of the data nor fixed in them; give it as a coordinate")
    values = data[name] if name in data.coords else xr.DataArray(fixed[name])
    if values.dtype.kind not in "fiu":
        raise place.at(name).error("does not hold numbers")
    return values


def _region_of_validity(holds: xr.DataArray, used: int) -> str:
    """Return text: at how many lanes eq. 5.17 holds and, for a grid, the intervals of gamma per beta where it does.

    A value of gamma is included if the equation holds at all lanes used there.
    """
    parts = [f"{int((holds == 1).sum())} of {used} lanes"]
    if {"beta", "gamma"} <= set(holds.dims):
        others = [dim for dim in holds.dims if dim not in ("beta", "gamma")]
        everywhere = ((holds == 1).any(others) & (holds != 0).all(others)).transpose("beta", "gamma").values
        for beta, row in zip(holds["beta"].values, everywhere, strict=True):
            ends = np.flatnonzero(np.diff(np.concatenate([[False], row, [False]]).astype(int)))
            gammas = [(holds["gamma"].values[i], holds["gamma"].values[k - 1]) for i, k in ends.reshape(-1, 2)]
            texts = [f"{low:.4g}" if low == high else f"{low:.4g} to {high:.4g}" for low, high in gammas]
            parts += [f"beta {beta:.4g}: gamma {', '.join(texts)}"] if texts else []
    return "; ".join(parts)

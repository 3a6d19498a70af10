"""The empirical frequency of eq. 5.17, its coefficient fitted anew to a map of the motion without impact."""

from dataclasses import dataclass

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float

from vibrojax.analyses.rop_law.data import Data, open_data, parameter
from vibrojax.analyses.rop_law.results import provenance, reason, with_attributes
from vibrojax.analyses.rop_law.uncertainty import IDENTIFIED, TOO_FEW_LANES
from vibrojax.errors import Place
from vibrojax.io.attributes import title_of
from vibrojax.io.variables import Variable
from vibrojax.measures.labels import IMPACT_FREE
from vibrojax.models.physics.modes import empirical_frequency, natural_frequencies

SHARE = 0.25
"""The source's coefficient."""

_NEEDED = ("m1", "k1", "beta", "gamma")

_VARIABLES = {
    "share": Variable("1", "coefficient of eq. 5.17 fitted to all lanes"),
    "share_stderr": Variable("1", "standard error of the coefficient"),
    "share_of_lane": Variable("1", "coefficient of eq. 5.17 that meets the lane's frequency"),
    "error": Variable("1", "relative error of eq. 5.17 with its coefficient of 1/4"),
    "error_refitted": Variable("1", "relative error of eq. 5.17 with the coefficient fitted"),
    "holds": Variable("1", "whether eq. 5.17 with 1/4 holds", np.int8),
    "used": Variable("1", "lanes that the fit used", np.int32),
    "left_out": Variable("1", "lanes left out: not impact-free, or in the lower mode", np.int32),
    "reason": reason("why the coefficient is not a number"),
}

_OF_MAP = ("share_of_lane", "error", "error_refitted", "holds")


@dataclass(frozen=True)
class _Map:
    """The lanes of a map: `parameters` by name, `period` [s], and `w` [rad/s], NaN where a lane does not count."""

    parameters: dict[str, Float[np.ndarray, "*lanes"]]
    period: xr.DataArray
    w: Float[np.ndarray, "*lanes"]


def refit_frequency(data: Data, within: float = 0.01) -> xr.Dataset:
    """The coefficient a of w² = (k1 + k2)/m1 + a k2/m2 (eq. 5.17 has a = 1/4) fitted to the periods of a map.

    The equation is of the mode in which bit and striker move against each other, so lanes count that repeat after one
    return without impact, at a frequency nearer to the upper natural one (eq. 5.16) than to the lower. a is linear in
    w²: least squares of w²(a)/w² − 1, twice the relative error of w to first order, in closed form.

    **Arguments:**

    - `data`: a rotary sweep's dataset with `period` [s] (and `regime`), or the path of one; m1, k1, beta and gamma are
      its coordinates or fixed in it.
    - `within`: the relative error up to which eq. 5.17 is said to hold.

    **Returns:** a dataset with `share`, the a of all lanes, and `share_stderr`: what is left is no noise but the
    equation's own misfit, so the error is that of a mean over the map. Over the map: `share_of_lane`, the a that meets
    the lane; `error` and `error_refitted`, the relative errors of w with 1/4 and with `share`; `holds`, whether 1/4 is
    within `within` (−1: the lane does not count). The attribute `region` says where that is. `used`, `left_out`,
    `reason`; NaN where there are fewer than two lanes.

    **Raises:** `InputError`.

    **Example:**

    >>> axes = {"beta": [0.2, 0.4, 0.6], "gamma": [0.6, 0.8, 1.0]}
    >>> periods = vj.run_sweep({"scene": "rotary", "grid": axes, "starts": ["drive"]}, progress=False)
    >>> refitted = vj.refit_frequency(periods)
    >>> f"{float(refitted.share):.2f}, of {int(refitted.used)} lanes"  # the source has 1/4
    '0.25, of 5 lanes'
    """
    place, data = open_data(data, "refit_frequency")
    lanes = _upper_mode(place, data)
    p, w = lanes.parameters, lanes.w
    counts = np.isfinite(w)
    unit = p["gamma"] * np.sqrt(p["k1"] / p["m1"]) / w
    missing, slope = 1 - (np.asarray(empirical_frequency(p, 0.0)) / w) ** 2, unit**2
    share, share_error = _through_zero(slope[counts], missing[counts])
    error = np.asarray(empirical_frequency(p, SHARE)) / w - 1
    used = int(counts.sum())
    values = {
        "share": share,
        "share_stderr": share_error,
        "share_of_lane": missing / slope,
        "error": error,
        "error_refitted": np.asarray(empirical_frequency(p, share)) / w - 1,
        "holds": np.where(counts, np.abs(np.where(counts, error, 1.0)) <= within, -1),
        "used": used,
        "left_out": counts.size - used,
        "reason": IDENTIFIED if used >= 2 else TOO_FEW_LANES,
    }
    variables = with_attributes(_VARIABLES, values, dict.fromkeys(_OF_MAP, lanes.period.dims))
    variables["holds"].attrs |= {"flag_values": np.array([-1, 0, 1], np.int8), "flag_meanings": "not-counted no yes"}
    result = xr.Dataset(variables, lanes.period.coords)
    title = f"eq. 5.17 refitted: {title_of(data, place.file)}"
    more: dict[str, str | float] = {"within": float(within), "region": _region(result, used)}
    return result.assign_attrs(provenance(place, data, "refit of eq. 5.17", title, more))


def _upper_mode(place: Place, data: xr.Dataset) -> _Map:
    """The lanes, of which those count that repeat without impact in the upper mode."""
    if "period" not in data:
        raise place.at("period").error("missing; a sweep of the rotary scene has it")
    parts = xr.broadcast(data["period"], *(parameter(place, data, name) for name in _NEEDED))
    period = parts[0]
    p = {name: part.transpose(*period.dims).values for name, part in zip(_NEEDED, parts[1:], strict=True)}
    counts = np.isfinite(period.values) & (period.values > 0)
    if "regime" in data:
        regime = xr.broadcast(data["regime"], period)[0].transpose(*period.dims)
        counts = counts & (regime == IMPACT_FREE).values
    w = 2 * np.pi / np.where(counts, period.values, np.nan)
    lower, upper = np.moveaxis(np.asarray(natural_frequencies(p)), -1, 0)
    return _Map(p, period, np.where(w > np.sqrt(lower * upper), w, np.nan))


def _through_zero(slope: Float[np.ndarray, " lanes"], y: Float[np.ndarray, " lanes"]) -> tuple[float, float]:
    """The a of y = a slope by least squares, and its standard error; NaN where there are fewer than two lanes."""
    if len(y) < 2:
        return np.nan, np.nan
    square = (slope**2).sum()
    share = (slope * y).sum() / square
    return share, np.sqrt(((y - share * slope) ** 2).sum() / (len(y) - 1) / square)


def _region(fit: xr.Dataset, used: int) -> str:
    """Where eq. 5.17 holds, in words: of a grid, for each beta the gamma at which it does in every lane that counts."""
    holds = fit["holds"]
    text = f"{int((holds == 1).sum())} of {used} lanes"
    if not {"beta", "gamma"} <= set(holds.dims):
        return text
    others = [dim for dim in holds.dims if dim not in ("beta", "gamma")]
    everywhere = ((holds == 1).any(others) & (holds != 0).all(others)).transpose("beta", "gamma").values
    rows = [
        f"beta {beta:.4g}: gamma {_stretches(row, fit['gamma'].values)}"
        for beta, row in zip(fit["beta"].values, everywhere, strict=True)
        if row.any()
    ]
    return "; ".join([text, *rows])


def _stretches(row: Bool[np.ndarray, " values"], values: Float[np.ndarray, " values"]) -> str:
    """The stretches of `values` along which `row` is true."""
    ends = np.flatnonzero(np.diff(np.concatenate([[False], row, [False]]).astype(int)))
    pairs = [(values[first], values[after - 1]) for first, after in zip(ends[::2], ends[1::2], strict=True)]
    return ", ".join(f"{low:.4g}" if low == high else f"{low:.4g} to {high:.4g}" for low, high in pairs)

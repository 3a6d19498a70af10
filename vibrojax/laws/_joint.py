"""One law over all lanes: C and eta0 as power laws of the parameters, with shared coefficients."""

from collections.abc import Sequence
from os import PathLike

import numpy as np
import xarray as xr

from vibrojax.errors import Place, shown, suggestion
from vibrojax.laws._calibrate import calibrated
from vibrojax.laws._fit import described, provenance
from vibrojax.laws._group import LEAST_SPREAD
from vibrojax.laws._lanes import axis, read_data, usable

OVER = ("force", "k3", "zeta", "threshold")
ONSETS = ("power-law", "shared")

_ABOUT = {
    "C": ("m s-1", "coefficient of the rate-of-penetration law at the reference"),
    "C_stderr": ("m s-1", "standard error of C"),
    "C_exponent": ("1", "exponent of the parameter in C"),
    "C_exponent_stderr": ("1", "standard error of the parameter's exponent in C"),
    "eta0": ("1", "relief at the onset, at the reference"),
    "eta0_stderr": ("1", "standard error of eta0"),
    "eta0_exponent": ("1", "exponent of the parameter in eta0"),
    "eta0_exponent_stderr": ("1", "standard error of the parameter's exponent in eta0"),
    "reference": ("1", "value of the parameter at the reference, in its own unit"),
    "r_squared": ("1", "share of the rate's variance that the law explains"),
    "aic": ("1", "n ln(RSS/n) + 2k, RSS in m2 s-2"),
    "degrees_of_freedom": ("1", "of the standard errors: lanes with a residual less coefficients"),
    "used": ("1", "lanes that the fit used, those at zero rate among them"),
    "left_out": ("1", "lanes left out: failed, irregular, or without usable values"),
    "reason": ("1", "why a coefficient is not a number"),
}


def fit_joint(
    data: xr.Dataset | str | PathLike, along: str | None = None, over: Sequence[str] = OVER, onset: str = "power-law"
) -> xr.Dataset:
    """One law for all groups at once, calibrated on all lanes:

        rate = C ln(eta/eta0),  C = C_ref prod (x_j/ref_j)^a_j,  eta0 = eta0_ref prod (x_j/ref_j)^b_j

    Least squares of the rate by Levenberg–Marquardt, from power laws through the groups' own onset fits; lanes at zero
    rate are censored, and lanes are left out, as in `fit_rop`.

    **Arguments:**

    - `data`: as in `fit_rop`; the parameters x_j are coordinates of it (of a CSV: columns).
    - `along`: the axis of a group, which is then no parameter of the law; by default none is excluded.
    - `over`: the parameters; of the default ones those are taken that the data have and vary.
    - `onset`: "power-law", or "shared": one eta0 for all (b_j = 0).

    **Returns:** a dataset with C [m/s] and eta0 at the reference (the parameters' geometric means), and along
    `parameter` the exponents, each with standard error; r_squared, aic, used, left_out; NaN with a `reason` where they
    cannot be told.

    **Raises:** `InputError`.
    """
    place, data = read_data(data, "fit_joint", over)
    if onset not in ONSETS:
        raise place.at("onset").error(f"{shown(onset)} is unknown; {suggestion(str(onset), ONSETS)}")
    lanes = usable(data)
    if along is not None:
        axis(place, lanes, along)
    relief, rate, valid = (lanes[name].values.ravel() for name in ("relief", "rate", "valid"))
    parameters = _parameters(place, lanes, tuple(over), along, valid)
    logs = np.log(np.stack(list(parameters.values()), axis=1)) if parameters else np.zeros((rate.size, 0))
    centre = logs[valid].mean(axis=0) if valid.any() else np.full(len(parameters), np.nan)
    found = calibrated(relief[valid], rate[valid], (logs - centre)[valid], onset == "shared")
    found |= {"reference": np.exp(centre), "used": np.int32(valid.sum()), "left_out": np.int32((~valid).sum())}
    variables = {
        name: (("parameter",) if np.ndim(found[name]) else (), found[name], about)
        for name, about in described(_ABOUT).items()
    }
    coordinate = ("parameter", np.array(list(parameters), dtype=str), {"units": "1", "long_name": "parameter"})
    more = {"formula": "C ln(eta/eta0), C and eta0 power laws of the parameters", "onset": onset}
    return xr.Dataset(variables, {"parameter": coordinate}, provenance(place, data, "joint fit", more))


def _parameters(
    place: Place, lanes: xr.Dataset, over: tuple[str, ...], along: str | None, valid: np.ndarray
) -> dict[str, np.ndarray]:
    """Each parameter's value for every lane; of the default ones, those that are there and vary."""
    found = {}
    for name in over:
        at = place.at(f"over.{name}")
        if name not in lanes.coords or name == along:
            if over != OVER:
                choice = [str(coordinate) for coordinate in lanes.coords if coordinate != along]
                raise at.error(f"no coordinate of the data beside along; {suggestion(name, choice)}")
            continue
        if lanes[name].dtype.kind not in "fiu":
            raise at.error("does not hold numbers; a power law needs them")
        values = xr.broadcast(lanes[name], lanes["rate"])[0].transpose(*lanes["rate"].dims)
        values = values.values.ravel().astype(np.float64)
        if not (np.isfinite(values[valid]) & (values[valid] > 0)).all():
            raise at.error("has values that are not above 0; a power law needs them above 0")
        if valid.any() and np.ptp(np.log(values[valid])) > LEAST_SPREAD:
            found[name] = np.where(valid, values, 1.0)
        elif over != OVER:
            raise at.error("has one value over all lanes; a power law needs two or more")
    return found
